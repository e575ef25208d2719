"""The recording of a comparison shows what the comparison found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.rrd import columns, rgb
from tissue_sim.compare.comparison import Comparison, compare
from tissue_sim.compare.interaction import held_along
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import parse_subject
from tissue_sim.compare.trajectory import Trajectory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from viz_bridge.comparison_rrd import write_rrd
from viz_bridge.difference_colors import UNKNOWN, color_bar, difference_colors, scale_top
from viz_bridge.organ_surface import surface_of

FRAMES = 12


def pulled_block() -> Organ:
    mesh = Mesh(block(4, 4, 3, 0.03, 0.03, 0.02))
    mesh.fixed[: mesh.node_rows] = mesh.rest[: mesh.node_rows, 1] < 1e-9
    return Organ("block", mesh)


@pytest.fixture(scope="module")
def compared() -> Comparison:
    organ = pulled_block()
    hold = np.flatnonzero(organ.rest[:, 1] > 0.0299)
    offsets = np.zeros((FRAMES, 3))
    offsets[:, 1] = np.linspace(0.0, 0.008, FRAMES)
    pull = held_along(organ, "pull", 30.0, hold, offsets)
    targets = [parse_subject(text) for text in ("same/one=quasi_static@3", "lr@1")]
    return compare(organ, pull, parse_subject("quasi_static@3"), targets)


def test_bodies_move_as_simulated_and_have_the_difference_as_colour(
    compared: Comparison, tmp_path: Path
) -> None:
    path = tmp_path / "compared.rrd"
    write_rrd(path, compared)
    assert list(tmp_path.iterdir()) == [path]
    found = columns(path)
    organ, lr = compared.organ, compared.targets[1]
    part = surface_of(organ.mesh).outside
    top = scale_top(float(lr.difference.frame_p95.max()))
    drawn = found["/bodies/2 lr/surface"]
    assert drawn["Mesh3D:triangle_indices"] == [part.triangles.tolist()]
    for frame in range(FRAMES):
        shape = organ.rest + lr.trajectory.displacement[frame]
        np.testing.assert_allclose(
            drawn["Mesh3D:vertex_positions"][frame], shape[part.nodes], atol=1e-8
        )
        apart = np.linalg.norm(
            lr.trajectory.displacement[frame] - compared.reference.displacement[frame], axis=1
        )
        expected = difference_colors(apart[part.nodes], top)
        np.testing.assert_array_equal(rgb(drawn["Mesh3D:vertex_colors"][frame]), expected)


def test_the_same_model_has_the_colour_of_zero(compared: Comparison, tmp_path: Path) -> None:
    path = tmp_path / "compared.rrd"
    write_rrd(path, compared)
    same = next(body for entity, body in columns(path).items() if "same" in entity and
                entity.endswith("surface"))  # fmt: skip
    zero = difference_colors(np.zeros(1), 1.0)[0]
    assert all((rgb(frame) == zero).all() for frame in same["Mesh3D:vertex_colors"])


def test_curves_are_the_difference_over_time_in_millimetres(
    compared: Comparison, tmp_path: Path
) -> None:
    path = tmp_path / "compared.rrd"
    write_rrd(path, compared)
    found = columns(path)
    curves = {
        "/plots/mean/2": 1e3 * compared.targets[1].difference.frame_mean,
        "/plots/p95/2": 1e3 * compared.targets[1].difference.frame_p95,
        "/plots/mean/worst": 1e3 * compared.worst.frame_mean,
    }
    for entity, values in curves.items():
        drawn = np.ravel(found[entity]["Scalars:scalars"])
        np.testing.assert_allclose(drawn, values, rtol=1e-12)
        assert found[entity]["frame"] == list(range(1, FRAMES + 1))
        seconds = np.array(found[entity]["sim_time"]) / 1e9
        np.testing.assert_allclose(seconds, np.arange(1, FRAMES + 1) / 30.0, atol=1e-8)
    text = found["/summary"]["TextDocument:text"][0][0]
    assert f"{compared.targets[1].relative:.3f}" in text


def test_nodes_that_were_not_measured_are_grey(compared: Comparison, tmp_path: Path) -> None:
    organ = compared.organ
    part = surface_of(organ.mesh).outside
    known = part.nodes[::2].copy()
    measured: Trajectory = replace(compared.reference, label="camera", rows=known)
    path = tmp_path / "measured.rrd"
    write_rrd(path, compare(organ, compared.interaction, measured, [parse_subject("lr@1")]))
    found = columns(path)
    grey = (rgb(found["/bodies/1 lr/surface"]["Mesh3D:vertex_colors"][-1]) == UNKNOWN).all(axis=1)
    np.testing.assert_array_equal(grey, ~np.isin(part.nodes, known))
    points = np.array(found["/bodies/reference/measured"]["Points3D:positions"][0])
    assert points.shape == (len(known), 3)


@given(st.floats(1e-6, 1e3), st.floats(1e-6, 1e3))
def test_the_scale_ends_at_1_2_or_5_and_never_below_what_it_shows(one: float, other: float) -> None:
    low, high = sorted((one, other))
    top = scale_top(low)
    assert low <= top * (1 + 1e-6) <= scale_top(high) * (1 + 1e-6)
    assert top <= 2.5 * low * (1 + 1e-6)
    digit = f"{top:.6e}"[0]
    assert digit in "125"


def test_colours_darken_with_the_distance_and_end_at_the_top() -> None:
    colors = difference_colors(np.array([0.0, 0.25, 0.5, 0.75, 1.0, 9.0, np.nan]), 1.0).astype(int)
    brightness = colors[:5] @ [299, 587, 114]
    assert (np.diff(brightness) < 0).all()
    np.testing.assert_array_equal(colors[4], colors[5])
    assert tuple(colors[6]) == UNKNOWN


def test_the_bar_has_the_colours_of_the_bodies() -> None:
    bar = color_bar(0.002).astype(int)
    for share in (0.25, 0.5, 0.75):
        # The bar takes the middle of the picture between margins of 6 %.
        column = bar[:, round((0.06 + 0.88 * share) * bar.shape[1])]
        wanted = difference_colors(np.array([share]), 1.0)[0].astype(int)
        assert np.abs(column - wanted).max(axis=1).min() <= 8
