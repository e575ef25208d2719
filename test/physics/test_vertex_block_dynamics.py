"""Vertex block descent in time: implicit steps lose energy, swing and rest as they must."""

from __future__ import annotations

import numpy as np
import pytest

from support.block_descent import NAME, PULL, scene
from support.elastic_scenes import hold, steps, top_ball
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.vertex_block_descent import VertexBlockDescent
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block


def kinetic_energy(mesh: Mesh, model: VertexBlockDescent, state: State) -> float:
    assert model.time_step is not None
    v = (state.displacement - state.previous).astype(np.float64) / model.time_step
    return float(0.5 * (model.springs.masses[:, None] * v**2).sum())


@pytest.mark.parametrize(
    ("time_step", "iterations", "rise"),
    [(1 / 60, 300, 1e-6), (1e-3, 60, 1e-6), (1 / 60, 10, 1e-2), (1 / 60, 2, 1e-2)],
)
def test_free_motion_gains_no_energy(time_step: float, iterations: int, rise: float) -> None:
    mesh, model, state = scene(6, dynamic=1, time_step=time_step, iterations=iterations, damping=0)
    state.displacement[:] = 0.2 * mesh.rest[:, ::-1]
    state.displacement[mesh.fixed] = 0
    state.previous[:] = state.displacement
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    energies = [model.energy(state)]
    for _ in range(100):
        model.step(state)
        energies.append(model.energy(state) + kinetic_energy(mesh, model, state))
    assert max(energies) <= energies[0] * (1 + 1e-9)
    # Converged, energy only falls; sweeps that end early leave some for the steps after.
    assert (np.diff(energies) <= rise * energies[0]).all()
    assert energies[-1] < 0.02 * energies[0]


def test_a_bar_swings_at_its_frequency() -> None:
    # No lateral contraction: the longitudinal oscillation of a bar clamped at one end, sqrt(E/rho)
    # / 4 L, is exact but for the mesh.
    material = Material(young_modulus=5e4, poisson_ratio=0.0)
    n, length = 17, 0.16
    raw = block(n, 2, 2, length, 0.01, 0.01)
    mesh = Mesh(raw, raw.points[:, 0] < 1e-9)
    values = {"dynamic": 1.0, "time_step": 2e-4, "iterations": 40.0, "rest_tolerance": 1e-12}
    values["damping"] = 0.0
    springs, state = SpringNetwork(mesh, material, np.float64), State(mesh, np.float64)
    model = registry.build(NAME, mesh, material, values, springs)
    rows = mesh.node_rows
    state.displacement[:rows, 0] = 1e-4 * np.sin(np.pi / 2 * mesh.rest[:rows, 0] / length)
    state.previous[:] = state.displacement
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    tip, ends = [], np.flatnonzero(mesh.rest[:rows, 0] > length - 1e-9)
    frequency = np.sqrt(material.young_modulus / material.density) / (4 * length)
    for _ in range(int(2.2 / frequency / 2e-4)):
        model.step(state)
        tip.append(float(state.displacement[ends, 0].mean()))
    signs = np.sign(tip)
    crossings = np.flatnonzero(signs[1:] != signs[:-1])
    where = [c + tip[c] / (tip[c] - tip[c + 1]) for c in crossings]
    period = 2 * np.diff(where).mean() * 2e-4
    assert 1 / period == pytest.approx(frequency, rel=0.02)


def test_the_dynamic_model_hangs_still_where_the_static_one_rests() -> None:
    mesh, static, rest = scene(6)
    held = hold(static, rest, top_ball(mesh, 0.014), mesh)
    rest.displacement[held] = PULL
    steps(static, rest, 400)
    _, moving, state = scene(6, dynamic=1, damping=0.1)
    hold(moving, state, held, mesh)
    state.displacement[held] = PULL
    steps(moving, state, 400)
    assert np.abs(state.displacement - rest.displacement).max() < 1e-6
    F = moving.forces(state, held)
    np.testing.assert_allclose(F, static.forces(rest, held), atol=1e-3 * np.abs(F).max())
