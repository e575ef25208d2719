"""Generated shapes have the sizes, counts and node sets they promise."""

from __future__ import annotations

import numpy as np
import pytest

from tissue_sim.geometry.check import mend
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.renumber import neighbour_distance, renumber
from tissue_sim.geometry.shapes import block, sphere_shell, wall


def edge_count(raw: RawMesh) -> int:
    pairs = raw.tetrahedra[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
    return len(np.unique(np.sort(pairs, axis=1), axis=0))


def test_the_wall_is_that_of_the_thesis() -> None:
    raw = wall()
    assert (len(raw.points), len(raw.tetrahedra)) == (884, 2400)
    assert edge_count(raw) == 4165
    assert np.ptp(raw.points, axis=0) == pytest.approx([0.064, 0.1, 0.004])
    # Fixed on three of four sides: two columns of 26 and a row of 17, less their two corners.
    assert len(raw.node_sets["fixed"]) == 2 * (2 * 26 + 17 - 2)
    assert len(raw.node_sets["free_side"]) == 2 * 15
    hold = raw.points[raw.node_sets["hold"]]
    assert np.allclose(hold[:, 1], 0.1)
    assert hold[:, 0].mean() == pytest.approx(0.032)


def test_block_has_its_volume_and_its_bottom_fixed() -> None:
    raw = block(5, 4, 3, 0.04, 0.03, 0.02)
    assert len(raw.points) == 60
    assert signed_volumes(raw.points, raw.tetrahedra).sum() == pytest.approx(0.04 * 0.03 * 0.02)
    assert (raw.points[raw.node_sets["fixed"], 2] == 0).all()
    assert len(raw.node_sets["fixed"]) == len(raw.node_sets["top"]) == 20


def test_sphere_shells_volume_converges_with_the_second_order_of_the_edge_length() -> None:
    exact = 4 / 3 * np.pi * (0.03**3 - 0.02**3)
    errors = []
    for subdivisions in (2, 3, 4):
        raw = sphere_shell(0.03, 0.01, subdivisions, 2)
        errors.append(exact - signed_volumes(raw.points, raw.tetrahedra).sum())
    assert errors[0] > errors[1] > errors[2] > 0
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.05)


@pytest.mark.parametrize("raw", [wall(), block(), sphere_shell()], ids=lambda raw: raw.name)
def test_shapes_need_no_mending(raw: RawMesh) -> None:
    _, report = mend(raw)
    assert not report.mended
    assert not report.warnings
    assert len(report.part_sizes) == 1
    assert report.quality_min > 0.5


@pytest.mark.parametrize(
    "call",
    [
        lambda: wall(columns=1),
        lambda: block(size_x=-1.0),
        lambda: block(10**4, 10**4, 10**4),
        lambda: sphere_shell(thickness=0.05),
        lambda: sphere_shell(subdivisions=9),
        lambda: sphere_shell(layers=1),
        lambda: wall(width=float("nan")),
    ],
)
def test_senseless_sizes_are_refused(call: object) -> None:
    with pytest.raises(ValueError, match=r"allowed|must be"):
        call()  # type: ignore[operator]


def test_renumbering_keeps_the_mesh_and_brings_neighbours_together() -> None:
    raw = sphere_shell()
    shuffle = np.random.default_rng(3).permutation(len(raw.points))
    place = np.argsort(shuffle)
    shuffled = RawMesh(
        raw.points[shuffle],
        place[raw.tetrahedra],
        regions=np.arange(len(raw.tetrahedra), dtype=np.int32),
        node_sets={"fixed": place[raw.node_sets["fixed"]]},
    )
    ordered = renumber(shuffled)
    assert neighbour_distance(ordered.tetrahedra) < 0.06 * neighbour_distance(shuffled.tetrahedra)
    assert np.array_equal(ordered.points, shuffled.points[ordered.node_file_ids])
    assert np.array_equal(ordered.regions, ordered.element_file_ids)
    back = ordered.node_file_ids[ordered.tetrahedra]
    assert np.array_equal(back, shuffled.tetrahedra[ordered.element_file_ids])
    fixed = set(ordered.node_file_ids[ordered.node_sets["fixed"]].tolist())
    assert fixed == set(shuffled.node_sets["fixed"].tolist())
    assert np.array_equal(renumber(shuffled).points, ordered.points)
