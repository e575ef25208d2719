"""Two blocks sewn together, in every model."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from support.elastic_scenes import MATERIAL, NO_ROWS, VARIANTS, apply, build, settle
from support.sewn_blocks import sew_edit, tighten_edit, two_blocks
from support.sheets import WITH_TORSION, strip
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Model, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.stiffness import Stiffness
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sheet_geometry import SURFACE, SheetSettings, with_sheet
from tissue_sim.geometry.sutures import tensions

CLOSED = 0.05e-3
"""Lips a millimetre apart, sewn with rest length 0, come as near as this [m] in every model."""

TESTED = [variant for variant in VARIANTS if "Runge" not in variant and "Euler" not in variant]
"""Other integrators of springs and masses take the same forces."""

IN_BALANCE = set(TESTED) - {"relaxation", "chain_mail", "voxel_chain_mail", "lr"}
"""Variants whose forces are in balance at rest: relaxation moves nodes against them in LR."""


def sewn(variant: str, length: float = 0.0, gap: float = 0.001) -> tuple[Mesh, Model, State]:
    mesh, left, right = two_blocks(gap)
    name, parameters = VARIANTS[variant]
    model = registry.build(name, mesh, MATERIAL, dict(parameters))
    state = State(mesh)
    model.prescribed_changed(state, NO_ROWS)
    apply(mesh, model, state, sew_edit(mesh, left, right, length))
    return mesh, model, state


def edges(mesh: Mesh, state: State) -> NDArray[np.float64]:
    a, b = mesh.sutures.nodes.T
    at = mesh.rest[: mesh.node_rows] + state.displacement[: mesh.node_rows]
    return np.asarray(at[b] - at[a])


def pull(mesh: Mesh, state: State) -> NDArray[np.float64]:
    """Sum of the threads' pull on the left block [N]."""
    e = edges(mesh, state)
    force = tensions(mesh.sutures, mesh.rest, state.displacement)
    return np.asarray((force[:, None] * e / np.linalg.norm(e, axis=1)[:, None]).sum(axis=0))


def reactions(mesh: Mesh, model: Model, state: State) -> NDArray[np.float64]:
    """Forces of the tissue on what holds the left and the right block [N], shape (2, 3)."""
    fixed = np.flatnonzero(mesh.fixed[: mesh.node_rows]).astype(np.int32)
    force = model.forces(state, fixed)
    left = mesh.rest[fixed, 0] < 1e-9
    return np.stack([force[left].sum(axis=0), force[~left].sum(axis=0)])


@pytest.mark.parametrize("variant", TESTED)
def test_threads_without_rest_length_close_the_gap_and_pull_as_hard_as_the_tissue(
    variant: str,
) -> None:
    mesh, model, state = sewn(variant)
    settle(model, state)
    assert np.linalg.norm(edges(mesh, state), axis=1).max() < CLOSED
    if variant in IN_BALANCE:
        threads, (left, right) = pull(mesh, state), reactions(mesh, model, state)
        assert threads[0] > 0.05
        np.testing.assert_allclose(left, threads, atol=3e-3 * threads[0])
        np.testing.assert_allclose(right, -threads, atol=3e-3 * threads[0])


@pytest.mark.parametrize("variant", TESTED)
def test_a_thread_gives_up_to_its_rest_length_and_is_tightened(variant: str) -> None:
    mesh, model, state = sewn(variant, length=0.0008)
    settle(model, state)
    before = np.linalg.norm(edges(mesh, state), axis=1)
    assert (before > 0.00079).all()
    assert (before < 0.00083).all()
    apply(mesh, model, state, tighten_edit(mesh, 0.0004))
    settle(model, state)
    after = np.linalg.norm(edges(mesh, state), axis=1)
    assert (after > 0.00039).all()
    assert (after < 0.00045).all()
    if variant in IN_BALANCE:
        threads, (left, _) = pull(mesh, state), reactions(mesh, model, state)
        np.testing.assert_allclose(left, threads, atol=1e-2 * threads[0])


@pytest.mark.parametrize("variant", VARIANTS)
def test_slack_threads_do_nothing_bit_for_bit(variant: str) -> None:
    mesh, model, state = sewn(variant, length=0.002)
    for _ in range(20):
        model.step(state)
    assert not state.displacement.any()
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    assert not model.forces(state, rows).any()


@pytest.mark.parametrize("variant", sorted(IN_BALANCE))
def test_a_model_that_followed_has_the_forces_of_one_built_afresh(variant: str) -> None:
    mesh, model, state = sewn(variant)
    for _ in range(60):
        model.step(state)
    apply(mesh, model, state, tighten_edit(mesh, 0.0003))
    gone = TopologyEdit(mesh.version, kind="unsuture", removed_sutures=mesh.sutures.ids[2:7])
    apply(mesh, model, state, gone)
    name, parameters = VARIANTS[variant]
    fresh = registry.build(name, mesh, MATERIAL, dict(parameters))
    fresh.prescribed_changed(state, NO_ROWS)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    force = fresh.forces(state, rows)
    np.testing.assert_allclose(model.forces(state, rows), force, atol=1e-5 * np.abs(force).max())


def test_a_block_that_hangs_by_threads_alone_goes_where_the_other_one_is_taken() -> None:
    mesh, left, right = two_blocks()
    mesh.fixed[:] = False
    model, state = build("finite_element", mesh)
    apply(mesh, model, state, sew_edit(mesh, left, right))
    held = np.flatnonzero(mesh.rest[: mesh.node_rows, 0] < 1e-9).astype(np.int32)
    state.prescribed[held] = True
    model.prescribed_changed(state, held)
    settle(model, state)
    before = state.displacement.copy()
    state.displacement[held] += [0.0, 0.002, 0.0]
    settle(model, state)
    moved = (state.displacement - before)[: mesh.node_rows]
    np.testing.assert_allclose(moved, np.broadcast_to([0.0, 0.002, 0.0], moved.shape), atol=2e-5)


def test_the_search_from_a_hold_goes_along_threads() -> None:
    mesh, left, right = two_blocks()
    model, state = build("quasi_static", mesh)
    held = np.array([0], dtype=np.int32)
    ordering = model.active.ordering  # type: ignore[attr-defined]
    model.prescribed_changed(state, held)
    assert (ordering.level[right] < 0).all()
    apply(mesh, model, state, sew_edit(mesh, left, right))
    model.prescribed_changed(state, held)
    np.testing.assert_array_equal(ordering.level[right] <= ordering.level[left] + 1, True)


def test_stitches_stay_listed_behind_the_springs_whatever_is_cut_where() -> None:
    mesh, left, right = two_blocks()
    springs = SpringNetwork(mesh, MATERIAL)
    springs.follow(mesh.apply(sew_edit(mesh, left, right)))
    random = np.random.default_rng(2)
    kept = 0
    for element in random.permutation(mesh.element_rows)[:40]:
        edit = TopologyEdit(mesh.version, removed_elements=np.array([element], dtype=np.uint32))
        links = springs.links
        springs.follow(mesh.apply(edit))
        kept += springs.links is links
        fresh = SpringNetwork(mesh, MATERIAL)
        for network in (springs, fresh):
            ends, places = network.stitches.threads.ends, network.stitch_places
            begin, springs_at = network.arrays.start, network.arrays.degree
            assert (network.arrays.neighbour[places] == ends[:, ::-1]).all()
            assert (places >= begin[ends].astype(np.int64) + springs_at[ends]).all()
            assert (places < begin[ends].astype(np.int64) + network.links[ends]).all()
        np.testing.assert_array_equal(springs.links, fresh.links)
    assert 0 < kept < 40


def test_a_matrix_with_stitches_is_symmetric_and_has_no_force_for_translations() -> None:
    mesh, model, _ = sewn("finite_element")
    stiffness: Stiffness = model.stiffness  # type: ignore[attr-defined]
    rows, count = stiffness.rows, mesh.node_rows
    K = np.zeros((count, 3, count, 3))
    for i in range(count):
        for place in range(rows.start[i], rows.start[i] + rows.degree[i]):
            K[i, :, rows.neighbour[place]] += rows.blocks[place].reshape(3, 3)
    dense = K.reshape(3 * count, 3 * count)
    np.testing.assert_allclose(dense, dense.T, atol=1e-5 * np.abs(dense).max())
    a, b = mesh.sutures.nodes[0]
    np.testing.assert_allclose(K[a, :, b], -1000.0 * np.eye(3))


@pytest.mark.parametrize(
    "parameters", [{"interest_radius": 0.004, "interest_x": 0.012}, {"direct": 1.0}]
)
def test_precomputed_elements_refuse_sewn_tissue(parameters: dict[str, float]) -> None:
    mesh, left, right = two_blocks()
    mesh.apply(sew_edit(mesh, left, right))
    with pytest.raises(ValueError, match=r"the tissue is sewn, and .* knows no stitches"):
        registry.build("finite_element", mesh, MATERIAL, parameters)


def test_direct_factors_end_with_the_first_stitch_and_the_result_is_the_same() -> None:
    mesh, left, right = two_blocks()
    model, state = build("finite_element", mesh, direct=1.0)
    apply(mesh, model, state, sew_edit(mesh, left, right))
    assert any("conjugate gradients go on" in event for event in model.events)
    settle(model, state)
    other, iterated, expected = sewn("finite_element")
    settle(iterated, expected)
    np.testing.assert_allclose(edges(mesh, state), edges(other, expected), atol=1e-7)


def test_explicit_steps_stay_stable_with_a_thread_a_hundred_times_as_stiff() -> None:
    mesh, left, right = two_blocks()
    model, state = build("spring_mass", mesh)
    apply(mesh, model, state, sew_edit(mesh, left, right, stiffness=1e5))
    assert any("are added to nodes" in event for event in model.events)
    for _ in range(4000):
        model.step(state)
    assert np.abs(state.displacement).max() < 0.001
    assert np.linalg.norm(edges(mesh, state), axis=1).max() < 1e-4


@pytest.mark.parametrize(("length", "gap"), [(0.0004, 0.001), (0.0001, 0.002), (0.0, 0.002)])
def test_lips_pulled_together_at_once_come_to_rest_in_explicit_steps(
    length: float, gap: float
) -> None:
    _, model, state = sewn("spring_mass", length, gap)
    for _ in range(3000):
        model.step(state)
    assert model.residual(state) < 1e-6


def test_a_hold_lets_go_and_what_is_sewn_stays_sewn() -> None:
    mesh, model, state = sewn("vertex_block_descent")
    settle(model, state)
    rest = state.displacement.copy()
    held = mesh.sutures.nodes[:4].ravel().astype(np.int32)
    state.prescribed[held] = True
    model.prescribed_changed(state, np.sort(held))
    state.displacement[held] += [0.0, 0.001, 0.0]
    settle(model, state, 2)
    state.prescribed[held] = False
    model.prescribed_changed(state, NO_ROWS)
    settle(model, state)
    np.testing.assert_allclose(state.displacement, rest, atol=2e-6)


@pytest.mark.parametrize("model_name", ["quasi_static", "spring_mass", "relaxation"])
def test_surfaces_with_torsion_are_sewn_too(model_name: str) -> None:
    one = strip(6, 5)
    gap = one.points[:, 1].max() + 0.001
    raw = RawMesh(
        np.concatenate([one.points, one.points + np.array([0.0, gap, 0.0])]),
        triangles=np.concatenate([one.triangles, one.triangles + len(one.points)]),
    )
    sheet = with_sheet(raw, SheetSettings(SURFACE, stiffness=WITH_TORSION), [])
    y = sheet.points[:, 1]
    mesh = Mesh(sheet, (y < 1e-9) | (y > y.max() - 1e-9))
    left, right = (np.flatnonzero(np.isclose(y, at)) for at in (gap - 0.001, gap))
    model, state = build(model_name, mesh)
    apply(mesh, model, state, sew_edit(mesh, left, right))
    settle(model, state)
    assert np.linalg.norm(edges(mesh, state), axis=1).max() < CLOSED
    if model.has_forces:
        fixed = np.flatnonzero(mesh.fixed[: mesh.node_rows]).astype(np.int32)
        low = mesh.rest[fixed, 1] < 1e-9
        reaction = model.forces(state, fixed)[low].sum(axis=0)
        np.testing.assert_allclose(reaction, pull(mesh, state), atol=1e-3 * reaction[1])


@pytest.mark.parametrize("variant", sorted(IN_BALANCE))
def test_undone_stitches_leave_forces_as_they_were_bit_for_bit(variant: str) -> None:
    mesh, left, right = two_blocks()
    name, parameters = VARIANTS[variant]
    model = registry.build(name, mesh, MATERIAL, dict(parameters))
    state, history = State(mesh), EditHistory()
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    shape = np.random.default_rng(2).normal(size=(mesh.node_rows, 3)) * 1e-4
    state.displacement[rows] = shape
    model.prescribed_changed(state, NO_ROWS)
    before = model.forces(state, rows)
    for edit in (sew_edit(mesh, left, right), None):
        change = mesh.apply(edit or history.undo(mesh))
        history.record(change)
        state.follow(mesh, change)
        model.topology_changed(change, state)
        differ = (model.forces(state, rows) != before).any(axis=1)
        assert differ.any() == bool(edit)
