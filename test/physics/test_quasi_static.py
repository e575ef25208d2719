"""The quasi-static model: cut-off, equilibrium, stuck nodes, return to rest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from support.elastic_scenes import (
    MATERIAL,
    ball,
    block_mesh,
    build,
    double,
    hold,
    plain_forces,
    release,
    steps,
    top_ball,
)
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.quasi_static import QuasiStatic
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh

PULL = np.array([0.002, 0.0, 0.006])


def levels_from(mesh: Mesh, model: QuasiStatic) -> np.ndarray:
    return model.active.ordering.level[: mesh.node_rows]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_nodes_beyond_the_cut_off_stay_and_the_others_move_as_if_those_were_fixed(
    dtype: type[np.floating],
) -> None:
    mesh = block_mesh(9)
    springs = SpringNetwork(mesh, MATERIAL, dtype)
    model, state = build("quasi_static", mesh, springs, levels=3)
    assert isinstance(model, QuasiStatic)
    state.displacement = state.displacement.astype(dtype)
    held = hold(model, state, top_ball(mesh), mesh)
    level = levels_from(mesh, model)
    outer = (level < 0) | (level > 3)
    assert 0 < outer.sum() < mesh.node_rows - mesh.fixed.sum()

    mesh_fixed = Mesh(_raw(mesh), outer | mesh.fixed[: mesh.node_rows])
    springs_fixed = SpringNetwork(mesh_fixed, springs.material, dtype)
    whole, reference = build("quasi_static", mesh_fixed, springs_fixed, levels=WHOLE_ORGAN)
    reference.displacement = reference.displacement.astype(dtype)
    hold(whole, reference, held, mesh_fixed)

    for frame in range(1, 21):
        state.displacement[held] = reference.displacement[held] = PULL * frame / 20
        steps(model, state, 3)
        steps(whole, reference, 3)
    rows = mesh.node_rows
    assert not state.displacement[:rows][outer].any()
    np.testing.assert_array_equal(state.displacement[:rows], reference.displacement[:rows])
    assert (np.abs(state.displacement[:rows][level == 3]) > 0).any()


def _raw(mesh: Mesh) -> RawMesh:
    return RawMesh(
        mesh.rest[: mesh.node_rows].copy(), mesh.tets[: mesh.element_rows].astype(np.int64)
    )


def test_sweeps_end_in_the_minimum_of_the_elastic_energy() -> None:
    mesh = block_mesh(4)
    springs, state = double(mesh)
    model, _ = build("quasi_static", mesh, springs, state, levels=WHOLE_ORGAN)
    held = hold(model, state, top_ball(mesh, 0.022), mesh)
    state.displacement[held] = PULL
    steps(model, state, 2000)
    free = np.flatnonzero(mesh.node_alive & ~state.prescribed)
    used = springs.springs.alive[: springs.rows]
    ends, k = springs.springs.ends[: springs.rows][used], springs.springs.stiffness[: springs.rows]
    l0 = springs.springs.length[: springs.rows]

    def energy(flat: np.ndarray) -> tuple[float, np.ndarray]:
        u = state.displacement.copy()
        u[free] = flat.reshape(-1, 3)
        x = mesh.rest + u
        length = np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1)
        return float(0.5 * (k * (length - l0) ** 2).sum()), -plain_forces(springs, u)[free].ravel()

    start = np.zeros(3 * len(free))
    found = minimize(energy, start, jac=True, options={"gtol": 1e-9, "maxiter": 2000})
    np.testing.assert_allclose(
        found.x.reshape(-1, 3), state.displacement[free], atol=1e-4 * np.abs(PULL).max()
    )
    assert model.residual(state) < 1e-6 * np.abs(plain_forces(springs, state.displacement)).max()


@pytest.mark.parametrize("step", [0.5, 1.0, 1.99])
def test_no_sweep_raises_the_energy_however_hard_the_pull(step: float) -> None:
    mesh = block_mesh(5)
    springs, state = double(mesh)
    model, _ = build("quasi_static", mesh, springs, state, levels=WHOLE_ORGAN, step=step)
    held = hold(model, state, top_ball(mesh, 0.018), mesh)
    state.displacement[held] = [0.1, 0.0, 0.3]
    rows = springs.rows
    ends, k = springs.springs.ends[:rows], springs.springs.stiffness[:rows]

    def energy() -> float:
        x = mesh.rest + state.displacement
        stretch = np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1)
        return float(0.5 * (k * (stretch - springs.springs.length[:rows]) ** 2).sum())

    energies = [energy()]
    for _ in range(50):
        model.step(state)
        energies.append(energy())
    assert (np.diff(energies) <= 1e-12 * energies[0]).all()
    assert energies[-1] < 0.5 * energies[0]


def test_a_symmetric_pull_ends_in_a_symmetric_shape() -> None:
    mesh = block_mesh(5)
    springs, state = double(mesh)
    model, _ = build("quasi_static", mesh, springs, state, levels=WHOLE_ORGAN)
    held = hold(model, state, top_ball(mesh, 0.016), mesh)
    state.displacement[held] = [0, 0, 0.005]
    steps(model, state, 3000)
    # The grid's diagonals all run along (1, 1, 1): exchanging x and y maps the mesh onto itself.
    points = mesh.rest[: mesh.node_rows]
    places = {tuple(np.round(p, 6)): row for row, p in enumerate(points)}
    twin = [places[tuple(np.round(p[[1, 0, 2]], 6))] for p in points]
    u = state.displacement[: mesh.node_rows]
    np.testing.assert_allclose(u[twin][:, [1, 0, 2]], u, atol=1e-8)


def moved_hold(keep: int) -> tuple[np.ndarray, np.ndarray]:
    """Pull at one place, let go and grab far away while the first place is still displaced."""
    mesh = block_mesh(11)
    model, state = build("quasi_static", mesh, levels=3, keep_until_rest=keep)
    points = mesh.rest[: mesh.node_rows]
    left = ball(mesh, np.array([0.006, 0.006, 0.06]), 0.009)
    right = ball(mesh, np.array([0.054, 0.054, 0.06]), 0.009)
    hold(model, state, left, mesh)
    state.displacement[left] = [0, 0, 0.006]
    steps(model, state, 30)
    hold(model, state, right, mesh)
    steps(model, state, 2000)
    return state.displacement[: mesh.node_rows], points


def test_nodes_that_leave_the_active_set_get_stuck_without_the_cure_and_rest_with_it() -> None:
    stuck, _ = moved_hold(keep=0)
    cured, _ = moved_hold(keep=1)
    assert np.abs(stuck).max() > 4e-3
    assert np.abs(cured).max() < 1e-5


@pytest.mark.parametrize("name", ["quasi_static", "lr"])
def test_released_tissue_returns_to_rest_and_the_sweeps_end(name: str) -> None:
    mesh = block_mesh(9)
    model, state = build(name, mesh)
    held = hold(model, state, top_ball(mesh), mesh)
    for frame in range(1, 31):
        state.displacement[held] = PULL * 1.5 * frame / 30
        steps(model, state, 4)
    release(model, state, mesh)
    # Two seconds of sixty frames with four steps each.
    steps(model, state, 480)
    assert np.abs(state.displacement).max() < 0.05 * np.linalg.norm(PULL)
    steps(model, state, 2000)
    assert np.abs(state.displacement).max() < 1e-4 * np.linalg.norm(PULL)
    assert model.active.count == 0  # type: ignore[attr-defined]


def test_momentum_brings_released_tissue_back_in_fewer_sweeps() -> None:
    left = {}
    for momentum in (0.0, 0.95):
        mesh = block_mesh(9)
        model, state = build("quasi_static", mesh, release_momentum=momentum)
        held = hold(model, state, top_ball(mesh), mesh)
        state.displacement[held] = PULL
        steps(model, state, 100)
        release(model, state, mesh)
        steps(model, state, 100)
        left[momentum] = np.abs(state.displacement).max()
    assert left[0.95] < 0.3 * left[0.0]


def test_a_threshold_ends_a_sweep_where_little_moves() -> None:
    mesh = block_mesh(9)
    moved = []
    for threshold in (0.0, 1e-5):
        model, state = build("quasi_static", mesh, threshold=threshold)
        held = hold(model, state, top_ball(mesh), mesh)
        state.displacement[held] = [0, 0, 1e-3]
        model.step(state)
        moved.append(int((state.displacement != 0).any(axis=1).sum()))
    assert len(held) < moved[1] < moved[0]


def test_a_model_that_takes_over_a_deformed_organ_brings_it_to_rest() -> None:
    mesh = block_mesh(7)
    first, state = build("relaxation", mesh)
    held = hold(first, state, top_ball(mesh), mesh)
    state.displacement[held] = PULL
    steps(first, state, 30)
    state.prescribed[:] = mesh.fixed
    second, _ = build("quasi_static", mesh, first.springs, state, levels=2)  # type: ignore[attr-defined]
    steps(second, state, 3000)
    assert np.abs(state.displacement).max() < 1e-6


def test_a_step_for_the_force_is_the_thesis_sweep() -> None:
    """x_i <- x_i + alpha F_i, node by node, with the newest neighbours: written out in numpy."""
    mesh = block_mesh(4)
    springs, state = double(mesh)
    alpha = 0.1 / float(springs.node_stiffness(np.arange(mesh.node_rows, dtype=np.int32)).max())
    model, _ = build(
        "quasi_static", mesh, springs, state, levels=WHOLE_ORGAN, keep_until_rest=0,
        force_step=alpha,
    )  # fmt: skip
    assert isinstance(model, QuasiStatic)
    held = hold(model, state, top_ball(mesh, 0.016), mesh)
    state.displacement[held] = PULL
    expected = state.displacement.copy()
    order = model.active.ordering.nodes[: model.active.end]
    for _ in range(2):
        for node in order[~state.prescribed[order]]:
            expected[node] += alpha * plain_forces(springs, expected)[node]
    steps(model, state, 2)
    assert np.abs(expected[~state.prescribed]).max() > 1e-5
    np.testing.assert_allclose(state.displacement, expected, atol=1e-15)


def test_only_the_product_of_step_and_stiffness_matters() -> None:
    mesh, shapes = block_mesh(5), []
    for factor in (1.0, 4.0):
        springs, state = double(mesh)
        springs.set_stiffness(factor * springs.springs.stiffness[: springs.rows])
        model, _ = build(
            "quasi_static", mesh, springs, state, force_step=2e-4 / factor, keep_until_rest=0
        )  # fmt: skip
        held = hold(model, state, top_ball(mesh), mesh)
        state.displacement[held] = PULL
        steps(model, state, 10)
        shapes.append(state.displacement.copy())
    np.testing.assert_allclose(shapes[1], shapes[0], atol=1e-15)


@pytest.mark.parametrize("model", ["quasi_static", "lr"])
def test_a_step_for_the_force_goes_with_the_plain_sweep_only(model: str) -> None:
    with pytest.raises(ValueError, match="allowed with it: keep_until_rest = 0"):
        build(model, block_mesh(4), force_step=1e-3)
    if model == "quasi_static":
        with pytest.raises(ValueError, match="allowed with it: momentum = 0"):
            build(model, block_mesh(4), force_step=1e-3, keep_until_rest=0, momentum=0.5)
        with pytest.raises(ValueError, match="allowed with it: chebyshev = 0"):
            build(model, block_mesh(4), force_step=1e-3, keep_until_rest=0, chebyshev=0.5)
