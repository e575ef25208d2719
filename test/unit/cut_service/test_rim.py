"""Sewing a patch in: its rim, how that is matched to the edge of a hole, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cut_service.loops import along, closest_shares, matched, shares_of
from cut_service.planner import plan
from cut_service.rim import patch_of, plan_rim
from cut_service.suturing import Sewing, SutureCode, SutureError, plan_tightening
from cut_service.sweep import Sweep
from cut_service.validity import look_at
from support.holed_wall import HOLE, SIDE, TOP, add_patch, edge, holed_wall
from support.patches import SOFT, grid, patch_edit
from support.sheets import ball, connected
from tissue_sim.geometry.closure import area_vector, perimeter
from tissue_sim.geometry.edit import NO_PARENT, PATCH, PROVISIONAL, TopologyEdit
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.patch_rims import rims_of
from tissue_sim.geometry.patches import Patch
from tissue_sim.geometry.sheet_edit import NO_NODE
from tissue_sim.geometry.sheet_geometry import SURFACE, SheetSettings, with_sheet

NO_LOOP = np.empty((0, 3))
MIDDLE = np.array([0.5 * SIDE, 0.5 * SIDE])


def patched(**how: float) -> tuple[Mesh, NDArray[np.float64]]:
    mesh = holed_wall()
    add_patch(mesh, **how)  # type: ignore[arg-type]
    return mesh, mesh.rest[: mesh.node_rows].copy()


def of_patch(mesh: Mesh) -> NDArray[np.int64]:
    rows = mesh.element_rows
    (patch,) = mesh.patches
    own = mesh.element_alive[:rows] & (mesh.regions[:rows] == patch.label)
    return np.unique(mesh.tets[:rows][own])


def ends(mesh: Mesh, edit: TopologyEdit) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    rows = mesh.node_rows_of(edit.suture_nodes)
    return rows[:, 0], rows[:, 1]


def test_the_rims_of_a_slab_run_around_both_of_its_sides() -> None:
    mesh, rest = patched(size=0.014, above=0.0005)
    (patch,) = mesh.patches
    rims = rims_of(mesh, patch)
    assert sorted(rim.upper for rim in rims) == [False, True]
    for rim in rims:
        assert len(rim.nodes) == len(set(rim.nodes.tolist())) == 4 * 7
        assert rim.length == pytest.approx(4 * 0.014)
        line = rest[rim.nodes]
        assert np.abs(line[:, :2] - MIDDLE).max(axis=1) == pytest.approx(0.007)
        assert line[:, 2] == pytest.approx(TOP + 0.0005 + (patch.thickness if rim.upper else 0.0))
        assert area_vector(line) == pytest.approx([0.0, 0.0, 0.014**2])


def test_a_patch_of_two_sheets_has_the_same_rims() -> None:
    mesh = connected()
    mesh.apply(patch_edit(mesh, (0.5, 0.0, 0.0)))
    (patch,) = mesh.patches
    rims = rims_of(mesh, patch)
    assert sorted(rim.upper for rim in rims) == [False, True]
    for rim in rims:
        assert rim.length == pytest.approx(2 * (0.012 + 0.009))
        assert area_vector(mesh.rest[rim.nodes]) == pytest.approx([0.0, 0.0, 0.012 * 0.009])


def test_a_single_surface_has_one_rim() -> None:
    mesh = Mesh(with_sheet(ball(), SheetSettings(SURFACE), []))
    patch = replace(SOFT, name="flat")
    points, triangles = grid((5, 4), (0.012, 0.009))
    mesh.apply(single_edit(mesh, points + np.array([-0.006, -0.004, 0.0205]), triangles, patch))
    (rim,) = rims_of(mesh, mesh.patches.items[0])
    assert rim.upper
    assert rim.length == pytest.approx(2 * (0.012 + 0.009))
    edit = plan_rim(
        mesh, mesh.rest[: mesh.node_rows], mesh.patches.items[0], Sewing(NO_LOOP, 0.003, reach=0.01)
    )
    assert len(edit.added_sutures) == 14


def single_edit(
    mesh: Mesh, points: NDArray[np.float64], triangles: NDArray[np.int32], patch: Patch
) -> TopologyEdit:
    """An edit that adds one sheet of triangles."""
    items = np.full((len(triangles), 4), NO_NODE, dtype=np.uint32)
    items[:, :3] = PROVISIONAL + triangles.astype(np.int64)
    return TopologyEdit(
        mesh.version,
        kind=PATCH,
        born_nodes=(PROVISIONAL + np.arange(len(points))).astype(np.uint32),
        born_rest=points,
        added_elements=(PROVISIONAL + np.arange(len(items))).astype(np.uint32),
        added_nodes=items,
        added_parents=np.full(len(items), NO_PARENT, dtype=np.uint32),
        born_kinds=np.zeros(len(items), dtype=np.uint8),
        born_tissue=np.full(len(items), patch.thickness),
        added_patches=(patch,),
    )


def test_a_trimmed_patch_has_a_new_rim() -> None:
    mesh, shape = patched(size=0.014, above=0.002)
    x = 0.5 * SIDE + 0.003
    low, high = TOP + 0.0015, TOP + 0.005
    lines = [[[x, -0.01, z], [x, SIDE + 0.01, z]] for z in (high, low)]
    mesh.apply(plan(mesh, shape, Sweep.between(*map(np.array, lines)), "split").edit)
    (patch,) = mesh.patches
    rims = rims_of(mesh, patch)
    assert len(rims) == 4
    for rim in rims[:2]:
        line = mesh.rest[rim.nodes]
        assert line[:, 0].min() == pytest.approx(0.5 * SIDE - 0.007)
        assert line[:, 0].max() == pytest.approx(x, abs=0.0011)
        assert (mesh.rest[rim.nodes, 2] > TOP + 0.001).all()
    edit = plan_rim(mesh, mesh.rest[: mesh.node_rows], patch, Sewing(NO_LOOP, 0.002, reach=0.003))
    kept, _ = ends(mesh, edit)
    assert mesh.rest[kept, 0].max() == pytest.approx(x, abs=0.0011)


def test_stitches_join_rim_and_edge_evenly_in_the_same_order() -> None:
    mesh, shape = patched()
    (patch,) = mesh.patches
    edit = plan_rim(mesh, shape, patch, Sewing(edge(), spacing=0.0025, length=0.0))
    assert edit.kind == "suture"
    rim, tissue = ends(mesh, edit)
    # The longer line has 56 mm; the tissue's edge has a node every 2.5 mm: each is sewn once.
    assert len(tissue) == len(np.unique(tissue)) == 16
    assert np.isin(rim, of_patch(mesh)).all()
    assert not np.isin(tissue, of_patch(mesh)).any()
    # The lower side is closer; the tissue is at the edge of the hole.
    assert shape[rim, 2] == pytest.approx(TOP + 0.0005)
    assert np.abs(shape[tissue, :2] - MIDDLE).max(axis=1) == pytest.approx(0.5 * HOLE)
    assert shape[tissue, 2] == pytest.approx(TOP)
    across = np.linalg.norm(shape[rim] - shape[tissue], axis=1)
    # No stitch pulls along the edge by more than half of what the rim's nodes are apart.
    assert across.max() < np.hypot(np.sqrt(2) * 0.002, 0.0015)
    gaps = np.linalg.norm(np.roll(shape[rim], -1, axis=0) - shape[rim], axis=1)
    assert (gaps.min() >= 0.0019, gaps.max() <= 0.0041) == (True, True)
    assert (edit.suture_lengths == 0.0).all()
    assert edit.suture_groups.tolist() == edit.added_sutures.tolist()


def test_a_running_thread_goes_around_and_closes() -> None:
    mesh, shape = patched()
    (patch,) = mesh.patches
    edit = plan_rim(mesh, shape, patch, Sewing(edge(), 0.0025, running=True, length=0.0002))
    first, second = ends(mesh, edit)
    assert len(first) == 2 * 16
    assert set(edit.suture_groups.tolist()) == {int(edit.added_sutures[0])}
    # Every stitch begins where the one before ended, the first where the last did.
    assert first.tolist() == np.roll(second, 1).tolist()
    way = np.linalg.norm(np.roll(shape[first[::2]], -1, axis=0) - shape[first[::2]], axis=1)
    np.testing.assert_allclose(edit.suture_lengths[1::2], np.hypot(0.0002, way))
    mesh.apply(edit)
    tight = plan_tightening(mesh, shape, mesh.sutures, 0.0001)
    np.testing.assert_allclose(tight.changed_lengths[1::2], np.hypot(0.0001, way))


def test_without_a_loop_the_rim_is_sewn_to_the_closest_tissue() -> None:
    mesh, shape = patched()
    (patch,) = mesh.patches
    edit = plan_rim(mesh, shape, patch, Sewing(NO_LOOP, spacing=0.002, reach=0.003))
    rim, tissue = ends(mesh, edit)
    others = np.setdiff1d(np.flatnonzero(mesh.node_alive), of_patch(mesh))
    away = np.linalg.norm(shape[others][None] - shape[rim][:, None], axis=2)
    np.testing.assert_allclose(
        np.linalg.norm(shape[tissue] - shape[rim], axis=1), away.min(axis=1), atol=1e-12
    )
    assert len(np.unique(edit.suture_nodes, axis=0)) == len(rim)


@pytest.mark.parametrize("upside_down", [False, True])
def test_the_side_that_is_closer_is_sewn(upside_down: bool) -> None:
    mesh, shape = patched()
    if upside_down:
        own = of_patch(mesh)
        middle = np.append(MIDDLE, TOP + 0.001)
        shape[own] = middle + Rotation.from_rotvec([np.pi, 0, 0]).apply(shape[own] - middle)
    (patch,) = mesh.patches
    rim, _ = ends(mesh, plan_rim(mesh, shape, patch, Sewing(edge(), 0.0025)))
    height = TOP + 0.0005 + (patch.thickness if upside_down else 0.0)
    assert mesh.rest[rim, 2] == pytest.approx(height)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("turn", [0.0, 0.9, 2.9])
def test_matching_finds_direction_and_start(direction: int, turn: float) -> None:
    angles = 2 * np.pi * np.arange(24) / 24
    line = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    far = Rotation.from_rotvec([0, 0, turn]).apply(1.2 * line)[::direction]
    match = matched(line, np.repeat(far, 5, axis=0), 24)
    assert match.cost == pytest.approx(0.2**2, rel=0.1)
    places = match.opposite(angles / (2 * np.pi))
    np.testing.assert_allclose(places, 1.2 * line, atol=0.03)
    inside = match.shares_at(places[1:])
    np.testing.assert_allclose(inside, angles[1:] / (2 * np.pi), atol=1e-3)


def test_places_along_a_loop_are_evenly_apart() -> None:
    loop = edge()
    assert perimeter(loop) == pytest.approx(4 * HOLE)
    places = along(loop, np.arange(40) / 40)
    gaps = np.linalg.norm(np.roll(places, -1, axis=0) - places, axis=1)
    np.testing.assert_allclose(gaps, 0.001)
    np.testing.assert_allclose(shares_of(loop), np.arange(8) / 8)
    assert closest_shares(shares_of(loop), np.array([0.99, 0.26, 0.8])).tolist() == [0, 2, 6]


def test_a_patch_is_named_by_id_by_name_or_by_being_the_only_one() -> None:
    mesh, _ = patched()
    first = patch_of(mesh, 0, "")
    assert patch_of(mesh, first.id, "") == patch_of(mesh, 0, first.name) == first
    add_patch(mesh, above=0.01, patch=replace(SOFT, name="felt"))
    assert patch_of(mesh, 0, "felt").id == first.id + 1
    for patch_id, name in ((0, ""), (9, ""), (0, "silk"), (first.id, "felt")):
        with pytest.raises(SutureError, match=r"1 \(patch 1\), 2 \(felt\)") as caught:
            patch_of(mesh, patch_id, name)
        assert caught.value.code == SutureCode.UNKNOWN_PATCH
    with pytest.raises(SutureError, match="none"):
        patch_of(holed_wall(), 0, "")


@settings(max_examples=25, deadline=None)
@given(
    turn=st.tuples(*[st.floats(-4.0, 4.0)] * 3),
    shift=st.tuples(*[st.floats(-0.02, 0.02)] * 3),
    scale=st.floats(0.0, 2.0),
    spacing=st.floats(5e-4, 0.1),
    running=st.booleans(),
    length=st.floats(-2.0, 0.01),
    with_loop=st.booleans(),
)
def test_wherever_the_patch_is_stitches_are_valid_and_undone(
    turn: tuple[float, ...],
    shift: tuple[float, ...],
    scale: float,
    spacing: float,
    running: bool,
    length: float,
    with_loop: bool,
) -> None:
    mesh, shape = patched()
    own, middle = of_patch(mesh), np.append(MIDDLE, TOP)
    turned = Rotation.from_rotvec(turn).apply(scale * (shape[own] - middle))
    shape[own] = turned + middle + shift
    (patch,) = mesh.patches
    wanted = Sewing(edge() if with_loop else NO_LOOP, spacing, running, 0.1, 0.0, length)
    edit = plan_rim(mesh, shape, patch, wanted)
    rim, tissue = ends(mesh, edit)
    stitches = slice(None, None, 2) if running else slice(None)
    assert np.isin(rim[stitches], of_patch(mesh)).all()
    assert not np.isin(tissue[stitches], of_patch(mesh)).any()
    pairs = edit.suture_nodes[stitches]
    assert len(np.unique(pairs, axis=0)) == len(pairs) >= 1
    history = EditHistory()
    history.record(mesh.apply(edit))
    assert look_at(mesh).faults == ()
    history.record(mesh.apply(history.undo(mesh)))
    assert len(mesh.sutures) == 0


def test_what_nothing_is_left_of_has_no_rim() -> None:
    mesh, _ = patched()
    (patch,) = mesh.patches
    rows = np.flatnonzero(mesh.regions[: mesh.element_rows] == patch.label)
    mesh.apply(TopologyEdit(mesh.version, removed_elements=mesh.element_ids[rows]))
    with pytest.raises(SutureError, match="no rim") as caught:
        plan_rim(mesh, mesh.rest[: mesh.node_rows], patch, Sewing(edge(), spacing=0.0025))
    assert caught.value.code == SutureCode.NO_RIM


CROSSED = edge()[[0, 4, 2, 6]]


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"spacing": 0.0}, SutureCode.INVALID),
        ({"spacing": -0.001}, SutureCode.INVALID),
        ({"spacing": np.nan}, SutureCode.INVALID),
        ({"spacing": 1e-9}, SutureCode.INVALID),
        ({"reach": 1.0}, SutureCode.INVALID),
        ({"stiffness": -1.0}, SutureCode.INVALID),
        ({"length": 99.0}, SutureCode.INVALID),
        ({"positions": np.full((4, 3), np.inf)}, SutureCode.INVALID),
        ({"positions": edge()[:2]}, SutureCode.INVALID),
        ({"positions": CROSSED}, SutureCode.INVALID),
        ({"positions": edge() + np.array([0.0, 0.0, 0.05])}, SutureCode.NOTHING_THERE),
        ({"positions": NO_LOOP, "reach": 0.0003}, SutureCode.NOTHING_THERE),
    ],
)
def test_bad_requests_are_refused(changed: dict[str, object], code: SutureCode) -> None:
    mesh, shape = patched()
    (patch,) = mesh.patches
    wanted = replace(Sewing(edge(), spacing=0.0025), **changed)  # type: ignore[arg-type]
    with pytest.raises(SutureError) as caught:
        plan_rim(mesh, shape, patch, wanted)
    assert caught.value.code == code, caught.value
    assert str(caught.value)
