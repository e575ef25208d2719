"""What every elastic model owes to rest, to rigid motion and to momentum."""

from __future__ import annotations

import numpy as np
import pytest

from support.elastic_scenes import (
    VARIANTS,
    block_mesh,
    build,
    double,
    hold,
    release,
    steps,
    top_ball,
)
from tissue_sim.elastic import registry

ALL = registry.names()
WITH_FORCES = [name for name in ALL if registry.MODELS[name].has_forces]
LINEAR = {"finite_element"}
"""Strain is linear in the displacement: a large rotation is strained, and balanced about rest."""


def rotation(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("holding", [False, True])
def test_the_rest_state_stays_at_rest_bit_for_bit(name: str, holding: bool) -> None:
    mesh = block_mesh(7)
    model, state = build(name, mesh)
    if holding:
        hold(model, state, top_ball(mesh), mesh)
    steps(model, state, 20)
    assert not state.displacement.any()
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    assert not model.forces(state, rows).any()


@pytest.mark.parametrize("name", ALL)
def test_a_moved_organ_with_nothing_fixed_stays_where_it_is_bit_for_bit(name: str) -> None:
    mesh = block_mesh(6, fixed=False)
    model, state = build(name, mesh)
    state.displacement[:] = state.previous[:] = [0.01, -0.02, 0.005]
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    before = state.displacement.copy()
    steps(model, state, 20)
    np.testing.assert_array_equal(state.displacement, before)


@pytest.mark.parametrize("name", sorted(set(WITH_FORCES) - LINEAR))
@pytest.mark.parametrize("angle", [0.3, 2.0])
def test_a_turned_organ_has_no_force(name: str, angle: float) -> None:
    mesh = block_mesh(5, fixed=False)
    springs, state = double(mesh)
    model, _ = build(name, mesh, springs, state)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    state.displacement[rows] = mesh.rest[rows] @ rotation(angle).T - mesh.rest[rows]
    scale = springs.springs.stiffness.max() * 0.01
    assert np.abs(model.forces(state, rows)).max() < 1e-11 * scale


@pytest.mark.parametrize(
    "name", ["quasi_static", "lr", "relaxation", "spring_mass", "vertex_block_descent"]
)
def test_a_turned_organ_stays_turned_in_single_precision(name: str) -> None:
    mesh = block_mesh(5, fixed=False)
    model, state = build(name, mesh)
    rows = np.arange(mesh.node_rows)
    turned = mesh.rest[rows] @ rotation(1.0).T - mesh.rest[rows]
    state.displacement[rows] = state.previous[rows] = turned
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    steps(model, state, 500)
    assert np.abs(state.displacement[rows] - turned).max() < 1e-6


@pytest.mark.parametrize("name", WITH_FORCES)
def test_internal_forces_sum_to_zero_and_have_no_moment(name: str) -> None:
    mesh = block_mesh(5)
    springs, state = double(mesh)
    model, _ = build(name, mesh, springs, state)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    random = np.random.default_rng(1)
    state.displacement[rows] = random.normal(0, 2e-3, (mesh.node_rows, 3))
    F = model.forces(state, rows)
    x = mesh.rest[rows] + (0 if name in LINEAR else state.displacement[rows])
    assert np.abs(F.sum(axis=0)).max() < 1e-12 * np.abs(F).sum()
    assert np.abs(np.cross(x, F).sum(axis=0)).max() < 1e-12 * np.abs(F).sum()


@pytest.mark.parametrize("variant", VARIANTS)
def test_an_organ_with_nothing_fixed_neither_drifts_nor_blows_up(variant: str) -> None:
    mesh = block_mesh(6, fixed=False)
    name, parameters = VARIANTS[variant]
    model, state = build(name, mesh, None, None, **parameters)
    held = hold(model, state, top_ball(mesh, 0.015), mesh)
    for frame in range(1, 31):
        state.displacement[held] = [0.0, 0.0, 0.0005 * frame]
        steps(model, state, 5)
    release(model, state, mesh)
    steps(model, state, 3000)
    rows = np.arange(mesh.node_rows)
    first = state.displacement[rows].mean(axis=0, dtype=np.float64)
    steps(model, state, 500)
    last = state.displacement[rows].mean(axis=0, dtype=np.float64)
    assert np.abs(state.displacement).max() < 0.03
    assert np.abs(last - first).max() < 1e-6


def test_a_free_organ_keeps_its_momentum() -> None:
    mesh = block_mesh(5, fixed=False)
    springs, state = double(mesh)
    model, _ = build("spring_mass", mesh, springs, state, damping=0.0)
    rows = np.arange(mesh.node_rows)
    random = np.random.default_rng(5)
    state.displacement[rows] = random.normal(0, 5e-4, (mesh.node_rows, 3))
    state.previous[rows] = state.displacement[rows] - [1e-6, 2e-6, -1e-6]
    masses = springs.masses[rows, None]

    def momentum() -> np.ndarray:
        return (masses * (state.displacement - state.previous)[rows]).sum(axis=0)

    def spin() -> np.ndarray:
        x = mesh.rest[rows] + state.displacement[rows]
        before = mesh.rest[rows] + state.previous[rows]
        return (masses * np.cross(before, x)).sum(axis=0)

    p, L = momentum(), spin()
    steps(model, state, 1000)
    np.testing.assert_allclose(momentum(), p, rtol=1e-9)
    np.testing.assert_allclose(spin(), L, rtol=1e-6, atol=1e-6 * np.abs(L).max())


@pytest.mark.parametrize("name", ALL)
def test_the_same_inputs_and_steps_give_the_same_bits(name: str) -> None:
    def run() -> np.ndarray:
        mesh = block_mesh(6)
        model, state = build(name, mesh)
        held = hold(model, state, top_ball(mesh), mesh)
        for frame in range(1, 11):
            state.displacement[held] = [0.0, 0.0005 * frame, 0.001 * frame]
            steps(model, state, 3)
        release(model, state, mesh)
        steps(model, state, 30)
        return state.displacement

    first = run()
    assert first.any()
    np.testing.assert_array_equal(run(), first)
