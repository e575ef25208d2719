"""Corotated finite elements: nothing swells or resists when it turns, and equilibrium is exact."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from support.allocations import least_peak
from support.elastic_scenes import (
    MATERIAL,
    apply,
    ball,
    block_mesh,
    build,
    double,
    hold,
    release,
    split_edit,
    steps,
    top_ball,
    wall_mesh,
)
from tissue_sim.elastic import registry
from tissue_sim.elastic.finite_element import FiniteElement
from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.stiffness import lame_constants
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.kernels.stiffness import product

EXACT = {"corotated": 1.0, "tolerance": 1e-9, "rest_tolerance": 1e-13}


def corotated(mesh: Mesh, **values: float) -> tuple[FiniteElement, State]:
    """In double precision."""
    springs, state = double(mesh)
    model, _ = build("finite_element", mesh, springs, state, **{**EXACT, **values})
    assert isinstance(model, FiniteElement)
    return model, state


def single(mesh: Mesh) -> tuple[FiniteElement, State]:
    """As it runs in a scene."""
    model, state = build("finite_element", mesh, corotated=1.0)
    assert isinstance(model, FiniteElement)
    return model, state


def settle(model: FiniteElement, state: State, most: int = 20000) -> int:
    for count in range(1, most):
        model.step(state)
        if model.idle:
            return count
    raise AssertionError("it does not come to rest")


def rows_of(mesh: Mesh) -> np.ndarray:
    return np.arange(mesh.node_rows, dtype=np.int32)


def tetrahedra(mesh: Mesh) -> np.ndarray:
    return mesh.tets[: mesh.element_rows][mesh.element_alive[: mesh.element_rows]]


def edges(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Edges from the first node of each tetrahedron, as columns, shape (elements, 3, 3)."""
    return (points[tets[:, 1:]] - points[tets[:, :1]]).transpose(0, 2, 1)


def volume(mesh: Mesh, state: State) -> float:
    x = mesh.rest[: mesh.node_rows] + state.displacement[: mesh.node_rows]
    return float(np.linalg.det(edges(x, tetrahedra(mesh))).sum() / 6)


def plain(mesh: Mesh, u: np.ndarray) -> tuple[float, np.ndarray]:
    """Energy [J] and forces [N] by the textbook formula, rotations by singular values."""
    lam, mu = lame_constants(MATERIAL)
    tets, rest = tetrahedra(mesh), mesh.rest[: mesh.node_rows]
    D = edges(rest, tets)
    inverse = np.linalg.inv(D)
    V = np.abs(np.linalg.det(D)) / 6
    F = edges(rest + u, tets) @ inverse
    U, _, Wt = np.linalg.svd(F)
    U[:, :, 2] *= np.linalg.det(U @ Wt)[:, None]
    R = U @ Wt
    S = R.transpose(0, 2, 1) @ F - np.eye(3)
    trace = np.trace(S, axis1=1, axis2=2)
    energy = (V * (mu * (S**2).sum(axis=(1, 2)) + lam / 2 * trace**2)).sum()
    P = 2 * mu * (F - R) + lam * trace[:, None, None] * R
    g = inverse  # Row k is the gradient of the shape function of corner k + 1.
    f = -V[:, None, None] * np.einsum("eij,ekj->eki", P, g)
    forces = np.zeros_like(u)
    for corner in range(3):
        np.add.at(forces, tets[:, corner + 1], f[:, corner])
    np.add.at(forces, tets[:, 0], -f.sum(axis=1))
    return float(energy), forces


def rigid(mesh: Mesh, vector: list[float]) -> np.ndarray:
    rest = mesh.rest[: mesh.node_rows]
    return Rotation.from_rotvec(vector).apply(rest) - rest


def bar() -> tuple[Mesh, np.ndarray]:
    """A bar fixed at one end, and its other end."""
    raw = block(19, 4, 4, 0.12, 0.02, 0.02)
    mesh = Mesh(raw, raw.points[:, 0] < 1e-9)
    return mesh, np.flatnonzero(mesh.rest[: mesh.node_rows, 0] > 0.12 - 1e-9).astype(np.int32)


def turn_end(mesh: Mesh, state: State, end: np.ndarray, vector: list, move: list) -> None:
    rest = mesh.rest[end]
    centre = rest.mean(axis=0)
    turned = Rotation.from_rotvec(vector).apply(rest - centre)
    state.displacement[end] = turned + centre + move - rest


def balance(mesh: Mesh, model: FiniteElement, state: State) -> None:
    """Forces on fixed and held nodes are in equilibrium, in the present shape."""
    rows = rows_of(mesh)
    F = model.forces(state, rows)
    x = mesh.rest[rows] + state.displacement[rows]
    given = state.prescribed[rows]
    size = np.abs(F[given]).sum()
    assert np.abs(F[~given]).max() < 1e-6 * size
    assert np.abs(F[given].sum(axis=0)).max() < 1e-6 * size
    assert np.abs(np.cross(x, F)[given].sum(axis=0)).max() < 1e-6 * size


@pytest.mark.parametrize("holding", [False, True])
def test_rest_and_translation_stay_bit_for_bit(holding: bool) -> None:
    mesh = block_mesh(6)
    model, state = single(mesh)
    if holding:
        hold(model, state, top_ball(mesh), mesh)
    steps(model, state, 150)
    assert not state.displacement.any()
    assert not model.forces(state, rows_of(mesh)).any()
    free = block_mesh(6, fixed=False)
    model, state = single(free)
    state.displacement[:] = [0.01, -0.02, 0.005]
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    before = state.displacement.copy()
    steps(model, state, 150)
    np.testing.assert_array_equal(state.displacement, before)
    assert model.idle


@pytest.mark.parametrize("angle", [0.3, 2.0, np.pi])
def test_a_turned_organ_has_no_force(angle: float) -> None:
    mesh = block_mesh(5, fixed=False)
    model, state = corotated(mesh)
    axis = np.array([1.0, 2.0, -2.0]) / 3
    state.displacement[rows_of(mesh)] = rigid(mesh, list(angle * axis))
    scale = model.springs.springs.stiffness.max() * 0.01
    assert np.abs(model.forces(state, rows_of(mesh))).max() < 1e-11 * scale


def test_a_turned_organ_stays_turned_in_single_precision() -> None:
    mesh = block_mesh(5, fixed=False)
    model, state = single(mesh)
    turned = rigid(mesh, [0.5, 0.3, -1.0])
    state.displacement[rows_of(mesh)] = turned
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    steps(model, state, 500)
    assert np.abs(state.displacement[rows_of(mesh)] - turned).max() < 1e-6
    assert model.idle


def test_forces_are_those_of_the_textbook_and_minus_the_slope_of_the_energy() -> None:
    """Whatever the shape, inverted elements included, none of which is at a switch of axes."""
    mesh = block_mesh(4)
    model, state = corotated(mesh)
    rows, random = rows_of(mesh), np.random.default_rng(2)
    tangent = model.corotated.tangent  # type: ignore[union-attr]
    for size in (1e-5, 1e-3, 2e-2):
        u = rigid(mesh, [0.2, 1.5, 0.4]) + random.normal(0, size, (len(rows), 3))
        state.displacement[rows] = u
        energy, expected = plain(mesh, u)
        forces = model.forces(state, rows)
        np.testing.assert_allclose(forces, expected, atol=1e-8 * np.abs(expected).max())
        some = np.array([5, 40, 7, 5, 41], dtype=np.int32)
        np.testing.assert_allclose(
            model.forces(state, some), forces[some], atol=1e-12 * np.abs(forces).max()
        )
        tangent.begin(state.displacement)
        while not tangent.complete:
            tangent.go_on()
        assert tangent.next.energy == pytest.approx(energy, rel=1e-9)
        np.testing.assert_allclose(
            tangent.next.force[rows], forces, atol=1e-9 * np.abs(forces).max()
        )
        x = mesh.rest[rows] + u
        assert np.abs(forces.sum(axis=0)).max() < 1e-12 * np.abs(forces).sum()
        assert np.abs(np.cross(x, forces).sum(axis=0)).max() < 1e-12 * np.abs(forces).sum()


def test_the_tangent_is_the_derivative_of_the_forces() -> None:
    mesh = block_mesh(4)
    model, state = corotated(mesh)
    rows, random = rows_of(mesh), np.random.default_rng(4)
    tangent = model.corotated.tangent  # type: ignore[union-attr]
    tangent.keep = 1.0
    shape = np.zeros_like(state.displacement)
    shape[rows] = 0.9 * rigid(mesh, [0.3, 1.9, -0.4]) + random.normal(0, 5e-4, (len(rows), 3))
    direction = np.zeros_like(shape)
    direction[rows] = random.normal(0, 1, (len(rows), 3))
    tangent.begin(shape)
    while not tangent.complete:
        tangent.go_on()
    tangent.swap()
    found = np.zeros_like(shape)
    product(len(rows), tangent.rows, np.zeros(len(shape), dtype=np.bool_), direction, found)
    h = 1e-7
    state.displacement[:] = shape + h * direction
    after = model.forces(state, rows)
    state.displacement[:] = shape - h * direction
    slope = (model.forces(state, rows) - after) / (2 * h)
    np.testing.assert_allclose(found[rows], slope, atol=1e-7 * np.abs(slope).max())
    # Rows that an edit makes anew are the same.
    blocks = tangent.now.blocks.copy()
    every = type("Change", (), {"nodes": rows})
    tangent.follow_at(every, shape)  # type: ignore[arg-type]
    np.testing.assert_allclose(tangent.now.blocks, blocks, atol=1e-12 * np.abs(blocks).max())


@pytest.mark.parametrize(
    ("vector", "move"), [([2.0, 0, 0], [0, 0, 0]), ([0, 0, 1.2], [-0.03, 0.06, 0])]
)
def test_a_twisted_and_a_bent_bar_keep_their_volume_and_are_in_equilibrium(
    vector: list[float], move: list[float]
) -> None:
    mesh, end = bar()
    linear, swollen = build("finite_element", mesh, *double(mesh), foresight=0.0)
    model, state = corotated(mesh, tolerance=1e-7)
    before = volume(mesh, state)
    for one, its in ((linear, swollen), (model, state)):
        assert isinstance(one, FiniteElement)
        hold(one, its, end.tolist(), mesh)
        turn_end(mesh, its, end, vector, move)
        settle(one, its)
    assert volume(mesh, swollen) > 1.2 * before
    assert volume(mesh, state) == pytest.approx(before, rel=0.01)
    balance(mesh, model, state)
    assert model.residual(state) < 1e-6 * np.abs(model.forces(state, end)).sum()


def test_small_strains_agree_with_the_linear_model_to_second_order() -> None:
    differences = []
    mesh = block_mesh(6)
    for size in (4e-4, 2e-4, 1e-4):
        found = []
        for values in ({"foresight": 0.0}, {"corotated": 1.0}):
            exact = {"tolerance": 1e-11, "rest_tolerance": 1e-13, **values}
            springs, state = double(mesh)
            model, _ = build("finite_element", mesh, springs, state, **exact)
            assert isinstance(model, FiniteElement)
            held = hold(model, state, top_ball(mesh, 0.02), mesh)
            state.displacement[held] = [size, -size / 2, 2 * size]
            settle(model, state)
            found.append(state.displacement.copy())
        differences.append(np.abs(found[0] - found[1]).max())
    orders = np.log2(np.array(differences[:-1]) / differences[1:])
    assert (orders > 1.9).all(), (differences, orders)


def test_equilibrium_is_where_scipy_finds_the_smallest_energy() -> None:
    mesh = block_mesh(5)
    model, state = corotated(mesh)
    held = hold(model, state, top_ball(mesh, 0.02), mesh)
    turn_end(mesh, state, held, [0.2, 0.1, 0.8], [0.01, 0.0, 0.008])
    rows = rows_of(mesh)
    given = state.prescribed[rows]
    u = np.where(given[:, None], state.displacement[rows], 0)
    settle(model, state)

    def value(free: np.ndarray) -> tuple[float, np.ndarray]:
        u[~given] = free.reshape(-1, 3)
        energy, forces = plain(mesh, u)
        return 1e3 * energy, -1e3 * forces[~given].ravel()

    options = {"maxiter": 5000, "maxcor": 40, "ftol": 1e-15, "gtol": 1e-7}
    best = minimize(  # type: ignore[call-overload]
        value, u[~given].ravel(), jac=True, method="L-BFGS-B", options=options
    )
    error = np.abs(state.displacement[rows][~given] - best.x.reshape(-1, 3)).max()
    assert error < 1e-4 * np.abs(state.displacement).max()
    assert plain(mesh, state.displacement[rows])[0] <= best.fun / 1e3 * (1 + 1e-9)


@pytest.mark.parametrize("start", ["half inverted", "collapsed"])
def test_it_recovers_from_inverted_elements(start: str) -> None:
    mesh = block_mesh(6)
    model, state = single(mesh)
    rows = np.flatnonzero(~mesh.fixed[: mesh.node_rows])
    rest, random = mesh.rest[rows], np.random.default_rng(7)
    if start == "collapsed":
        place = rest.mean(axis=0) + random.normal(0, 0.06e-3, rest.shape)
    else:
        place = rest + random.normal(0, 0.01, rest.shape)
    state.displacement[rows] = place - rest
    x = mesh.rest[: mesh.node_rows] + state.displacement[: mesh.node_rows]
    assert (np.linalg.det(edges(x, tetrahedra(mesh))) < 0).mean() > 0.3
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    settle(model, state)
    assert np.abs(state.displacement).max() < 1e-3 * 0.06


@pytest.mark.parametrize("scene", ["block", "wall"])
def test_a_hold_dragged_through_the_organ_at_1_m_per_s_leaves_it_at_rest(scene: str) -> None:
    mesh = block_mesh(9) if scene == "block" else wall_mesh()
    model, state = single(mesh)
    points = mesh.rest[: mesh.node_rows]
    size = np.ptp(points, axis=0).max()
    start = np.where(mesh.fixed[: mesh.node_rows], -np.inf, points[:, 2]).argmax()
    held = hold(model, state, ball(mesh, points[start], 0.15 * size), mesh)
    path = 2.0 * (points.mean(axis=0) - points[held].mean(axis=0))
    frames = int(np.ceil(60 * np.linalg.norm(path)))
    largest = 0.0
    for frame in range(1, frames + 1):
        state.displacement[held] = path * frame / frames
        steps(model, state, 10)
        largest = max(largest, float(np.abs(state.displacement).max()))
    release(model, state, mesh)
    for _ in range(5 * 60 * 10):
        model.step(state)
        largest = max(largest, float(np.abs(state.displacement).max()))
    assert largest < 5 * size
    assert np.abs(state.displacement).max() < 0.05 * size


def test_with_nothing_fixed_it_follows_and_stays() -> None:
    mesh = block_mesh(6, fixed=False)
    model, state = single(mesh)
    held = hold(model, state, top_ball(mesh, 0.025), mesh)
    turn_end(mesh, state, held, [0, 0, 0.5], [0.0, 0.0, 0.01])
    steps(model, state, 3000)
    assert model.idle
    # Nothing resists: it has turned as a whole.
    every = State(mesh, np.float64)
    turn_end(mesh, every, rows_of(mesh), [0, 0, 0.5], [0.0, 0.0, 0.01])
    offset = (every.displacement - state.displacement)[held].mean(axis=0)
    error = (every.displacement - offset - state.displacement)[rows_of(mesh)]
    assert np.abs(error).max() < 1e-5
    release(model, state, mesh)
    steps(model, state, 300)
    before = state.displacement.copy()
    steps(model, state, 300)
    assert np.abs(state.displacement - before).max() < 1e-6


def test_a_cut_is_followed_and_no_force_jumps() -> None:
    mesh = block_mesh(7)
    model, state = corotated(mesh, tolerance=1e-7)
    held = hold(model, state, top_ball(mesh, 0.02), mesh)
    turn_end(mesh, state, held, [0, 0, 0.6], [0.004, 0, 0.01])
    settle(model, state)
    rows = rows_of(mesh)
    before = model.forces(state, rows)
    middle = float(np.unique(mesh.rest[: mesh.node_rows, 0])[3])
    apply(mesh, model, state, split_edit(mesh, middle, above=0.02))
    assert mesh.node_rows > len(rows)
    after = model.forces(state, rows_of(mesh))
    np.testing.assert_allclose(after.sum(axis=0), before.sum(axis=0), atol=1e-9)
    held = hold(model, state, np.flatnonzero(state.prescribed & ~mesh.fixed).tolist(), mesh)
    settle(model, state)
    balance(mesh, model, state)
    fresh = FiniteElement(mesh, MATERIAL, dict(EXACT), SpringNetwork(mesh, MATERIAL, np.float64))
    fresh.prescribed_changed(state, held)
    found = state.displacement.copy()
    settle(fresh, state)
    assert np.abs(state.displacement - found).max() < 1e-6 * np.abs(found).max()


def test_it_takes_over_from_other_models_and_hands_over() -> None:
    mesh = block_mesh(6)
    first, state = build("lr", mesh)
    held = hold(first, state, top_ball(mesh), mesh)
    state.displacement[held] = [0, 0, 0.004]
    steps(first, state, 50)
    second = registry.build("finite_element", mesh, MATERIAL, {"corotated": 1.0})
    second.prescribed_changed(state, held)
    assert isinstance(second, FiniteElement)
    settle(second, state)
    np.testing.assert_allclose(state.displacement[held], [[0, 0, 0.004]] * len(held), rtol=1e-6)
    third = registry.build("finite_element", mesh, MATERIAL)
    third.prescribed_changed(state, held)
    release(third, state, mesh)
    steps(third, state, 1000)
    assert np.abs(state.displacement).max() < 2e-5


def test_the_same_inputs_and_steps_give_the_same_bits() -> None:
    def run() -> np.ndarray:
        mesh = block_mesh(6)
        model, state = single(mesh)
        held = hold(model, state, top_ball(mesh), mesh)
        for frame in range(1, 21):
            state.displacement[held] = [0.0, 0.0005 * frame, 0.001 * frame]
            steps(model, state, 10)
        apply(mesh, model, state, split_edit(mesh, float(np.unique(mesh.rest[:, 0])[2]), 0.03))
        release(model, state, mesh)
        steps(model, state, 100)
        return state.displacement

    first = run()
    assert first.any()
    np.testing.assert_array_equal(run(), first)


def test_steps_allocate_no_arrays() -> None:
    mesh = block_mesh(17)
    model, state = single(mesh)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0, 0, 0.003]
    steps(model, state, 10)

    def on_the_way() -> None:
        state.displacement[held] += [0, 0, 0.001]
        steps(model, state, 20)

    assert least_peak(on_the_way) < 8 * mesh.node_rows


def test_a_lost_state_that_is_put_back_is_taken_up_again() -> None:
    mesh = block_mesh(6)
    model, state = single(mesh)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0.003, 0, 0.01]
    steps(model, state, 100)
    good = state.displacement.copy()
    solver = model.corotated
    assert solver is not None
    solver.shape[50] = np.nan
    solver.tangent.now.blocks[:] = np.nan
    steps(model, state, 3)
    assert np.isnan(state.displacement).any()
    state.displacement[:] = good
    model.prescribed_changed(state, held)
    settle(model, state)
    assert np.isfinite(state.displacement).all()
    found = state.displacement.copy()
    fresh, state = single(mesh)
    hold(fresh, state, held.tolist(), mesh)
    state.displacement[held] = [0.003, 0, 0.01]
    settle(fresh, state)
    assert np.abs(state.displacement - found).max() < 1e-3 * 0.01
