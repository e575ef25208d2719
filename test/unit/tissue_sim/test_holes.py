"""Holes remembered by the tissue around them: they move with it and outlive edits."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from support.holed_wall import HOLE, SIDE, TOP, add_patch, edge, holed_wall
from support.patches import patch_edit
from support.sheets import ball, shell
from support.split_block import split_plan
from tissue_sim.geometry.closure import LoopError
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.holes import Hole, HoleLostError, NothingThereError, name_hole
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet_geometry import CONNECTED, SURFACE, SheetSettings, with_sheet

MIDDLE = np.array([0.5 * SIDE, 0.5 * SIDE, TOP])


def named(mesh: Mesh) -> tuple[Hole, NDArray[np.float64]]:
    shape = mesh.rest[: mesh.node_rows].copy()
    # Half a millimetre above the edge: the edge is the closest tissue.
    return name_hole(mesh, shape, "window", edge(TOP + 0.0005)), shape


def test_positions_are_attached_to_the_closest_tissue_and_move_with_it() -> None:
    hole, shape = named(mesh := holed_wall())
    np.testing.assert_allclose(hole.loop(mesh, shape), edge(), atol=1e-12)
    assert hole.first_area == pytest.approx(HOLE**2, rel=3e-3)
    assert hole.depth == pytest.approx(0.5 * HOLE / np.sqrt(np.pi), rel=2e-3)
    moved = Rotation.from_rotvec([0.3, 0.1, 0.2]).apply(shape) * 1.1 + 0.4
    wanted = Rotation.from_rotvec([0.3, 0.1, 0.2]).apply(edge()) * 1.1 + 0.4
    np.testing.assert_allclose(hole.loop(mesh, moved), wanted, atol=1e-12)
    found = hole.closure(mesh, moved)
    assert found.area == pytest.approx(1.21 * HOLE**2, rel=3e-3)
    assert (found.covered, found.edge_gap) == (0.0, np.inf)


def test_a_patch_over_the_hole_covers_it_and_the_wall_around_does_not() -> None:
    mesh = holed_wall()
    hole, shape = named(mesh)
    add_patch(mesh)
    shape = mesh.rest[: mesh.node_rows].copy()
    found = hole.closure(mesh, shape)
    assert found.shares == {1: pytest.approx(1.0)}
    assert (found.gap, found.by_tissue) == (0.0, 0.0)
    assert found.edge_gap == pytest.approx(0.0005)
    rows = mesh.element_rows
    own = np.unique(mesh.tets[:rows][mesh.regions[:rows] == mesh.patches.items[0].label])
    # Half of it drawn aside, the other half of the hole is open but for half a thickness.
    shape[own, 0] += 0.5 * 0.014
    aside = hole.closure(mesh, shape)
    assert aside.covered == pytest.approx(0.5, abs=0.06)
    assert aside.gap == pytest.approx(0.5 * HOLE, abs=0.0006)
    shape[own, 2] += 1.1 * hole.depth
    assert hole.closure(mesh, shape).covered == 0.0


def test_a_patch_is_no_tissue_to_attach_to() -> None:
    mesh = holed_wall()
    add_patch(mesh, size=0.0102, above=0.0001)
    shape = mesh.rest[: mesh.node_rows].copy()
    hole = name_hole(mesh, shape, "window", edge(TOP + 0.0005))
    np.testing.assert_allclose(hole.loop(mesh, shape), edge(), atol=1e-12)


def test_a_loop_follows_a_cut_through_its_edge_and_its_undo() -> None:
    mesh = holed_wall()
    hole, _ = named(mesh)
    history = EditHistory()
    before = hole.loop(mesh, mesh.rest[: mesh.node_rows])
    change = mesh.apply(split_plan(mesh, through=0.3))
    history.record(change)
    assert len(change.copied_nodes)
    shape = mesh.rest[: mesh.node_rows].copy()
    np.testing.assert_allclose(hole.loop(mesh, shape), before, atol=1e-12)
    # The right lip moves away: what is to the right of the cut follows it whole.
    right = mesh.tets[: mesh.element_rows][mesh.element_alive[: mesh.element_rows]]
    right = np.unique(right[shape[right].mean(axis=1)[:, 0] > 0.5 * SIDE])
    left = np.setdiff1d(np.arange(mesh.node_rows), right)
    shape[right, 0] += 0.002
    both = np.intersect1d(np.flatnonzero(mesh.node_alive), left)
    assert len(both)
    loop = hole.loop(mesh, shape)
    shift = loop[:, 0] - before[:, 0]
    assert set(np.round(1e3 * shift, 6)) <= {0.0, 2.0}
    assert shift[before[:, 0] > 0.5 * SIDE + 1e-6] == pytest.approx(0.002)
    assert hole.lost(mesh) == 0


def test_what_was_removed_is_left_out_until_it_comes_back() -> None:
    mesh = holed_wall()
    hole, _ = named(mesh)
    history = EditHistory()
    rest = mesh.rest
    middles = rest[mesh.tets[: mesh.element_rows]].mean(axis=1)
    living = mesh.element_alive[: mesh.element_rows]
    # A window that is larger on the left.
    gone = np.flatnonzero(living & (middles[:, 0] < 0.5 * SIDE - 0.0026))
    history.record(mesh.apply(TopologyEdit(mesh.version, removed_elements=gone.astype(np.uint32))))
    assert 0 < hole.lost(mesh) <= 3
    assert 5 <= len(hole.loop(mesh, rest)) <= 8 - hole.lost(mesh)
    gone = np.flatnonzero(mesh.element_alive[: mesh.element_rows])[:-1]
    history.record(mesh.apply(TopologyEdit(mesh.version, removed_elements=gone.astype(np.uint32))))
    with pytest.raises(HoleLostError, match="window is no more"):
        hole.closure(mesh, rest)
    with pytest.raises(HoleLostError, match="not finite"):
        named(other := holed_wall())[0].closure(other, np.full((other.node_rows, 3), np.nan))
    for _ in range(2):
        history.record(mesh.apply(history.undo(mesh)))
    np.testing.assert_allclose(hole.loop(mesh, mesh.rest), edge(), atol=1e-12)


@pytest.mark.parametrize(
    ("positions", "changed", "error", "text"),
    [
        (edge() + np.array([0, 0, 0.05]), {}, NothingThereError, r"within 3 mm .* 7 other"),
        (edge(), {"reach": -1.0}, LoopError, "reach and depth"),
        (edge(), {"reach": np.nan}, LoopError, "reach and depth"),
        (edge(), {"depth": 2.0}, LoopError, "reach and depth"),
        (edge(), {"name": ""}, LoopError, "the name"),
        (edge(), {"name": "a\nb"}, LoopError, "the name"),
        (edge()[[0, 4, 2, 6]], {}, LoopError, "encloses no area"),
        (np.repeat(edge(), 100, axis=0), {}, LoopError, "800 positions"),
        (np.full((3, 3), np.nan), {}, LoopError, "not finite"),
        # Far apart, but all attached to one corner of the wall.
        (np.array([[-1, -1, 0], [-1, -2, 0], [-2, -1, 0]]) * 1e-3, {}, LoopError, "different"),
    ],
)
def test_what_is_no_hole_is_refused(
    positions: NDArray[np.float64],
    changed: dict[str, float | str],
    error: type[LoopError],
    text: str,
) -> None:
    mesh = holed_wall()
    wanted = {"name": "window", **changed}
    with pytest.raises(error, match=text):
        name_hole(mesh, mesh.rest[: mesh.node_rows], positions=positions, **wanted)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", [SURFACE, CONNECTED])
def test_holes_of_surfaces_are_open_until_a_patch_is_laid_over_them(kind: str) -> None:
    raw = shell() if kind == CONNECTED else ball()
    mesh = Mesh(with_sheet(raw, SheetSettings(kind), []))
    rest = mesh.rest[: mesh.node_rows]
    assert mesh.sheet_rows is not None
    cap = np.flatnonzero(rest[mesh.tets[: mesh.element_rows]][:, :2, 2].min(axis=1) > 0.013)
    mesh.apply(TopologyEdit(mesh.version, removed_elements=cap.astype(np.uint32)))
    rest = mesh.rest[: mesh.node_rows].copy()
    angles = 2.0 * np.pi * np.arange(16) / 16
    around = np.stack([0.014 * np.cos(angles), 0.014 * np.sin(angles), 0.0 * angles + 0.0135], 1)
    hole = name_hole(mesh, rest, "pole", around, reach=0.006)
    found = hole.closure(mesh, rest)
    assert found.covered < 0.15
    assert found.gap > 0.02
    mesh.apply(patch_edit(mesh, (-0.015, -0.015, 0.016), (8, 8), (0.03, 0.03)))
    rest = mesh.rest[: mesh.node_rows].copy()
    covered = hole.closure(mesh, rest)
    assert covered.by_patches == pytest.approx(1.0)
    assert covered.gap == 0.0
