"""Surfaces become volumes: closed forms, winding numbers against brute force, dirty input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tissue_sim.geometry.check import mend
from tissue_sim.geometry.errors import MeshError
from tissue_sim.geometry.fill import MOST_NODES, fill_surface
from tissue_sim.geometry.formats import load
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.winding import signed_distances, surface_tree, winding_numbers


def surface(*shapes: trimesh.Trimesh) -> RawMesh:
    whole = trimesh.util.concatenate(list(shapes))
    return RawMesh(np.array(whole.vertices), triangles=np.array(whole.faces, dtype=np.int64))


def ball(radius: float, x: float = 0.0) -> trimesh.Trimesh:
    shape = trimesh.creation.icosphere(4, radius)
    shape.apply_translation([x, 0, 0])
    return shape


def solid_angles(points: np.ndarray, triangles: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Winding numbers by the plain sum over all triangles."""
    a, b, c = (points[triangles[:, k]] - places[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    volume = np.einsum("pti,pti->pt", a, np.cross(b, c))
    below = la * lb * lc + np.einsum("pti,pti->pt", a, b) * lc
    below += np.einsum("pti,pti->pt", b, c) * la + np.einsum("pti,pti->pt", c, a) * lb
    return np.arctan2(volume, below).sum(axis=1) / (2 * np.pi)


def test_winding_numbers_and_distances_equal_brute_force_and_trimesh() -> None:
    raw = surface(ball(0.02), ball(0.02, 0.025))
    random = np.random.default_rng(2)
    places = random.uniform([-0.03, -0.03, -0.03], [0.055, 0.03, 0.03], (300, 3))
    tree = surface_tree(raw.points, raw.triangles)
    exact = solid_angles(raw.points, raw.triangles, places)
    assert set(np.round(exact).astype(int).tolist()) == {0, 1, 2}
    np.testing.assert_allclose(winding_numbers(tree, places), exact, atol=0.2)
    distances = signed_distances(tree, places)
    _, unsigned, _ = trimesh.proximity.closest_point(
        # In millimetres: trimesh's tolerances are absolute.
        trimesh.Trimesh(1e3 * raw.points, raw.triangles, process=False),
        1e3 * places,
    )
    np.testing.assert_allclose(np.abs(distances), 1e-3 * unsigned, rtol=1e-6)
    assert np.array_equal(distances < 0, exact > 0.5)


def test_a_ball_is_filled_with_its_volume() -> None:
    raw, said = fill_surface(surface(ball(0.03)), cell=0.004)
    _, report = mend(raw)
    assert report.volume == pytest.approx(4 / 3 * np.pi * 0.03**3, rel=0.01)
    assert report.quality_min > 0.1
    assert len(report.part_sizes) == 1
    assert "filled with" in said[0]


def test_surfaces_that_cut_through_each_other_are_filled_as_their_union() -> None:
    raw, _ = fill_surface(surface(ball(0.02), ball(0.02, 0.02)), cell=0.003)
    _, report = mend(raw)
    lens = np.pi * (4 * 0.02 + 0.02) * (2 * 0.02 - 0.02) ** 2 / 12
    assert report.volume == pytest.approx(2 * 4 / 3 * np.pi * 0.02**3 - lens, rel=0.015)
    assert len(report.part_sizes) == 1


def test_a_hollow_stays_hollow() -> None:
    inner = ball(0.02)
    inner.invert()
    raw, _ = fill_surface(surface(ball(0.03), inner), cell=0.003)
    volume = 4 / 3 * np.pi * (0.03**3 - 0.02**3)
    assert mend(raw)[1].volume == pytest.approx(volume, rel=0.02)


def test_a_wall_thinner_than_the_elements_is_thickened_not_lost() -> None:
    inner = ball(0.029)
    inner.invert()
    raw, said = fill_surface(surface(ball(0.03), inner), cell=0.003)
    mended, report = mend(raw)
    assert len(report.part_sizes) == 1
    assert report.volume > 4 / 3 * np.pi * (0.03**3 - 0.029**3)
    radii = np.linalg.norm(mended.points, axis=1)
    assert radii.min() > 0.0295 - 0.8 * 0.003
    assert radii.max() < 0.0295 + 0.8 * 0.003
    assert any("thickened" in text for text in said)


def test_a_surface_turned_inside_out_is_turned_back() -> None:
    shape = ball(0.03)
    shape.invert()
    raw, said = fill_surface(surface(shape), cell=0.005)
    assert "pointed inwards" in said[0]
    assert mend(raw)[1].volume == pytest.approx(4 / 3 * np.pi * 0.03**3, rel=0.02)


def test_open_and_contradictory_surfaces_are_refused() -> None:
    whole = surface(ball(0.03))
    upper = whole.points[whole.triangles].mean(axis=1)[:, 2] > 0
    bowl = replace(whole, triangles=whole.triangles[upper], source="bowl.stl")
    # A bowl's rim is about one edge in forty; a soup of triangles has open edges only.
    soup = replace(
        whole, points=whole.points[whole.triangles].reshape(-1, 3),
        triangles=np.arange(3 * len(whole.triangles)).reshape(-1, 3),
    )  # fmt: skip
    for raw in (bowl, soup):
        with pytest.raises(MeshError, match=r"does not enclose a volume.*open"):
            fill_surface(raw)
    turned = whole.triangles.copy()
    turned[::2] = turned[::2, ::-1]
    with pytest.raises(MeshError, match="disagree which side is out"):
        fill_surface(replace(whole, triangles=turned))


@pytest.mark.parametrize("cell", [0.0, -1.0, 1e-6, 1.0, float("nan")])
def test_senseless_element_sizes_are_refused(cell: float) -> None:
    with pytest.raises(ValueError, match="allowed"):
        fill_surface(surface(ball(0.03)), cell)


@pytest.mark.parametrize(
    ("name", "volume", "tolerance"),
    [
        ("pediatric_biv/CHD1108401_ED_biv_wall.stl", 128.0e-6, 0.05),
        # Walls of 3 mm in an organ of 290 mm: 40,000 nodes thicken them.
        ("toronto_chd/myo_2018002_tof.obj", 458.1e-6, 0.35),
    ],
)
def test_real_surfaces_are_filled_within_the_node_budget(
    shared_meshes: Path, name: str, volume: float, tolerance: float
) -> None:
    dirty, _ = mend(load(shared_meshes / name, "mm"))
    raw, _ = fill_surface(dirty)
    assert 10_000 < len(raw.points) <= MOST_NODES
    mended, report = mend(raw)
    assert report.volume == pytest.approx(volume, rel=tolerance)
    assert len(report.part_sizes) == 1
    assert report.quality_min > 0.1
    size = np.ptp(dirty.points, axis=0)
    np.testing.assert_allclose(np.ptp(mended.points, axis=0), size, rtol=0.02)
