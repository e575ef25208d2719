"""Factorised finite elements: the same solutions, found within few steps, until a cut."""

from __future__ import annotations

import numpy as np
import pytest

from support.elastic_scenes import apply, ball, block_mesh, build, hold, split_edit, top_ball
from tissue_sim.elastic import registry
from tissue_sim.elastic.finite_element import FiniteElement
from tissue_sim.elastic.model import Material, RegionMaterial, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.mesh import Mesh

EXACT = {"tolerance": 1e-11, "rest_tolerance": 1e-13, "foresight": 0.0}
STEPS = 12
"""Besides those that a hold's compliance takes."""


def made(
    mesh: Mesh, values: dict[str, float], dtype: type[np.floating] = np.float64
) -> tuple[FiniteElement, State]:
    material = Material(regions=(RegionMaterial("0", 5e4, 0.3, 1060.0),))
    springs, state = SpringNetwork(mesh, material, dtype), State(mesh, dtype)
    model = registry.build("finite_element", mesh, material, values, springs)
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    assert isinstance(model, FiniteElement)
    return model, state


def settle(model: FiniteElement, state: State, most: int = 20000) -> int:
    for count in range(1, most):
        model.step(state)
        if model.idle:
            return count
    raise AssertionError("it does not come to rest")


def imbalance(model: FiniteElement, state: State, mesh: Mesh) -> float:
    """Residual in free nodes over the force on prescribed ones."""
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    forces, there = model.forces(state, rows), state.prescribed[rows]
    return float(np.linalg.norm(forces[~there]) / np.linalg.norm(forces[there]))


def test_solutions_equal_those_of_conjugate_gradients_for_two_holds() -> None:
    mesh = block_mesh(5)
    solutions = []
    first, second = top_ball(mesh, 0.016), ball(mesh, np.array([0.06, 0.06, 0.03]), 0.016)
    for direct in (0.0, 1.0):
        model, state = made(mesh, {**EXACT, "direct": direct})
        hold(model, state, first, mesh)
        state.displacement[first] = [0.003, 0.001, 0.004]
        steps = settle(model, state)
        if direct:
            assert steps <= len(first) + STEPS
        both = hold(model, state, [*first, *second], mesh)
        state.displacement[second] = [0.004, 0.0, -0.002]
        steps = settle(model, state)
        if direct:
            assert steps <= len(both) + STEPS
        assert imbalance(model, state, mesh) < 1e-9
        solutions.append(state.displacement.copy())
        hold(model, state, second, mesh)
        settle(model, state)
        assert imbalance(model, state, mesh) < 1e-9
    assert np.abs(solutions[1] - solutions[0]).max() < 1e-9


def test_single_precision_is_balanced_to_rounding() -> None:
    mesh = block_mesh(5)
    model, state = made(mesh, {"direct": 1.0}, np.float32)
    held = hold(model, state, top_ball(mesh, 0.016), mesh)
    state.displacement[held] = [0.003, 0.001, 0.004]
    settle(model, state)
    assert imbalance(model, state, mesh) < 2e-5


def test_after_a_cut_conjugate_gradients_go_on_and_say_so() -> None:
    mesh = block_mesh(5)
    model, state = made(mesh, {**EXACT, "direct": 1.0})
    held = hold(model, state, top_ball(mesh, 0.016), mesh)
    state.displacement[held] = [0.003, 0.001, 0.004]
    settle(model, state)
    apply(mesh, model, state, split_edit(mesh, 0.015, above=0.02))
    assert "before the cut; conjugate gradients go on" in model.events[-1]
    settle(model, state)
    assert imbalance(model, state, mesh) < 1e-9
    # A model of the cut organ is factorised as it is now.
    again, fresh = made(mesh, {**EXACT, "direct": 1.0})
    held = np.flatnonzero(state.prescribed & ~mesh.fixed).astype(np.int32)  # And their copies.
    hold(again, fresh, held, mesh)
    fresh.displacement[held] = [0.003, 0.001, 0.004]
    settle(again, fresh)
    assert np.abs(fresh.displacement - state.displacement).max() < 1e-9


def test_what_cannot_be_factorised_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"64 nodes are in parts without a fixed node, .*; allowed"
    ):
        build("finite_element", block_mesh(4, fixed=False), direct=1.0)
    hinged = block_mesh(4, fixed=False)
    hinged.fixed[:64] = (hinged.rest[:64, [0, 2]] == 0).all(axis=1)
    assert hinged.fixed.sum() == 4
    with pytest.raises(ValueError, match="fixed nodes in one line only"):
        build("finite_element", hinged, direct=1.0)
    with pytest.raises(ValueError, match="do not go together"):
        build("finite_element", block_mesh(4), direct=1.0, corotated=1.0)
    with pytest.raises(ValueError, match="5832 nodes; allowed: up to 5000"):
        build("finite_element", block_mesh(18), direct=1.0)
