from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cut_service.errors import CutCode, CutError
from cut_service.planner import METHODS, Plan, Settings, plan
from cut_service.sweep import Sweep
from support.cut_scenes import SIDE, bent, heart, middle, new, quality, raw_organ, rest, square
from support.valid_mesh import Shape, check_valid
from tissue_sim.elastic.model import State
from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.edit import StaleEditError
from tissue_sim.geometry.mesh import Mesh

NO_SNAP = Settings(snap=False)


def applied(mesh: Mesh, planned: Plan) -> Shape:
    mesh.apply(planned.edit)
    shape = check_valid(mesh)
    assert shape.components == planned.report.components
    return shape


def plan_or_miss(mesh: Mesh, sweep: Sweep, how: Settings | None = None) -> Plan | None:
    try:
        return plan(mesh, rest(mesh), sweep, settings=how)
    except CutError as error:
        if not error.code.nothing_to_cut:
            raise
        return None


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("name", ["block", "shaken"])
@pytest.mark.parametrize("where", [0.5, 0.42, 0.3])
def test_a_plane_through_a_block_makes_two_parts(name: str, axis: int, where: float) -> None:
    mesh = new(name)
    before = check_valid(mesh)
    centre = rest(mesh).min(axis=0) + where * np.ptp(rest(mesh), axis=0)
    planned = plan(mesh, rest(mesh), square(centre, np.eye(3)[axis], 1.0), settings=NO_SNAP)
    after = applied(mesh, planned)
    assert after.components == 2
    assert after.volume == pytest.approx(before.volume, rel=1e-12)
    assert after.surface_triangles == before.surface_triangles + 2 * planned.report.faces_split


def test_a_cut_along_the_grid_is_exact() -> None:
    mesh = new("block")
    x = np.unique(np.round(rest(mesh)[:, 0], 9))[3]
    centre = middle(mesh)
    centre[0] = x
    planned = plan(mesh, rest(mesh), square(centre, np.eye(3)[0], 1.0))
    report = planned.report
    assert (report.nodes_added, report.faces_split) == (6 * 8, 2 * 5 * 7)
    assert report.nodes_moved == 0
    assert report.distance_after[1] < 1e-9
    assert np.allclose(mesh.rest[mesh.node_rows_of(planned.edit.copy_parents), 0], x)


@pytest.mark.parametrize("name", ["block", "shaken", "wall", "shell"])
def test_every_cut_leaves_a_valid_mesh(name: str) -> None:
    @settings(max_examples=150, deadline=None)
    @given(
        seed=st.integers(0, 2**32 - 1),
        share=st.sampled_from([0.1, 0.25, 0.5, 5.0]),
        snap=st.booleans(),
    )
    def check(seed: int, share: float, snap: bool) -> None:
        random = np.random.default_rng(seed)
        mesh = new(name)
        before = check_valid(mesh)
        floor = min(Settings().quality_floor, quality(mesh).min())
        size = np.ptp(rest(mesh), axis=0).max()
        centre = rest(mesh)[random.integers(mesh.node_rows)]
        sweep = square(centre, random.normal(size=3), share * size, random.uniform(0, 6))
        planned = plan_or_miss(mesh, sweep, Settings(snap=snap))
        if planned is None:
            return
        after = applied(mesh, planned)
        if snap:
            assert abs(after.volume / before.volume - 1) < 1e-3
            assert after.volume - before.volume == pytest.approx(
                planned.report.volume_change, abs=1e-9 * before.volume
            )
            assert quality(mesh).min() >= floor * (1 - 1e-9)
        else:
            assert after.volume == pytest.approx(before.volume, rel=1e-12)

    check()


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(["block", "shaken", "wall", "shell"]))
def test_cuts_across_old_cuts_leave_a_valid_mesh(seed: int, name: str) -> None:
    random = np.random.default_rng(seed)
    mesh = new(name)
    start = check_valid(mesh)
    size = np.ptp(rest(mesh), axis=0).max()
    floor = min(Settings().quality_floor, quality(mesh).min())
    cuts = 0
    for _ in range(6):
        centre = middle(mesh) if random.random() < 0.3 else rest(mesh)[
            random.integers(mesh.node_rows)
        ]  # fmt: skip
        sweep = square(centre, random.normal(size=3), random.choice([0.2, 0.5, 3.0]) * size)
        planned = plan_or_miss(mesh, sweep)
        if planned is None:
            continue
        shape = applied(mesh, planned)
        cuts += 1
        assert abs(shape.volume / start.volume - 1) < 1e-3 * cuts
    assert quality(mesh).min() >= floor * (1 - 1e-9)


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_strips_of_any_shape_leave_a_valid_mesh(seed: int) -> None:
    random = np.random.default_rng(seed)
    mesh = new("shaken")
    blade = middle(mesh) + np.linspace([-1, 0, 0], [1, 0, 0], 3) * SIDE
    depth = np.array([0, -0.1, 0.8 * SIDE])
    bend = random.uniform(-0.3, 0.3, 3) * SIDE
    start, end = blade + depth + bend, blade - depth
    start[1] -= bend
    with np.errstate(all="ignore"):
        sweep = Sweep.between(start, end)
    planned = plan_or_miss(mesh, sweep)
    if planned is not None:
        applied(mesh, planned)


def test_snapping_brings_the_cut_closer_to_the_sweep() -> None:
    mesh = new("shaken")
    sweep = square(middle(mesh), np.array([1.0, 0.4, 0.2]), 1.0)
    planned = plan(mesh, rest(mesh), sweep)
    assert planned.report.distance_after[0] < 0.2 * planned.report.distance_before[0]
    moved = plan(mesh, rest(mesh), sweep, settings=NO_SNAP).report
    assert moved.distance_after == moved.distance_before == planned.report.distance_before


def test_a_partial_cut_keeps_its_rim_and_opens_the_surface() -> None:
    mesh = new("shaken")
    before = check_valid(mesh)
    centre = middle(mesh)
    centre[2] = rest(mesh)[:, 2].max()
    planned = plan(mesh, rest(mesh), square(centre, np.eye(3)[0], 0.6 * SIDE, 0.0))
    after = applied(mesh, planned)
    assert after.components == 1
    assert after.surface_triangles == before.surface_triangles + 2 * planned.report.faces_split
    # Euler: of the faces that open, those at the rim share its nodes on both sides.
    assert 0 < planned.report.nodes_added < 3 * planned.report.faces_split


def test_surface_nodes_stay_on_the_surface_and_corners_stay() -> None:
    mesh = new("block")
    lower, upper = rest(mesh).min(axis=0), rest(mesh).max(axis=0)
    on = (np.isclose(rest(mesh), lower) | np.isclose(rest(mesh), upper)).sum(axis=1)
    planned = plan(mesh, rest(mesh), square(middle(mesh), np.array([1.0, 0.3, 0.7]), 1.0))
    rows = mesh.node_rows_of(planned.edit.moved_nodes)
    new_rest = planned.edit.moved_rest
    still_on = (np.isclose(new_rest, lower) | np.isclose(new_rest, upper)).sum(axis=1)
    assert np.array_equal(still_on, on[rows])
    assert (on[rows] == 1).any()
    assert (on[rows] == 2).any()
    assert not (on[rows] == 3).any()
    assert planned.report.volume_change == pytest.approx(0.0, abs=1e-15)


def test_fixed_and_held_nodes_are_split_but_never_moved() -> None:
    fixed = np.zeros(len(raw_organ("shaken").points), dtype=np.bool_)
    fixed[::3] = True
    mesh = new("shaken", fixed)
    held = mesh.node_ids[: mesh.node_rows][1::3]
    sweep = square(middle(mesh), np.array([1.0, 0.4, 0.2]), 1.0)
    edit = plan(mesh, rest(mesh), sweep, held=held).edit
    assert len(edit.moved_nodes)
    assert not np.isin(edit.moved_nodes, held).any()
    assert not fixed[mesh.node_rows_of(edit.moved_nodes)].any()
    assert np.isin(edit.copy_parents, held).any()
    change = mesh.apply(edit)
    assert np.array_equal(mesh.fixed[change.copied_nodes], mesh.fixed[change.copy_parents])
    assert mesh.fixed[change.copied_nodes].any()


def test_cuts_in_the_deformed_shape_and_pulls_the_new_places_back() -> None:
    mesh = new("shaken")
    shape = bent(rest(mesh))
    centre = 0.5 * (shape.min(axis=0) + shape.max(axis=0))
    sweep = square(centre, np.array([1.0, 0.2, 0.5]), 1.0)
    planned = plan(mesh, shape, sweep)
    edit = planned.edit
    anchors = mesh.node_rows_of(edit.moved_anchors)
    assert edit.moved_weights.min() >= 0
    np.testing.assert_allclose(edit.moved_weights.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(
        np.einsum("ij,ijk->ik", edit.moved_weights, mesh.rest[anchors]), edit.moved_rest, atol=1e-12
    )

    state = State(mesh, np.float64)
    state.displacement[: mesh.node_rows] = shape - rest(mesh)
    change = mesh.apply(edit)
    state.follow(mesh, change)
    now = state.positions(mesh)
    assert check_valid(mesh).components == planned.report.components == 2
    # Seen by the person: the lips lie on the sweep, together, and no element turned over.
    lips = mesh.node_rows_of(edit.copy_parents)
    assert np.median(sweep.distance(np.asarray(now, dtype=np.float64)[lips])) < 1e-6
    np.testing.assert_array_equal(now[change.copied_nodes], now[change.copy_parents])
    rows = mesh.element_rows
    a, b, c, d = (now[mesh.tets[:rows, k]] for k in range(4))
    assert (np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) > 0).all()


def test_a_plan_is_stale_only_if_what_it_read_changed() -> None:
    mesh = new("shaken")
    sideways = np.array([0.35 * SIDE, 0.0, 0.0])
    near = square(middle(mesh) - sideways, np.eye(3)[0], 0.4 * SIDE)
    far = square(middle(mesh) + sideways, np.eye(3)[0], 0.4 * SIDE)
    first, second = plan(mesh, rest(mesh), near), plan(mesh, rest(mesh), far)
    again = plan(mesh, rest(mesh), near, settings=NO_SNAP)
    mesh.apply(first.edit)
    mesh.apply(second.edit)
    check_valid(mesh)
    with pytest.raises(StaleEditError):
        mesh.apply(again.edit)


def test_planning_changes_nothing_and_is_repeatable() -> None:
    mesh = new("shaken")
    before = mesh.rest.copy(), mesh.tets.copy(), mesh.version
    sweep = square(middle(mesh), np.array([1.0, 0.3, 0.1]), 1.0)
    one, two = plan(mesh, rest(mesh), sweep).edit, plan(mesh, rest(mesh), sweep).edit
    assert np.array_equal(before[0], mesh.rest)
    assert np.array_equal(before[1], mesh.tets)
    assert before[2] == mesh.version
    for name in ("moved_rest", "rewritten_nodes", "copy_parents", "read_elements"):
        assert np.array_equal(getattr(one, name), getattr(two, name))


def test_float32_positions_of_a_state_make_the_same_cut() -> None:
    mesh = new("block")
    sweep = square(middle(mesh), np.array([1.0, 0.3, 0.1]), 1.0)
    exact = plan(mesh, rest(mesh), sweep).edit
    rounded = plan(mesh, rest(mesh).astype(np.float32), sweep).edit
    assert np.array_equal(exact.copy_parents, rounded.copy_parents)
    assert np.array_equal(exact.rewritten_elements, rounded.rewritten_elements)


@pytest.mark.parametrize("shift", [3.0, -3.0])
def test_a_sweep_beside_the_organ_misses(shift: float) -> None:
    mesh = new("block")
    centre = middle(mesh) + np.array([shift * SIDE, 0, 0])
    with pytest.raises(CutError, match="crosses no tissue") as caught:
        plan(mesh, rest(mesh), square(centre, np.eye(3)[0], 1.0))
    assert caught.value.code == CutCode.MISSED


def test_a_scratch_too_shallow_to_part_anything_misses() -> None:
    mesh = new("block")
    centre = rest(mesh).min(axis=0) + np.array([0.47, 0.47, 0.0]) * SIDE
    with pytest.raises(CutError, match="too short or too shallow") as caught:
        plan(mesh, rest(mesh), square(centre, np.eye(3)[0], 0.1 * SIDE))
    assert caught.value.code == CutCode.MISSED


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("by", ["fixed", "held"])
def test_refuses_to_cut_fixed_or_held_nodes_alone(method: str, by: str) -> None:
    mesh = new("block")
    sweep = square(middle(mesh), np.eye(3)[0], 1.0)
    parted = mesh.node_rows_of(plan(mesh, rest(mesh), sweep).edit.copy_parents)

    def cut(still: NDArray[np.bool_]) -> Plan:
        mesh.fixed[: mesh.node_rows] = still if by == "fixed" else False
        held = mesh.node_ids[: mesh.node_rows][still] if by == "held" else None
        return plan(mesh, rest(mesh), sweep, method, settings=NO_SNAP, held=held)

    near = np.abs(rest(mesh)[:, 0] - middle(mesh)[0]) < 2.1 * SIDE
    with pytest.raises(CutError, match=r"fixed or held by tools.*let go first") as caught:
        cut(near)
    assert caught.value.code == CutCode.HELD
    # Where some of what is parted is free there is something to open.
    near[parted[:6]] = near[mesh.tets[mesh.incident.of(int(parted[0]))]] = False
    planned = cut(near)
    assert len(planned.edit.copied_nodes) + len(planned.edit.removed_elements) > 0


def test_refuses_unknown_methods_and_positions_that_do_not_fit() -> None:
    mesh = new("block")
    sweep = square(middle(mesh), np.eye(3)[0], 1.0)
    with pytest.raises(CutError, match="known: split") as caught:
        plan(mesh, rest(mesh), sweep, "melt")
    assert caught.value.code == CutCode.UNKNOWN_METHOD
    with pytest.raises(CutError, match="positions of"):
        plan(mesh, rest(mesh)[:-1], sweep)
    broken = rest(mesh).copy()
    broken[3, 1] = np.nan
    with pytest.raises(CutError, match="not finite"):
        plan(mesh, broken, sweep)
    with pytest.raises(CutError, match="units metres"):
        plan(mesh, rest(mesh), square(middle(mesh), np.eye(3)[0], 1000.0))


def smallest_part(mesh: Mesh) -> int:
    rows = mesh.element_rows
    tets, alive = mesh.tets[:rows], mesh.element_alive[:rows]
    _, labels = connected_components(tets, alive, mesh.node_rows)
    return int(np.bincount(labels[tets[alive, 0]]).min())


@pytest.mark.parametrize(
    ("name", "seed"), [("shaken", 0), ("shaken", 113), ("shell", 104), ("wall", 142)]
)
def test_crumbs_are_not_cut_free(name: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    start = new(name)
    centre = rest(start)[random.integers(start.node_rows)]
    sweep = square(centre, random.normal(size=3), 3 * np.ptp(rest(start), axis=0).max())
    sizes = []
    for how in (Settings(smallest_piece=1), Settings()):
        mesh = new(name)
        planned = plan_or_miss(mesh, sweep, how)
        if planned is not None:
            applied(mesh, planned)
        sizes.append(smallest_part(mesh))
    assert sizes[0] < Settings().smallest_piece <= sizes[1]


def test_cuts_of_the_heart_are_valid_and_faithful(shared_meshes: Path) -> None:
    mesh = Mesh(heart(shared_meshes))
    before = check_valid(mesh)
    floor = min(Settings().quality_floor, quality(mesh).min())
    random = np.random.default_rng(3)
    for half in (0.012, 0.008, 1.0, 0.012, 0.015):
        centre = rest(mesh)[random.integers(mesh.node_rows)]
        planned = plan(mesh, rest(mesh), square(centre, random.normal(size=3), half))
        report = planned.report
        assert report.faces_split > 50
        assert report.distance_after[0] < 0.35 * report.distance_before[0]
        after = applied(mesh, planned)
        assert abs(after.volume / before.volume - 1) < 1e-3
        before = after
    assert quality(mesh).min() >= floor * (1 - 1e-9)
