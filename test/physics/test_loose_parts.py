"""Parts that nothing, or too little, keeps from moving as a whole: finite elements."""

from __future__ import annotations

import numpy as np
import pytest

from support.elastic_scenes import (
    apply,
    block_mesh,
    build,
    double,
    hold,
    release,
    split_edit,
    steps,
    top_ball,
)
from tissue_sim.elastic.finite_element import FiniteElement
from tissue_sim.elastic.loose_parts import LooseParts
from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block

FIXED = {"nothing": [], "one node": [0], "two nodes": [0, 7], "a line": [0, 1, 2, 3]}


def loose_block(fixed: list[int]) -> Mesh:
    raw = block(6, 6, 6)
    return Mesh(raw, np.isin(np.arange(len(raw.points)), fixed))


def without_a_layer(mesh: Mesh) -> TopologyEdit:
    points = mesh.rest[mesh.tets[: mesh.element_rows]][:, :, 2]
    layer = (points.min(axis=1) > 0.019) & (points.max(axis=1) < 0.031)
    return TopologyEdit(mesh.version, removed_elements=np.flatnonzero(layer).astype(np.uint32))


@pytest.mark.parametrize(("fixed", "motions"), list(zip(FIXED, [6, 3, 1, 1], strict=True)))
def test_exactly_the_rigid_motions_that_fixed_nodes_allow_are_taken_out(
    fixed: str, motions: int
) -> None:
    mesh = loose_block(FIXED[fixed])
    given, rows = mesh.fixed, mesh.node_rows
    random = np.random.default_rng(3)
    shape = np.zeros((mesh.node_capacity, 3))
    shape[:rows][~given[:rows]] = random.normal(0, 1e-3, (int((~given[:rows]).sum()), 3))
    parts = LooseParts(mesh)
    parts.follow_prescribed(shape, given)
    assert len(parts) == 1
    x = mesh.rest[:rows] + shape[:rows]
    rigid = [np.tile(axis, (rows, 1)) for axis in np.eye(3)]
    rigid += [np.cross(axis, x) for axis in np.eye(3)]
    Z = np.array([motion.ravel() for motion in rigid]).T
    there = np.repeat(given[:rows], 3)
    _, sizes, V = np.linalg.svd(Z[there], full_matrices=True)
    allowed = V[np.sum(sizes > 1e-9 * sizes.max(initial=0)) :]
    assert len(allowed) == motions
    Q, _ = np.linalg.qr((Z @ allowed.T)[~there])
    v = np.zeros_like(shape)
    v[:rows] = random.normal(size=(rows, 3))
    before = v[:rows].ravel().copy()
    parts.hold_still(given, v)
    after = v[:rows].ravel()
    np.testing.assert_array_equal(after[there], before[there])
    expected = before[~there] - Q @ (Q.T @ before[~there])
    np.testing.assert_allclose(after[~there], expected, atol=1e-10)


def test_three_nodes_that_are_not_in_a_line_are_enough() -> None:
    mesh = loose_block([0, 1, 6])
    parts = LooseParts(mesh)
    parts.follow_prescribed(np.zeros((mesh.node_capacity, 3)), mesh.fixed)
    assert len(parts) == 0


@pytest.mark.parametrize("fixed", FIXED)
def test_an_organ_with_too_little_fixed_comes_to_rest(fixed: str) -> None:
    mesh = loose_block(FIXED[fixed])
    model, state = build("finite_element", mesh, corotated=1.0)
    held = hold(model, state, top_ball(mesh, 0.015), mesh)
    for frame in range(1, 21):
        state.displacement[held] = [0.0, 0.0, 0.0002 * frame]
        steps(model, state, 10)
    release(model, state, mesh)
    middle = state.displacement[: mesh.node_rows].mean(axis=0, dtype=np.float64)
    for _ in range(3000):
        model.step(state)
    assert model.idle
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    stiff = model.springs.springs.stiffness.max()  # type: ignore[attr-defined]
    # What moves a node by a micrometre: a few single nodes hold everything.
    assert np.abs(model.forces(state, rows)).max() < 1e-6 * stiff
    assert not state.displacement[mesh.fixed].any()
    end = state.displacement[: mesh.node_rows].mean(axis=0, dtype=np.float64)
    assert np.linalg.norm(end - middle) < (1e-6 if fixed == "nothing" else 0.01)


def test_a_part_cut_free_keeps_its_place_while_the_rest_returns() -> None:
    mesh = block_mesh(7)
    model, state = build("finite_element", mesh, corotated=1.0)
    held = hold(model, state, top_ball(mesh), mesh)
    for frame in range(1, 21):
        state.displacement[held] = [0.0, 0.0, 0.0002 * frame]
        steps(model, state, 10)
    apply(mesh, model, state, without_a_layer(mesh))
    release(model, state, mesh)
    rows = mesh.node_rows
    free = mesh.rest[:rows, 2] > 0.025
    middle = state.displacement[:rows][free].mean(axis=0, dtype=np.float64)
    for _ in range(60):
        steps(model, state, 10)
        now = state.displacement[:rows][free].mean(axis=0, dtype=np.float64)
        assert np.abs(now - middle).max() < 1e-6
    assert model.idle
    assert np.abs(state.displacement[:rows][~free]).max() < 1e-6
    assert np.abs(state.displacement[:rows][free]).max() < 0.01


def test_removed_elements_pull_no_more_in_a_renewed_tangent() -> None:
    mesh = block_mesh(7)
    springs, state = double(mesh)
    model, _ = build("finite_element", mesh, springs, state, corotated=1.0)
    assert isinstance(model, FiniteElement)
    assert model.corotated is not None
    apply(mesh, model, state, without_a_layer(mesh))
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    state.displacement[rows] = np.random.default_rng(1).normal(0, 1e-3, (len(rows), 3))
    tangent = model.corotated.tangent
    tangent.begin(state.displacement)
    while not tangent.complete:
        tangent.go_on()
    forces = model.forces(state, rows)
    np.testing.assert_allclose(tangent.next.force[rows], forces, atol=1e-9 * np.abs(forces).max())


def test_parts_followed_through_edits_are_those_of_a_mesh_looked_at_anew() -> None:
    mesh, history = block_mesh(7), EditHistory()
    parts = LooseParts(mesh)

    def follow(edit: TopologyEdit) -> bool:
        """Whether the whole mesh was looked at."""
        before = parts._label
        change = mesh.apply(edit)
        history.record(change)
        parts.follow(change)
        rows = mesh.node_rows
        count, label = connected_components(
            mesh.tets[: mesh.element_rows], mesh.element_alive[: mesh.element_rows], rows
        )
        own = parts._label[:rows]
        np.testing.assert_array_equal(own >= 0, label >= 0)
        assert len(set(zip(own.tolist(), label.tolist(), strict=True))) == len(np.unique(label))
        assert parts._count == count
        return parts._label is not before

    assert not follow(split_edit(mesh, 0.03, above=0.02))
    assert follow(split_edit(mesh, 0.01))
    assert follow(history.undo(mesh))
    assert not follow(history.undo(mesh))
    assert not follow(history.redo(mesh))
    assert follow(history.redo(mesh))
    assert follow(without_a_layer(mesh))


def test_a_part_cut_free_is_not_dragged_along_by_linear_elements() -> None:
    mesh = block_mesh(7)
    model, state = build("finite_element", mesh)
    rows = mesh.node_rows
    low = np.flatnonzero(np.abs(mesh.rest[:rows] - [0.03, 0.03, 0.01]).max(axis=1) < 0.006)
    held = hold(model, state, low, mesh)

    def pull() -> None:
        for _ in range(10):
            state.displacement[held] += np.array([0.0, 0.0, 0.0002], dtype=np.float32)
            steps(model, state, 20)

    pull()
    apply(mesh, model, state, without_a_layer(mesh))
    steps(model, state, 200)
    free = mesh.rest[:rows, 2] > 0.025
    before = state.displacement[:rows][free].copy()
    assert np.abs(before).max() > 1e-4
    pull()
    np.testing.assert_allclose(state.displacement[:rows][free], before, atol=2e-6)
    release(model, state, mesh)
    steps(model, state, 300)
    assert model.idle
    np.testing.assert_allclose(state.displacement[:rows][free], before, atol=2e-6)
    assert np.abs(state.displacement[:rows][~free]).max() < 1e-6
