"""Linear finite elements: right against scikit-fem, exact once a hold's motions are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import skfem
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation
from skfem.helpers import ddot, sym_grad, trace

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
from tissue_sim.elastic.stiffness import lame_constants
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.scene_geometry import load
from tissue_sim.geometry.shapes import block

EXACT = {"tolerance": 1e-11, "rest_tolerance": 1e-13, "foresight": 0.0}


def skfem_stiffness(mesh: Mesh) -> tuple[skfem.Basis, csr_matrix]:
    """Basis and matrix of the same mesh and material, node by node."""
    lam, mu = lame_constants(MATERIAL)
    rows = mesh.node_rows
    tets = mesh.tets[: mesh.element_rows][mesh.element_alive[: mesh.element_rows]]
    skmesh = skfem.MeshTet(mesh.rest[:rows].T.copy(), tets.T.astype(np.int64).copy())
    basis = skfem.Basis(skmesh, skfem.ElementVector(skfem.ElementTetP1()))

    @skfem.BilinearForm
    def elasticity(u, v, _):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        return lam * trace(sym_grad(u)) * trace(sym_grad(v)) + 2 * mu * ddot(
            sym_grad(u), sym_grad(v)
        )

    return basis, elasticity.assemble(basis)


def skfem_solution(mesh: Mesh, prescribed: np.ndarray, u: np.ndarray) -> tuple:
    """Displacements and forces on nodes [N], the same conditions solved directly."""
    basis, K = skfem_stiffness(mesh)
    dofs = basis.nodal_dofs  # (3, nodes)
    x = np.zeros(K.shape[0])
    x[dofs] = u.T
    fixed = dofs[:, prescribed].ravel()
    solved = skfem.solve(*skfem.condense(K, x=x, D=fixed))
    return solved[dofs].T, -(K @ solved)[dofs].T


def exact(mesh: Mesh, **values: float) -> tuple[FiniteElement, State]:
    springs, state = double(mesh)
    model, _ = build("finite_element", mesh, springs, state, **{**EXACT, **values})
    assert isinstance(model, FiniteElement)
    return model, state


def settle(model: FiniteElement, state: State, most: int = 5000) -> int:
    """Step until nothing is left to solve; how many steps."""
    for count in range(1, most):
        model.step(state)
        if model.idle:
            return count
    raise AssertionError("it does not come to rest")


def turn(mesh: Mesh, state: State, held: np.ndarray, turn: Rotation, move: list[float]) -> None:
    rest = mesh.rest[held]
    centre = rest.mean(axis=0)
    state.displacement[held] = turn.apply(rest - centre) + centre + move - rest


def compare(mesh: Mesh, model: FiniteElement, state: State, held: np.ndarray) -> None:
    rows = mesh.node_rows
    prescribed = state.prescribed[:rows]
    u, f = skfem_solution(
        mesh, prescribed, np.where(prescribed[:, None], state.displacement[:rows], 0)
    )
    size = np.abs(u).max()
    np.testing.assert_allclose(state.displacement[:rows], u, atol=1e-6 * size)
    forces = model.forces(state, np.arange(rows, dtype=np.int32))
    np.testing.assert_allclose(forces, f, atol=1e-6 * np.abs(f).max())
    # What the tool feels balances what the fixed nodes feel.
    np.testing.assert_allclose(
        forces[prescribed].sum(axis=0), 0, atol=1e-6 * np.abs(forces[held]).sum()
    )


def test_displacements_of_a_bent_cantilever_equal_those_of_scikit_fem() -> None:
    raw = block(25, 5, 5, 0.12, 0.02, 0.02)
    mesh = Mesh(raw, raw.points[:, 0] < 1e-9)
    model, state = exact(mesh)
    held = hold(model, state, np.flatnonzero(raw.points[:, 0] > 0.12 - 1e-9), mesh)
    assert len(held) == mesh.fixed.sum() == 25
    state.displacement[held] = [0, 0, -0.004]
    settle(model, state)
    compare(mesh, model, state, held)
    # It bends and shears as Timoshenko's beam does whose ends stay upright: at a quarter.
    shear = 2 * (1 + MATERIAL.poisson_ratio) / (5 / 6) * (0.02 / 0.12) ** 2
    expected = (3 / 16 - 2 / 64 + shear / 4) / (1 + shear)
    quarter = np.abs(raw.points[:, 0] - 0.03) < 1e-9
    share = state.displacement[: mesh.node_rows][quarter, 2].mean() / -0.004
    assert share == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("scene", ["block", "wall"])
def test_displacements_and_reactions_equal_those_of_scikit_fem(scene: str) -> None:
    mesh = block_mesh(8) if scene == "block" else wall_mesh()
    model, state = exact(mesh)
    held = hold(model, state, top_ball(mesh, 0.02), mesh)
    turn(mesh, state, held, Rotation.from_rotvec([0.1, -0.2, 0.3]), [0.001, 0.002, 0.006])
    settle(model, state)
    compare(mesh, model, state, held)


def test_displacements_of_a_real_heart_equal_those_of_scikit_fem(shared_meshes: Path) -> None:
    path = shared_meshes / "toronto_chd" / "derived_2018002_tof_ftetwild_33k.vtu"
    mesh = load(str(path), "mm", "auto").mesh
    model, state = exact(mesh, tolerance=1e-9)
    points = np.where(mesh.fixed[: mesh.node_rows, None], -np.inf, mesh.rest[: mesh.node_rows])
    held = hold(model, state, ball(mesh, mesh.rest[points[:, 2].argmax()], 0.008), mesh)
    assert len(held) > 10
    state.displacement[held] = [0.002, 0.001, 0.005]
    settle(model, state)
    compare(mesh, model, state, held)


def test_a_linear_displacement_of_the_surface_is_linear_inside() -> None:
    """The patch test, on elements all of which have different shapes inside."""
    raw = block(6, 6, 6, 0.06, 0.06, 0.06)
    outside = ((raw.points < 1e-9) | (raw.points > 0.06 - 1e-9)).any(axis=1)
    surface, edge = np.flatnonzero(outside), 0.06 / 5
    assert len(surface) == 6**3 - 4**3
    away = np.random.default_rng(4).normal(size=(4**3, 3))
    raw.points[~outside] += 0.15 * edge * away / np.linalg.norm(away, axis=1)[:, None]
    mesh = Mesh(raw, np.isin(np.arange(6**3), raw.node_sets["fixed"]))
    model, state = exact(mesh)
    rows = mesh.node_rows
    rest = mesh.rest[:rows]
    gradient = np.array([[0.01, 0.02, -0.01], [0.0, -0.03, 0.02], [0.015, 0.0, 0.01]])
    held = hold(model, state, surface.tolist(), mesh)
    state.displacement[surface] = rest[surface] @ gradient.T
    settle(model, state)
    assert set(held) == set(surface)
    np.testing.assert_allclose(state.displacement[:rows], rest @ gradient.T, atol=1e-12)


def test_the_error_falls_with_the_square_of_the_element_size() -> None:
    """u = grad (e^2.5x cos 1.5y cos 2z) is free of divergence and in equilibrium without a load."""
    errors = []
    for nodes in (9, 17, 33):
        mesh = block_mesh(nodes)
        rest = mesh.rest[: mesh.node_rows] / 0.06
        x, y, z = rest.T
        grown = 1e-3 * np.exp(2.5 * x)
        solution = np.stack(
            [
                2.5 * grown * np.cos(1.5 * y) * np.cos(2 * z),
                -1.5 * grown * np.sin(1.5 * y) * np.cos(2 * z),
                -2 * grown * np.cos(1.5 * y) * np.sin(2 * z),
            ],
            axis=1,
        )
        model, state = exact(mesh)
        edge = ((rest < 1e-9) | (rest > 1 - 1e-9)).any(axis=1)
        hold(model, state, np.flatnonzero(edge).tolist(), mesh)
        state.displacement[: len(rest)][edge] = solution[edge]
        settle(model, state)
        errors.append(np.sqrt(((state.displacement[: len(rest)] - solution) ** 2).mean()))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-1] > 1.8, (errors, orders)


def test_after_the_motions_of_a_hold_are_known_every_pose_is_exact_in_one_step() -> None:
    mesh = wall_mesh()
    model, state = exact(mesh)
    random = np.random.default_rng(3)
    held = hold(model, state, top_ball(mesh, 0.012), mesh)

    def pose() -> None:
        vector = random.normal(0, 0.2, 3)
        turn(mesh, state, held, Rotation.from_rotvec(vector), random.normal(0, 0.005, 3).tolist())

    for _ in range(14):
        pose()
        settle(model, state)
    # Three translations and nine entries of a matrix.
    assert model.responses.used == 12
    for _ in range(5):
        pose()
        assert settle(model, state) == 1
        compare(mesh, model, state, held)


def test_motions_are_solved_for_before_they_occur() -> None:
    mesh = wall_mesh()
    model, state = exact(mesh, foresight=1)
    held = hold(model, state, top_ball(mesh, 0.012), mesh)
    settle(model, state)
    assert model.responses.used == 12
    assert not state.displacement.any()
    turn(mesh, state, held, Rotation.from_rotvec([0.5, 0.2, -0.3]), [0.001, 0.004, 0.006])
    assert settle(model, state) == 1
    compare(mesh, model, state, held)


def test_a_motion_that_occurs_comes_before_those_foreseen() -> None:
    mesh = block_mesh(9)
    model, state = exact(mesh, foresight=1, tolerance=1e-5)
    held = hold(model, state, top_ball(mesh, 0.012), mesh)
    steps(model, state, 5)
    state.displacement[held] = [0.001, 0.002, 0.003]
    settled_to(model, state, 1e-3)
    assert model.responses.used <= 2


def settled_to(model: FiniteElement, state: State, tolerance: float) -> int:
    """Step until the residual is small; how many steps."""
    free = np.flatnonzero(~state.prescribed[: model.mesh.node_rows]).astype(np.int32)
    held = np.flatnonzero(state.prescribed[: model.mesh.node_rows]).astype(np.int32)
    for count in range(1, 5000):
        model.step(state)
        residual = np.linalg.norm(model.forces(state, free))
        if residual < tolerance * np.linalg.norm(model.forces(state, held)):
            return count
    raise AssertionError("it does not converge")


def test_two_holds_move_at_once_and_one_lets_go() -> None:
    mesh = block_mesh(8)
    model, state = exact(mesh)
    points = mesh.rest[: mesh.node_rows]
    left = ball(mesh, np.array([0.0, 0.03, 0.06]), 0.012)
    right = ball(mesh, np.array([0.06, 0.03, 0.06]), 0.012)
    assert len(points) > len(left) + len(right) > 8
    both = hold(model, state, [*left, *right], mesh)
    for frame in range(1, 6):
        state.displacement[left] = [-0.001 * frame, 0, 0.0005 * frame]
        turn(mesh, state, right, Rotation.from_euler("y", 0.05 * frame), [0.001 * frame, 0, 0])
        steps(model, state, 3)
    settle(model, state)
    compare(mesh, model, state, both)
    held = hold(model, state, right.tolist(), mesh)
    settle(model, state)
    compare(mesh, model, state, held)
    release(model, state, mesh)
    settle(model, state)
    assert np.abs(state.displacement).max() < 1e-9


def test_after_a_cut_the_matrix_is_that_of_a_new_one_and_the_solution_goes_on() -> None:
    mesh = block_mesh(9)
    model, state = exact(mesh)
    held = hold(model, state, top_ball(mesh, 0.02), mesh)
    state.displacement[held] = [0.002, 0, 0.006]
    settle(model, state)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    before = model.forces(state, rows)
    total = before[state.prescribed[rows]].sum(axis=0)
    apply(mesh, model, state, split_edit(mesh, 0.015, above=0.02))
    held = hold(model, state, [r for r in held if not mesh.fixed[r]], mesh)
    # Copies share what their parents had: no force appears, none vanishes.
    after = model.forces(state, np.arange(mesh.node_rows, dtype=np.int32))
    np.testing.assert_allclose(after.sum(axis=0), before.sum(axis=0), atol=1e-9)
    assert mesh.node_rows > len(rows)
    fresh = FiniteElement(mesh, MATERIAL, dict(EXACT), None)
    assert fresh.springs is not model.springs
    u = State(mesh, np.float32)
    u.displacement[: mesh.node_rows] = state.displacement[: mesh.node_rows]
    every = np.arange(mesh.node_rows, dtype=np.int32)
    np.testing.assert_allclose(fresh.forces(u, every), after, atol=1e-4 * np.abs(after).max())
    settle(model, state)
    compare(mesh, model, state, held)
    assert not np.allclose(model.forces(state, held).sum(axis=0), total, rtol=0.01)


def test_what_was_known_before_a_cut_is_where_the_solution_starts_from() -> None:
    mesh = block_mesh(11)
    model, state = exact(mesh, tolerance=1e-4)
    held = hold(model, state, ball(mesh, np.array([0.06, 0.03, 0.06]), 0.015), mesh)
    for move in ([0.004, 0, 0], [0.004, 0.003, 0]):
        state.displacement[held] = move
        settle(model, state)
    apply(mesh, model, state, split_edit(mesh, 0.012, above=0.047))
    settle(model, state)
    state.displacement[held] = [0.004, -0.003, 0]
    from_known = settle(model, state)
    compare_loosely(mesh, model, state)
    model.prescribed_changed(state, held)
    settle(model, state)
    state.displacement[held] = [0.004, 0.003, 0]
    from_nothing = settle(model, state)
    assert from_known < 0.9 * from_nothing


def test_what_is_left_of_the_forces_shrinks_as_a_hold_goes_back_to_rest() -> None:
    mesh = block_mesh(9)
    model, state = build("finite_element", mesh)
    assert isinstance(model, FiniteElement)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0.004, 0.002, 0.003]
    settle(model, state)
    # Another grab of the same nodes, far from rest.
    model.prescribed_changed(state, held)
    settle(model, state)
    free = np.flatnonzero(~state.prescribed[: mesh.node_rows]).astype(np.int32)
    for share in (1.0, 1e-1, 1e-2, 1e-3):
        state.displacement[held] = share * np.array([0.004, 0.002, 0.003])
        assert settle(model, state) == 1
        forces = np.linalg.norm(model.forces(state, held))
        assert np.linalg.norm(model.forces(state, free)) < 3e-4 * forces


def compare_loosely(mesh: Mesh, model: FiniteElement, state: State) -> None:
    """Within 1 % of the hold's motion."""
    rows = mesh.node_rows
    prescribed = state.prescribed[:rows]
    given = np.where(prescribed[:, None], state.displacement[:rows], 0)
    u, _ = skfem_solution(mesh, prescribed, given)
    error = np.abs(state.displacement[:rows] - u).max()
    assert error < 0.01 * np.abs(given).max()


def test_an_organ_with_nothing_fixed_neither_drifts_nor_blows_up() -> None:
    mesh = block_mesh(7, fixed=False)
    model, state = build("finite_element", mesh)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0, 0, 0.005]
    steps(model, state, 500)
    # Nothing pulls back: it follows as a whole.
    rows = mesh.node_rows
    assert np.abs(state.displacement[:rows] - [0, 0, 0.005]).max() < 1e-4
    release(model, state, mesh)
    steps(model, state, 300)
    before = state.displacement.copy()
    steps(model, state, 300)
    assert np.abs(state.displacement - before).max() < 1e-6
    assert np.abs(state.displacement[:rows] - [0, 0, 0.005]).max() < 1e-4


def test_a_component_cut_free_neither_drifts_nor_blows_up() -> None:
    mesh = block_mesh(7)
    model, state = build("finite_element", mesh)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0, 0, 0.004]
    steps(model, state, 200)
    middle = np.unique(mesh.rest[: mesh.node_rows, 0])[3]
    apply(mesh, model, state, split_edit(mesh, float(middle)))
    release(model, state, mesh)
    steps(model, state, 600)
    assert np.abs(state.displacement).max() < 0.01
    before = state.displacement.copy()
    steps(model, state, 300)
    assert np.abs(state.displacement - before).max() < 1e-6


def test_matrix_and_preconditioner_are_those_of_dense_linear_algebra() -> None:
    mesh = block_mesh(4)
    model, state = exact(mesh)
    _, K = skfem_stiffness(mesh)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    random = np.random.default_rng(0)
    state.displacement[rows] = random.normal(0, 1e-3, (len(rows), 3))
    expected = -(K @ state.displacement[rows].ravel()).reshape(-1, 3)
    np.testing.assert_allclose(
        model.forces(state, rows), expected, atol=1e-12 * np.abs(expected).max()
    )
    blocks = model.stiffness.inverse[rows].reshape(-1, 3, 3)
    for row in rows[:: len(rows) // 7]:
        block = K[3 * row : 3 * row + 3][:, 3 * row : 3 * row + 3].toarray()
        np.testing.assert_allclose(blocks[row] @ block, np.eye(3), atol=1e-12)


def test_models_of_other_names_start_it_and_take_over() -> None:
    """A hold is kept and the tissue goes on from where it is."""
    mesh = wall_mesh()
    first, state = build("lr", mesh)
    held = hold(first, state, top_ball(mesh, 0.012), mesh)
    state.displacement[held] = [0, 0, 0.006]
    steps(first, state, 100)
    second = registry.build("finite_element", mesh, MATERIAL)
    second.prescribed_changed(state, held)
    assert isinstance(second, FiniteElement)
    settle(second, state)
    compare_loosely(mesh, second, state)


def test_on_the_wall_every_frame_is_exact_from_the_first_after_a_grab() -> None:
    """40 steps of 0.15 ms a frame: single precision, default parameters, a hold that turns."""
    mesh = wall_mesh()
    model, state = build("finite_element", mesh)
    assert isinstance(model, FiniteElement)
    held = hold(model, state, ball(mesh, np.array([0.032, 0.1, 0.002]), 0.008), mesh)
    free = np.flatnonzero(~state.prescribed[: mesh.node_rows]).astype(np.int32)
    prescribed = np.flatnonzero(state.prescribed[: mesh.node_rows]).astype(np.int32)
    for frame in range(1, 61):
        t = frame / 60
        angles = Rotation.from_euler("xyz", [0.3 * np.sin(3 * t), 0.2 * t, 0.5 * t**2])
        turn(mesh, state, held, angles, [0.004 * t, 0.003 * np.sin(2 * t), 0.012 * t])
        steps(model, state, 40)
        residual = np.linalg.norm(model.forces(state, free))
        assert residual < 1e-3 * np.linalg.norm(model.forces(state, prescribed)), frame
        if frame % 6 == 0:
            compare_loosely(mesh, model, state)
