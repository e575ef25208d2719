"""A region of interest: the solution of the whole organ, cuts inside, refusals outside."""

from __future__ import annotations

import numpy as np
import pytest

from support.elastic_scenes import (
    MATERIAL,
    apply,
    ball,
    block_mesh,
    hold,
    split_edit,
    top_ball,
)
from tissue_sim.elastic import registry
from tissue_sim.elastic.finite_element import FiniteElement
from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.frame import Budget, FrameInputs
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

EXACT = {"tolerance": 1e-11, "rest_tolerance": 1e-13, "foresight": 0.0}
REGION = {"interest_radius": 0.042, "interest_x": 0.03, "interest_y": 0.03, "interest_z": 0.06}
PULL = np.array([0.003, 0.001, 0.004])
FEW = 6
"""Steps that a grab or a cut takes: matrix, correction and one motion."""


def made(mesh: Mesh, values: dict[str, float]) -> tuple[FiniteElement, State]:
    springs, state = SpringNetwork(mesh, MATERIAL, np.float64), State(mesh, np.float64)
    model = registry.build("finite_element", mesh, MATERIAL, {**EXACT, **values}, springs)
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    assert isinstance(model, FiniteElement)
    return model, state


def settle(model: FiniteElement, state: State, most: int = 20000) -> int:
    for count in range(1, most):
        model.step(state)
        if model.idle:
            return count
    raise AssertionError("it does not come to rest")


def test_solutions_equal_the_whole_organs_through_grabs_and_cuts() -> None:
    shapes = []
    for values in (REGION, {}):
        mesh = block_mesh(6)
        model, state = made(mesh, values)
        found = []
        held = hold(model, state, top_ball(mesh, 0.016), mesh)
        state.displacement[held] = PULL
        counts = [settle(model, state)]
        found.append(state.displacement.copy())
        for x, above in ((0.024, 0.05), (0.036, 0.04)):
            edit = split_edit(mesh, x, above)
            assert model.refusal(mesh.check(edit).nodes) == ""
            apply(mesh, model, state, edit)
            counts.append(settle(model, state))
            found.append(state.displacement.copy())
        held = hold(model, state, ball(mesh, np.array([0.06, 0.03, 0.06]), 0.014), mesh)
        state.displacement[held] -= PULL
        counts.append(settle(model, state))
        found.append(state.displacement.copy())
        shapes.append(found)
        if values:
            assert max(counts) <= FEW
            assert model.events == []
    for ours, exact in zip(*shapes, strict=True):
        assert np.abs(ours - exact).max() < 1e-6 * np.abs(exact).max()


def test_fixed_nodes_that_have_been_moved_count() -> None:
    shapes = []
    for values in (REGION, {}):
        mesh = block_mesh(5)
        model, state = made(mesh, values)
        state.displacement[mesh.fixed] = [0.001, 0.0, -0.002]
        held = hold(model, state, top_ball(mesh, 0.016), mesh)
        state.displacement[held] = PULL
        settle(model, state)
        shapes.append(state.displacement.copy())
    assert np.abs(shapes[0] - shapes[1]).max() < 1e-6 * np.abs(shapes[1]).max()


def test_a_hold_outside_is_left_to_conjugate_gradients() -> None:
    shapes = []
    for values in (REGION, {}):
        mesh = block_mesh(5)
        model, state = made(mesh, values)
        held = hold(model, state, ball(mesh, np.array([0.0, 0.0, 0.015]), 0.016), mesh)
        state.displacement[held] = PULL
        settle(model, state)
        shapes.append(state.displacement.copy())
    assert np.abs(shapes[0] - shapes[1]).max() < 1e-6 * np.abs(shapes[1]).max()


def test_a_cut_outside_is_refused_and_changes_nothing() -> None:
    mesh = block_mesh(6)
    scene = Scene("finite_element", parameters={"finite_element": REGION})
    simulation = Simulation(mesh, scene)
    deep = split_edit(mesh, 0.024, above=0.01)
    frame = simulation.advance(FrameInputs(edits=(deep,)), Budget(steps=1))
    answer = frame.answers[-1]
    assert not answer.success
    assert "outside of the region of interest" in answer.message
    assert mesh.version == 1
    shallow = split_edit(mesh, 0.024, above=0.05)
    frame = simulation.advance(FrameInputs(edits=(shallow,)), Budget(steps=1))
    assert frame.answers[-1].success
    assert mesh.version == 2


def test_a_part_that_is_cut_free_goes_on_with_conjugate_gradients() -> None:
    mesh = block_mesh(6)
    model, state = made(mesh, REGION)
    tets = mesh.tets[: mesh.element_rows]
    loose = mesh.rest[tets][:, :, 2].mean(axis=1) > 0.048
    edit = free_layer(mesh, loose)
    apply(mesh, model, state, edit)
    for _ in range(200):
        model.step(state)
    assert np.isfinite(state.displacement).all()
    assert np.abs(state.displacement).max() < 1e-9


def free_layer(mesh: Mesh, loose: np.ndarray) -> TopologyEdit:
    """Cut these elements off the rest."""
    tets = mesh.tets[: mesh.element_rows]
    parents = np.intersect1d(tets[loose], tets[~loose])
    new = np.arange(mesh.node_rows, dtype=np.int64)
    new[parents] = PROVISIONAL + np.arange(len(parents))
    rewritten = np.flatnonzero(loose & np.isin(tets, parents).any(axis=1))
    return TopologyEdit(
        mesh.version,
        copied_nodes=new[parents].astype(np.uint32),
        copy_parents=parents.astype(np.uint32),
        rewritten_elements=rewritten.astype(np.uint32),
        rewritten_nodes=new[tets[rewritten]].astype(np.uint32),
    )


def test_regions_that_cannot_be_are_refused() -> None:
    far = {**REGION, "interest_z": 1.0}
    for values, message in (
        (far, "takes 0 free nodes about .*; allowed: 1 to 700 nodes"),
        ({**REGION, "interest_radius": 1.0}, "takes 900 free nodes"),
        ({**REGION, "direct": 1.0}, "direct and interest_radius do not go together"),
        ({**REGION, "corotated": 1.0}, "corotated and interest_radius do not go together"),
    ):
        with pytest.raises(ValueError, match=message):
            refused(block_mesh(10), values)
    with pytest.raises(ValueError, match="parts without a fixed node"):
        refused(block_mesh(4, fixed=False), REGION)


def refused(mesh: Mesh, values: dict[str, float]) -> None:
    registry.build("finite_element", mesh, MATERIAL, values)
