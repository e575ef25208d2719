"""Vertex block descent without time: the energy, its equilibria, recovery, cuts, acceleration."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import skfem
from scipy.optimize import minimize
from skfem.helpers import ddot, sym_grad, trace

from support.block_descent import NAME, PULL, scene
from support.elastic_scenes import (
    MATERIAL,
    apply,
    ball,
    block_mesh,
    hold,
    release,
    split_edit,
    steps,
    top_ball,
)
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.vertex_block_descent import VertexBlockDescent
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block, sphere_shell
from tissue_sim.kernels.neo_hookean import node_response

SIZE = 0.06


def all_rows(mesh: Mesh) -> np.ndarray:
    return np.arange(mesh.node_rows, dtype=np.int32)


def shake(mesh: Mesh, state: State, size: float, seed: int = 0) -> None:
    random = np.random.default_rng(seed)
    state.displacement[: mesh.node_rows] = random.normal(0, size, (mesh.node_rows, 3))


def deformation(mesh: Mesh, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """F of every element and its volume, by edge matrices."""
    tets = mesh.tets[: mesh.element_rows][mesh.element_alive[: mesh.element_rows]]
    x = mesh.rest + u
    Dm = np.swapaxes(mesh.rest[tets[:, 1:]] - mesh.rest[tets[:, :1]], 1, 2)
    Ds = np.swapaxes(x[tets[:, 1:]] - x[tets[:, :1]], 1, 2)
    return Ds @ np.linalg.inv(Dm), np.linalg.det(Dm) / 6


def textbook_energy(mesh: Mesh, u: np.ndarray, material: Material = MATERIAL) -> float:
    """The energy as the paper writes it, minus its value at rest."""
    E, nu = material.young_modulus, material.poisson_ratio
    shear, first = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    mu, lam = 4 / 3 * shear, first + 5 / 6 * shear
    alpha = 1 + mu / lam - mu / (4 * lam)
    F, V = deformation(mesh, u)
    invariant, J = (F**2).sum(axis=(1, 2)), np.linalg.det(F)
    psi = mu / 2 * (invariant - 3) + lam / 2 * (J - alpha) ** 2 - mu / 2 * np.log(invariant + 1)
    rest = lam / 2 * (1 - alpha) ** 2 - mu / 2 * np.log(4)
    return float((V * (psi - rest)).sum())


def folded(mesh: Mesh, state: State) -> float:
    F, _ = deformation(mesh, state.displacement.astype(np.float64))
    return float((np.linalg.det(F) < 0).mean())


def off_rest(state: State) -> float:
    return float(np.linalg.norm(state.displacement, axis=1).max())


@pytest.mark.parametrize("size", [1e-4, 4e-3, 3e-2])
def test_the_energy_is_the_papers_and_forces_are_its_slope(size: float) -> None:
    mesh, model, state = scene(4)
    shake(mesh, state, size)
    u = state.displacement
    energy = model.energy(state)
    assert energy == pytest.approx(textbook_energy(mesh, u), rel=1e-9)
    F, h = model.forces(state, all_rows(mesh)), 1e-4 * size
    for node in (0, 21, 37, 63):
        for axis in range(3):
            u[node, axis] += h
            ahead = model.energy(state)
            u[node, axis] -= 2 * h
            behind = model.energy(state)
            u[node, axis] += h
            assert (behind - ahead) / (2 * h) == pytest.approx(
                F[node, axis], abs=1e-6 * np.abs(F).max()
            )


@pytest.mark.parametrize("size", [1e-4, 4e-3, 3e-2])
def test_a_nodes_hessian_is_the_slope_of_its_force_and_positive(size: float) -> None:
    mesh, model, state = scene(4)
    shake(mesh, state, size, seed=1)
    u, blocks = state.displacement, model.problem.blocks
    h = 1e-5 * size
    for node in (0, 21, 42, 63):
        lanes, at = blocks.lanes[node], blocks.start[node]
        K00, K01, K02, K11, K12, K22 = node_response(
            node, lanes, at, blocks.corners, blocks.gradients, u, model.problem.problem.material
        )[3:9]
        K = np.array([[K00, K01, K02], [K01, K11, K12], [K02, K12, K22]])
        row, slope = np.array([node], dtype=np.int32), np.empty((3, 3))
        for axis in range(3):
            u[node, axis] += h
            ahead = model.forces(state, row)[0]
            u[node, axis] -= 2 * h
            slope[axis] = (ahead - model.forces(state, row)[0]) / (2 * h)
            u[node, axis] += h
        np.testing.assert_allclose(-slope, K, atol=1e-6 * np.abs(K).max())
        assert np.linalg.eigvalsh(K)[0] > 0


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.45])
def test_small_strains_are_those_of_linear_elasticity(poisson_ratio: float) -> None:
    material = Material(poisson_ratio=poisson_ratio)
    mesh, model, state = scene(5, material=material, rest_tolerance=1e-12)
    held = hold(model, state, np.flatnonzero(mesh.rest[:125, 0] > SIZE - 1e-9), mesh)
    held = held[~mesh.fixed[held]]
    # A thousandth of the size: pulled, sheared and twisted a little.
    middle = mesh.rest[held] - mesh.rest[held].mean(axis=0)
    state.displacement[held] = 1e-3 * SIZE * np.array([1.0, 0.5, 0.0])
    state.displacement[held] += 1e-3 * np.cross([1.0, 0, 0], middle)
    steps(model, state, 1500)
    rows = mesh.node_rows
    expected = linear_solution(mesh, state, material)
    error = np.abs(state.displacement[:rows] - expected).max()
    assert error < 2e-3 * np.abs(expected).max()


def linear_solution(mesh: Mesh, state: State, material: Material) -> np.ndarray:
    """Displacements by scikit-fem, prescribed nodes where the state has them."""
    E, nu, rows = material.young_modulus, material.poisson_ratio, mesh.node_rows
    mu, lam = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))

    @skfem.BilinearForm
    def stiffness(u: Any, v: Any, _: Any) -> Any:
        eps, test = sym_grad(u), sym_grad(v)
        return 2 * mu * ddot(eps, test) + lam * trace(eps) * trace(test)

    tets = mesh.tets[: mesh.element_rows]
    grid = skfem.MeshTet(mesh.rest[:rows].T.copy(), tets.T.astype(np.int64))
    basis = skfem.Basis(grid, skfem.ElementVector(skfem.ElementTetP1()))
    K = stiffness.assemble(basis)
    u = np.zeros(K.shape[0])
    u[basis.nodal_dofs] = state.displacement[:rows].T
    blocked = basis.nodal_dofs[:, state.prescribed[:rows]].ravel()
    solution = skfem.solve(*skfem.condense(K, x=u, D=blocked))
    return np.asarray(solution)[basis.nodal_dofs].T


def test_sweeps_end_in_the_minimum_of_the_energy() -> None:
    mesh, model, state = scene(4, rest_tolerance=1e-12)
    held = hold(model, state, top_ball(mesh, 0.022), mesh)
    state.displacement[held] = 2 * PULL
    steps(model, state, 500)
    free = np.flatnonzero(mesh.node_alive & ~state.prescribed)
    other = State(mesh, np.float64)

    def energy(flat: np.ndarray) -> tuple[float, np.ndarray]:
        other.displacement[:] = state.displacement
        other.displacement[free] = flat.reshape(-1, 3)
        slope = -model.forces(other, free.astype(np.int32))
        return textbook_energy(mesh, other.displacement), slope.ravel()

    found = minimize(
        energy,
        np.zeros(3 * len(free)),
        jac=True,
        method="L-BFGS-B",
        options={"ftol": 1e-15, "gtol": 1e-9, "maxiter": 5000, "maxfun": 5000},
    )
    error = np.abs(found.x.reshape(-1, 3) - state.displacement[free]).max()
    assert error < 1e-3 * np.linalg.norm(2 * PULL)
    F = np.abs(model.forces(state, held)).max()
    assert model.residual(state) < 1e-6 * F


@pytest.mark.parametrize("step", [0.5, 1.0, 1.5, 1.9])
def test_no_sweep_raises_the_energy_however_hard_the_pull(step: float) -> None:
    mesh, model, state = scene(5, step=step, momentum=0.0)
    model.active.pace.finish_unfolding()
    held = hold(model, state, top_ball(mesh, 0.018), mesh)
    model.active.pace.finish_unfolding()
    state.displacement[held] = [0.1, 0.0, 0.3]
    energies = [model.energy(state)]
    for _ in range(60):
        model.step(state)
        energies.append(model.energy(state))
    assert (np.diff(energies) <= 1e-12 * energies[0]).all()
    assert energies[-1] < 0.5 * energies[0]


def lumpy_block() -> tuple[RawMesh, np.ndarray]:
    """A block whose inner nodes lie anywhere within a fifth of an edge from the grid."""
    raw = block(7, 7, 7, SIZE, SIZE, SIZE)
    inside = ((raw.points > 1e-9) & (raw.points < SIZE - 1e-9)).all(axis=1)
    away = np.random.default_rng(7).normal(size=(5**3, 3))
    raw.points[inside] += 0.2 * SIZE / 6 * away / np.linalg.norm(away, axis=1)[:, None]
    return raw, np.isin(np.arange(7**3), raw.node_sets["fixed"])


def shell() -> tuple[RawMesh, np.ndarray]:
    """A hollow sphere with a wall of three layers, fixed at the bottom."""
    raw = sphere_shell(SIZE / 2, 0.008, subdivisions=2, layers=3)
    return raw, raw.points[:, 2] < -0.3 * SIZE


def plain_block(nodes: int) -> tuple[RawMesh, np.ndarray]:
    raw = block(nodes, nodes, nodes, SIZE, SIZE, SIZE)
    return raw, np.isin(np.arange(nodes**3), raw.node_sets["fixed"])


ORGANS = {
    "block of 5^3": lambda: plain_block(5),
    "block of 9^3": lambda: plain_block(9),
    "lumpy block of 7^3": lumpy_block,
    "sphere shell": shell,
}
"""All of them of the same size."""

SWEEPS_AFTER_COLLAPSE = {
    "block of 5^3": 210,
    "block of 9^3": 290,
    "lumpy block of 7^3": 305,
    "sphere shell": 215,
}
SWEEPS_AFTER_INVERSION = 200
"""Sweeps until no node is farther from rest than a thousandth of the size, and none swings back.

The page says the same.
"""


def organ(name: str) -> tuple[Mesh, VertexBlockDescent, State, np.ndarray]:
    """An organ in single precision, and its free nodes."""
    mesh = Mesh(*ORGANS[name]())
    state, springs = State(mesh, np.float32), SpringNetwork(mesh, MATERIAL, np.float32)
    model = registry.build(NAME, mesh, MATERIAL, {"levels": WHOLE_ORGAN}, springs)
    assert isinstance(model, VertexBlockDescent)
    return mesh, model, state, np.flatnonzero(mesh.node_alive & ~mesh.fixed)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", ORGANS)
def test_a_collapsed_organ_recovers(name: str, seed: int) -> None:
    mesh, model, state, free = organ(name)
    random = np.random.default_rng(seed)
    middle = mesh.rest[: mesh.node_rows].mean(axis=0)
    places = middle + random.uniform(-1, 1, (len(free), 3)) * 1e-6 * SIZE
    state.displacement[free] = places - mesh.rest[free]
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    recovers(model, state, SWEEPS_AFTER_COLLAPSE[name])


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", ORGANS)
def test_an_organ_half_of_whose_elements_are_inverted_recovers(name: str, seed: int) -> None:
    mesh, model, state, free = organ(name)
    size, movable = 1e-3, movable_share(mesh)
    while folded(mesh, state) < 0.49 * movable:
        size *= 1.1
        random = np.random.default_rng(seed)
        state.displacement[free] = random.normal(0, size, (len(free), 3))
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    recovers(model, state, SWEEPS_AFTER_INVERSION)


def recovers(model: VertexBlockDescent, state: State, sweeps: int) -> None:
    """It is back after so many sweeps, and stays."""
    steps(model, state, sweeps)
    for _ in range(100):
        assert off_rest(state) < 1e-3 * SIZE
        model.step(state)


def movable_share(mesh: Mesh) -> float:
    """Share of the elements that have a free node: the others cannot be inverted."""
    return float((~mesh.fixed[mesh.tets[: mesh.element_rows]]).any(axis=1).mean())


def test_elements_inverted_while_something_is_held_recover_without_any_unfolding() -> None:
    mesh, model, state = scene(6, dtype=np.float32)
    held = hold(model, state, top_ball(mesh, 0.014), mesh)
    model.active.pace.finish_unfolding()
    state.displacement[held] = [0, 0, -0.045]
    steps(model, state, 400)
    state.displacement[held] = [0, 0, 0.004]
    steps(model, state, 600)
    assert folded(mesh, state) == 0
    reference_mesh, reference, rest = scene(6, dtype=np.float32)
    hold(reference, rest, held, reference_mesh)
    rest.displacement[held] = [0, 0, 0.004]
    steps(reference, rest, 600)
    assert np.abs(state.displacement - rest.displacement).max() < 1e-3 * SIZE


def test_a_cut_changes_neither_energy_nor_forces_nor_shape_at_once() -> None:
    mesh, model, state = scene(7)
    held = hold(model, state, top_ball(mesh, 0.011), mesh)
    state.displacement[held] = PULL
    steps(model, state, 200)
    rows, volume = all_rows(mesh), deformation(mesh, state.displacement)[1].sum()
    energy, F = model.energy(state), model.forces(state, rows)
    mass = model.springs.masses.sum()
    edit = split_edit(mesh, 0.03, above=0.025)
    apply(mesh, model, state, edit)
    parents = edit.copy_parents.astype(np.int64)
    copies = np.arange(len(rows), mesh.node_rows, dtype=np.int32)
    after = model.forces(state, all_rows(mesh))
    shared = after[: len(rows)].copy()
    shared[parents] += after[copies]
    np.testing.assert_allclose(shared, F, atol=1e-12 * np.abs(F).max())
    assert model.energy(state) == pytest.approx(energy, rel=1e-12)
    assert model.springs.masses.sum() == pytest.approx(mass, rel=1e-12)
    assert deformation(mesh, state.displacement)[1].sum() == pytest.approx(volume, rel=1e-12)
    # What follows an edit is what a model built afresh has, and the cut opens.
    fresh = VertexBlockDescent(mesh, MATERIAL, {}, SpringNetwork(mesh, MATERIAL, np.float64))
    np.testing.assert_array_equal(fresh.forces(state, all_rows(mesh)), after)
    before = state.displacement.copy()
    steps(model, state, 200)
    opened = np.linalg.norm((state.displacement[copies] - state.displacement[parents]), axis=1)
    assert opened.max() > 1e-4
    assert not (state.displacement - before)[mesh.fixed].any()
    assert model.energy(state) < energy


def test_a_cut_at_rest_moves_nothing() -> None:
    mesh, model, state = scene(6, dtype=np.float32)
    apply(mesh, model, state, split_edit(mesh, 0.036))
    steps(model, state, 50)
    assert not state.displacement.any()


def sweeps_until(model: VertexBlockDescent, state: State, energy: float, speed: float) -> int:
    """Sweeps until the energy is within a thousandth of a minimum; Chebyshev's method around them.

    `speed` is rho of Chebyshev's method (Wang, doi 10.1145/2816795.2818063), 0 for none: it
    extrapolates each sweep's result away from the one before the last.
    """
    omega, before = 1.0, state.displacement.copy()
    free = ~state.prescribed
    for count in range(1, 1000):
        last = state.displacement.copy()
        model.step(state)
        omega = 1.0 if count < 5 else 2 / (2 - speed**2) if count == 5 else omega_of(speed, omega)
        if speed and count >= 5:
            u = state.displacement
            u[free] = omega * (u[free] - before[free]) + before[free]
        before = last
        if model.energy(state) < 1.001 * energy:
            return count
    return 1000


def omega_of(speed: float, omega: float) -> float:
    return 4 / (4 - speed**2 * omega)


def test_momentum_reaches_the_same_equilibrium_in_a_fraction_of_the_sweeps() -> None:
    def pulled(**parameters: Any) -> tuple[VertexBlockDescent, State]:
        mesh, model, state = scene(9, rest_tolerance=1e-12, **parameters)
        held = hold(model, state, top_ball(mesh), mesh)
        state.displacement[held] = PULL
        return model, state

    model, state = pulled()
    steps(model, state, 800)
    energy, end = model.energy(state), state.displacement.copy()
    plain = sweeps_until(*pulled(step=1.0, momentum=0.0), energy, 0.0)
    longer = sweeps_until(*pulled(step=1.7, momentum=0.0), energy, 0.0)
    momentum = sweeps_until(*pulled(momentum=0.9), energy, 0.0)
    chebyshev = sweeps_until(*pulled(step=1.0, momentum=0.0), energy, 0.95)
    assert momentum < 0.2 * plain
    assert momentum < longer < chebyshev < plain
    slow, slow_state = pulled(step=1.7, momentum=0.0)
    steps(slow, slow_state, 800)
    assert np.abs(slow_state.displacement - end).max() < 1e-6


def test_resting_nodes_that_are_passed_over_change_nothing_that_can_be_seen() -> None:
    ends = []
    for tolerance in (1e-8, 1e-12):
        mesh, model, state = scene(9, dtype=np.float32, rest_tolerance=tolerance)
        held = hold(model, state, top_ball(mesh), mesh)
        for frame in range(1, 41):
            state.displacement[held] = PULL * min(frame, 20) / 20
            steps(model, state, 5)
        ends.append(state.displacement)
    assert np.abs(ends[0] - ends[1]).max() < 1e-6


def test_sweeps_end_when_nothing_moves_and_go_on_when_the_hold_does() -> None:
    mesh, model, state = scene(7, dtype=np.float32)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = PULL
    steps(model, state, 300)
    assert model.idle
    before = state.displacement.copy()
    steps(model, state, 3)
    np.testing.assert_array_equal(state.displacement, before)
    state.displacement[held] = 1.1 * PULL
    model.step(state)
    assert not model.idle
    moved = (state.displacement != before).any(axis=1) & ~state.prescribed
    assert moved.sum() > 10


def test_nodes_beyond_the_cut_off_stay() -> None:
    mesh, model, state = scene(9, dtype=np.float32, levels=3)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = PULL
    steps(model, state, 50)
    level = model.active.ordering.level[: mesh.node_rows]
    outer = (level < 0) | (level > 3)
    u = state.displacement[: mesh.node_rows]
    assert outer.any()
    assert not u[outer].any()
    assert u[level == 3].any()


@pytest.mark.parametrize("parameters", [{}, {"dynamic": 1.0}])
def test_a_drag_through_the_organ_and_its_release_end_at_rest(parameters: dict[str, Any]) -> None:
    mesh, model, state = scene(9, dtype=np.float32, **parameters)
    held = hold(model, state, ball(mesh, np.array([0.03, 0.03, SIZE]), 0.012), mesh)
    per_frame = 4 if model.time_step is None else 1
    # At 1 m/s down through the organ, out below it and on.
    for frame in range(1, 8):
        state.displacement[held] = [0, 0, -frame / 60]
        steps(model, state, per_frame)
        assert np.isfinite(state.displacement).all()
        assert off_rest(state) < 20 * SIZE
    reach = 7 / 60
    release(model, state, mesh)
    steps(model, state, 300 * per_frame)
    assert off_rest(state) < 0.05 * reach


def test_flat_elements_and_nodes_without_elements_do_no_harm() -> None:
    mesh = block_mesh(4)
    rows = mesh.node_rows
    points = np.concatenate([mesh.rest[:rows], [[0.1, 0.1, 0.1], [0.0, 0.0, 0.03]]])
    # A flat element between three nodes of a side and one in their plane.
    side = np.flatnonzero(np.abs(points[:rows, 0]) < 1e-9)[:3]
    tets = np.concatenate([mesh.tets[: mesh.element_rows], [[*side, rows + 1]]])
    fixed = np.append(mesh.fixed[:rows], [False, False])
    odd = Mesh(RawMesh(points, tets.astype(np.int64)), fixed)
    model = VertexBlockDescent(odd, MATERIAL, {"levels": WHOLE_ORGAN})
    state = State(odd)
    held = hold(model, state, top_ball(mesh, 0.022), odd)
    state.displacement[held] = PULL
    steps(model, state, 200)
    assert np.isfinite(state.displacement).all()
    assert not state.displacement[rows : rows + 2].any()
    assert np.isfinite(model.forces(state, all_rows(odd))).all()
    assert model.idle


def test_long_steps_with_momentum_are_refused() -> None:
    with pytest.raises(ValueError, match=r"step = 1.8 is too long .* allowed: up to 1.3"):
        registry.build(NAME, block_mesh(3), MATERIAL, {"step": 1.8})
    assert registry.build(NAME, block_mesh(3), MATERIAL, {"step": 1.8, "momentum": 0.0})
