"""A material per region and fibres: energies, equilibria, cuts and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import skfem
from numba import njit
from scipy.spatial.transform import Rotation
from skfem.helpers import ddot, dot, mul, sym_grad, trace

from support.elastic_scenes import apply, hold, split_edit, top_ball
from tissue_sim.elastic import registry
from tissue_sim.elastic.finite_element import FiniteElement
from tissue_sim.elastic.material_field import MaterialError
from tissue_sim.elastic.model import Material, RegionMaterial, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.vertex_block_descent import VertexBlockDescent
from tissue_sim.frame import Budget, Command, FrameInputs, ToolSample
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.fibres import fibres_of
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.regions import paint
from tissue_sim.geometry.shapes import block
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.kernels.mixed_matter import mixed_response, mixed_sums
from tissue_sim.kernels.vertex_descent import gather
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

SIZE = 0.06
SOFT, SCAR = (5e4, 0.45), (2e5, 0.2)
PLAIN = Material()
MIXED = Material(
    5e4, 0.45, 1060.0, 8e4, (RegionMaterial("scar", 2e5, 0.2, 2000.0, fibre_stiffness=3e5),)
)
EXACT = {"tolerance": 1e-11, "rest_tolerance": 1e-13, "foresight": 0.0}
DESCENT = {"levels": WHOLE_ORGAN, "rest_tolerance": 1e-12}


def organ(nodes: int = 4, fixed: bool = True, fibres: str = "around:0,0,1") -> Mesh:
    """A block with a scar in its upper half and fibres in circles."""
    raw = block(nodes, nodes, nodes, SIZE, SIZE, SIZE)
    raw = paint(raw, {"scar": "box:-1,1,-1,1,0.03,1"})
    raw = replace(raw, fibres=fibres_of(raw, fibres))
    mask = np.zeros(len(raw.points), dtype=np.bool_)
    if fixed:
        mask[raw.node_sets["fixed"]] = True
    return Mesh(raw, mask)


def made(
    name: str, mesh: Mesh, values: dict[str, float], material: Material = MIXED
) -> tuple[FiniteElement | VertexBlockDescent, State]:
    springs, state = SpringNetwork(mesh, material, np.float64), State(mesh, np.float64)
    model = registry.build(name, mesh, material, values, springs)
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    assert isinstance(model, (FiniteElement, VertexBlockDescent))
    return model, state


@njit
def sums_of(i, lanes, first, corners, gradients, rows, u):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    return mixed_sums(i, lanes, first, corners, gradients, rows, u, 0.0, 0.5)


def all_rows(mesh: Mesh) -> np.ndarray:
    return np.arange(mesh.node_rows, dtype=np.int32)


def shake(mesh: Mesh, state: State, size: float) -> None:
    rows = mesh.node_rows
    state.displacement[:rows] = np.random.default_rng(3).normal(scale=size, size=(rows, 3))


def solved(model: FiniteElement | VertexBlockDescent, state: State, most: int = 20000) -> None:
    for _ in range(most):
        model.step(state)
        if model.idle:
            return
    raise AssertionError("it does not come to rest")


def pulled(name: str, mesh: Mesh, pull: np.ndarray, values: dict[str, float]) -> tuple:
    """A model, its state and the held nodes once the top is pulled and all is in equilibrium."""
    model, state = made(name, mesh, values)
    held = hold(model, state, top_ball(mesh, 0.025), mesh)
    state.displacement[held] = pull
    solved(model, state)
    return model, state, held


def energy_of(model: FiniteElement | VertexBlockDescent, state: State) -> float:
    if isinstance(model, VertexBlockDescent):
        return model.energy(state)
    # Corotated: a renewal sums up the energy.
    tangent = model.corotated.tangent  # type: ignore[union-attr]
    tangent.begin(state.displacement)
    while not tangent.complete:
        tangent.go_on()
    return tangent.next.energy


def skfem_solution(mesh: Mesh, prescribed: np.ndarray, u: np.ndarray) -> tuple:
    """Displacements and forces on nodes [N] of the same regions and fibres, solved directly."""
    rows = mesh.node_rows
    alive = np.flatnonzero(mesh.element_alive[: mesh.element_rows])
    tets = mesh.tets[alive]
    skmesh = skfem.MeshTet(mesh.rest[:rows].T.copy(), tets.T.astype(np.int64).copy())
    basis = skfem.Basis(skmesh, skfem.ElementVector(skfem.ElementTetP1()))
    constant = basis.with_element(skfem.ElementTetP0())
    scar = mesh.regions[alive] == mesh.regions.max()

    def field(soft: float, stiff: float):  # type: ignore[no-untyped-def]  # noqa: ANN202
        return constant.interpolate(np.where(scar, stiff, soft))

    def lame(E: float, nu: float) -> tuple[float, float]:
        return E * nu / (1 + nu) / (1 - 2 * nu), E / 2 / (1 + nu)

    (lam_a, mu_a), (lam_b, mu_b) = lame(*SOFT), lame(*SCAR)
    f = mesh.fibres[alive].astype(np.float64)

    @skfem.BilinearForm
    def elasticity(u, v, w):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        direction = np.array([w.f0, w.f1, w.f2])
        hooke = w.lam * trace(sym_grad(u)) * trace(sym_grad(v))
        hooke = hooke + 2 * w.mu * ddot(sym_grad(u), sym_grad(v))
        along_u = dot(direction, mul(sym_grad(u), direction))
        return hooke + w.k * along_u * dot(direction, mul(sym_grad(v), direction))

    parts = {f"f{axis}": constant.interpolate(f[:, axis]) for axis in range(3)}
    K = elasticity.assemble(
        basis, lam=field(lam_a, lam_b), mu=field(mu_a, mu_b), k=field(8e4, 3e5), **parts
    )
    dofs = basis.nodal_dofs
    x = np.zeros(K.shape[0])
    x[dofs] = u[:rows].T
    found = skfem.solve(*skfem.condense(K, x=x, D=dofs[:, prescribed].ravel()))
    return found[dofs].T, -(K @ found)[dofs].T


def assert_equals_skfem(mesh: Mesh, model: FiniteElement, state: State) -> None:
    rows = mesh.node_rows
    alive = mesh.node_alive[:rows]
    u, forces = skfem_solution(mesh, state.prescribed[:rows] | ~alive, state.displacement)
    got = state.displacement[:rows]
    assert np.abs(got - u)[alive].max() < 1e-6 * np.abs(u).max()
    found = model.forces(state, all_rows(mesh))
    assert np.abs(found - forces)[alive].max() < 1e-6 * np.abs(forces).max()


def test_finite_elements_equal_scikit_fem_before_and_after_a_cut() -> None:
    mesh = organ()
    model, state, _ = pulled("finite_element", mesh, np.array([0.002, -0.001, 0.004]), EXACT)
    assert isinstance(model, FiniteElement)
    assert_equals_skfem(mesh, model, state)
    apply(mesh, model, state, split_edit(mesh, 0.02, above=0.01))
    solved(model, state)
    assert_equals_skfem(mesh, model, state)


@pytest.mark.parametrize(("name", "extra"), [("finite_element", 1.0), ("vertex_block_descent", 0)])
def test_forces_are_the_derivative_of_the_energy(name: str, extra: float) -> None:
    mesh = organ(3)
    values = {"corotated": 1.0} if extra else DESCENT
    model, state = made(name, mesh, values)
    shake(mesh, state, 0.003)
    rows, h = all_rows(mesh), 1e-7
    forces = model.forces(state, rows)
    for node in (0, 7, 13, 26):
        for axis in range(3):
            energies = []
            for sign in (-1, 1):
                state.displacement[node, axis] += sign * h
                energies.append(energy_of(model, state))
                state.displacement[node, axis] -= sign * h
            slope = (energies[1] - energies[0]) / (2 * h)
            assert -slope == pytest.approx(forces[node, axis], rel=1e-5, abs=1e-6)


def test_the_hessian_of_a_node_is_that_of_its_forces_and_never_negative() -> None:
    """Where fibres are stretched it is exact, where they are shortened a part is left out."""
    mesh = organ(3)
    model, state = made("vertex_block_descent", mesh, DESCENT)
    assert isinstance(model, VertexBlockDescent)
    blocks, node = model.problem.blocks, 13
    first, lanes = blocks.start[node], blocks.lanes[node]
    w = np.empty(9 * int(lanes))

    def response(e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gather(lanes, 3 * first, blocks.corners, state.displacement, node, w)
        found = mixed_response(lanes, first, blocks.gradients, blocks.matter, w, *e)
        k = found[3:9]
        return np.array(found[:3]), np.array([k[:3], [k[1], k[3], k[4]], [k[2], k[4], k[5]]])

    def at_once() -> np.ndarray:
        args = (node, lanes, first, blocks.corners, blocks.gradients, blocks.matter)
        return np.array(sums_of(*args, state.displacement))

    shake(mesh, state, 0.004)
    F, K = response(np.zeros(3))
    np.testing.assert_allclose(
        at_once()[:9], [*F, *K[np.triu_indices(3)]], rtol=1e-9, atol=1e-9 * np.abs(K).max()
    )
    state.displacement[: mesh.node_rows] = 0.2 * mesh.rest[: mesh.node_rows]
    _, K = response(np.zeros(3))
    h = 1e-7
    slopes = [(response(-h * a)[0] - response(h * a)[0]) / (2 * h) for a in np.eye(3)]
    np.testing.assert_allclose(np.array(slopes), K, rtol=1e-6, atol=1e-6 * np.abs(K).max())
    # Regions of less lambda / mu take away from the whole's Hessian; fibres alone add to it.
    model, state = made("vertex_block_descent", mesh, DESCENT, replace(MIXED, regions=()))
    assert isinstance(model, VertexBlockDescent)
    blocks = model.problem.blocks
    for seed in range(20):
        rows = mesh.node_rows
        state.displacement[:rows] = np.random.default_rng(seed).normal(scale=0.02, size=(rows, 3))
        assert np.linalg.eigvalsh(response(np.zeros(3))[1]).min() > -1e-9 * np.abs(K).max()


@pytest.mark.parametrize(
    ("name", "values"),
    [("finite_element", {"corotated": 1.0}), ("vertex_block_descent", DESCENT)],
)
def test_a_rigid_rotation_makes_no_force(name: str, values: dict[str, float]) -> None:
    mesh = organ(fixed=False)
    model, state = made(name, mesh, values)
    x = mesh.rest[: mesh.node_rows]
    turned = Rotation.from_rotvec([0.3, -0.8, 1.9]).apply(x - x.mean(axis=0))
    state.displacement[: mesh.node_rows] = turned + x.mean(axis=0) + 0.01 - x
    assert np.abs(model.forces(state, all_rows(mesh))).max() < 1e-8
    shake(mesh, state, 1e-3)
    assert np.abs(model.forces(state, all_rows(mesh))).max() > 1.0


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("finite_element", {**EXACT, "corotated": 1.0}),
        ("vertex_block_descent", DESCENT),
    ],
)
def test_models_agree_at_a_strain_of_a_thousandth(name: str, values: dict[str, float]) -> None:
    mesh = organ()
    pull = 1e-3 * SIZE * np.array([0.3, 0.2, 0.8])
    linear, of_linear, held = pulled("finite_element", mesh, pull, EXACT)
    other, of_other, _ = pulled(name, mesh, pull, values)
    rows = all_rows(mesh)
    away = np.abs(of_other.displacement - of_linear.displacement)[rows].max()
    assert away < 4e-3 * np.abs(pull).max()
    exact, found = linear.forces(of_linear, held), other.forces(of_other, held)
    assert (
        np.abs(found.sum(axis=0) - exact.sum(axis=0)).max() < 1e-2 * np.abs(exact.sum(axis=0)).max()
    )
    # And it is the regions and fibres that make these displacements.
    _, of_plain, _ = pulled_plain(mesh, pull)
    assert (
        np.abs(of_plain.displacement - of_linear.displacement)[rows].max()
        > 0.05 * np.abs(pull).max()
    )


def pulled_plain(mesh: Mesh, pull: np.ndarray) -> tuple:
    model, state = made("finite_element", mesh, EXACT, PLAIN)
    held = hold(model, state, top_ball(mesh, 0.025), mesh)
    state.displacement[held] = pull
    solved(model, state)
    return model, state, held


@pytest.mark.parametrize("name", ["finite_element", "vertex_block_descent"])
def test_two_materials_in_series_share_the_strain(name: str) -> None:
    """nu = 0, lower half E, upper half 4 E: the middle moves by 4/5 of the top."""
    mesh = organ(5, fibres="none")
    material = Material(5e4, 0.0, 1060.0, 0.0, (RegionMaterial("scar", 2e5, 0.0, 1060.0),))
    values = EXACT if name == "finite_element" else DESCENT
    model, state = made(name, mesh, values, material)
    z = mesh.rest[: mesh.node_rows, 2]
    held = hold(model, state, np.flatnonzero(z > SIZE - 1e-9), mesh)
    state.displacement[held] = [0.0, 0.0, 1e-5]
    solved(model, state)
    closed = np.where(z <= SIZE / 2, 1.6 * z / SIZE, 0.8 + 0.4 * (z / SIZE - 0.5)) * 1e-5
    assert np.abs(state.displacement[: mesh.node_rows, 2] - closed).max() < 3e-4 * 1e-5
    force = -model.forces(state, held).sum(axis=0)
    # Area E_soft strain_soft.
    assert force[2] == pytest.approx(SIZE**2 * 5e4 * 1.6e-5 / SIZE, rel=1e-3)


def test_fibres_alone_resist_along_themselves() -> None:
    """Patch test: uniform strain is an equilibrium, its stress k (f . eps f) f f^T on top."""
    mesh = organ(fibres="along:1,1,0")
    only = Material(1.0, 0.0, 1060.0, 1e6)
    model, state = made("finite_element", mesh, EXACT, only)
    strain = 1e-3 * np.array([[3.0, 1.0, 0.5], [1.0, -2.0, 0.2], [0.5, 0.2, 1.0]])
    rows = all_rows(mesh)
    x = mesh.rest[rows]
    state.displacement[rows] = x @ strain
    forces = model.forces(state, rows)
    inside = ((x > 1e-9) & (x < SIZE - 1e-9)).all(axis=1)
    f = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    stress = 1e6 * (f @ strain @ f) * np.outer(f, f)
    size = np.abs(stress).max() * SIZE**2
    assert inside.any()
    assert np.abs(forces[inside]).max() < 1e-9 * size
    side = x[:, 0] > SIZE - 1e-9
    # sum_i f_i x_i^T over all nodes is minus the volume times the mean stress.
    virial = -forces.T @ x / SIZE**3
    np.testing.assert_allclose(virial, stress + strain, rtol=1e-5, atol=1e-5 * np.abs(stress).max())
    assert np.linalg.norm(forces[side].sum(axis=0)) > 0.1 * size


def test_elements_made_by_an_edit_keep_region_and_fibres() -> None:
    """An element put in the place of another has its region and its fibres."""
    mesh = organ()
    model, state = made("vertex_block_descent", mesh, DESCENT)
    element = int(np.flatnonzero(mesh.regions[: mesh.element_rows] > 0)[0])
    nodes = mesh.tets[element].astype(np.uint32)
    new = np.uint32(1 << 31)
    added = np.array([[new, *nodes[[1, 2, 3]]]], dtype=np.uint32)
    edit = TopologyEdit(
        mesh.version,
        copied_nodes=np.array([new]),
        copy_parents=nodes[:1],
        removed_elements=np.array([element], dtype=np.uint32),
        added_elements=np.array([new], dtype=np.uint32),
        added_nodes=added,
        added_parents=np.array([element], dtype=np.uint32),
    )
    apply(mesh, model, state, edit)
    row = mesh.element_rows - 1
    assert mesh.regions[row] == mesh.regions[element]
    assert (mesh.fibres[row] == mesh.fibres[element]).all()
    assert mesh.fibres[row].any()
    kind = model.springs.field.matter.kind
    assert kind[row] == kind[element] == 1


@pytest.mark.parametrize("name", ["finite_element", "vertex_block_descent"])
def test_a_cut_leaves_what_a_fresh_model_of_the_cut_mesh_has(name: str) -> None:
    mesh = organ()
    values = {"corotated": 1.0} if name == "finite_element" else DESCENT
    model, state = made(name, mesh, values)
    apply(mesh, model, state, split_edit(mesh, 0.02, above=0.01))
    fresh, _ = made(name, mesh, values)
    shake(mesh, state, 0.002)
    rows = all_rows(mesh)
    np.testing.assert_allclose(
        model.forces(state, rows), fresh.forces(state, rows), rtol=1e-9, atol=1e-9
    )
    np.testing.assert_array_equal(model.springs.masses[rows], fresh.springs.masses[rows])


def test_springs_and_masses_scale_with_the_region() -> None:
    mesh = organ()
    stiffer = Material(5e4, 0.45, 1060.0, 0.0, (RegionMaterial("scar", 1e5, 0.45, 2120.0),))
    plain, mixed = SpringNetwork(mesh, PLAIN), SpringNetwork(mesh, stiffer)
    assert mixed.rows == plain.rows
    z = mesh.rest[plain.springs.ends[: plain.rows], 2]
    ratio = mixed.springs.stiffness[: plain.rows] / plain.springs.stiffness[: plain.rows]
    assert ratio[(z < 0.019).all(axis=1)] == pytest.approx(1.0)
    assert ratio[(z > 0.041).all(axis=1)] == pytest.approx(2.0)
    assert ((ratio > 0.999) & (ratio < 2.001)).all()
    top = mesh.rest[: mesh.node_rows, 2] > 0.041
    heavier = mixed.masses[: mesh.node_rows] / plain.masses[: mesh.node_rows]
    assert heavier[top] == pytest.approx(2.0)


def test_a_homogeneous_material_is_the_same_bit_for_bit_with_regions_that_change_nothing() -> None:
    mesh = organ()
    same = Material(5e4, 0.45, 1060.0, 0.0, (RegionMaterial("scar", 5e4, 0.45, 1060.0),))
    for name in ("finite_element", "vertex_block_descent", "lr"):
        forces = []
        for material in (PLAIN, same):
            springs, state = SpringNetwork(mesh, material, np.float64), State(mesh, np.float64)
            model = registry.build(name, mesh, material, springs=springs)
            shake(mesh, state, 0.002)
            forces.append(model.forces(state, all_rows(mesh)))
        np.testing.assert_array_equal(forces[0], forces[1])


def test_descent_recovers_with_fibres_from_a_collapse() -> None:
    mesh = organ()
    model, state = made("vertex_block_descent", mesh, {**DESCENT, "rest_tolerance": 1e-9})
    rows = mesh.node_rows
    free = ~mesh.fixed[:rows]
    noise = np.random.default_rng(1).normal(scale=1e-6 * SIZE, size=(rows, 3))
    state.displacement[:rows][free] = (0.5 * SIZE - mesh.rest[:rows] + noise)[free]
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    solved(model, state, 3000)
    assert np.abs(state.displacement[:rows]).max() < 1e-3 * SIZE


@pytest.mark.parametrize(
    ("name", "values"), [("vertex_block_descent", {}), ("finite_element", {"corotated": 1.0})]
)
def test_stiff_fibres_come_back_from_a_drag_through_the_organ(
    name: str, values: dict[str, float]
) -> None:
    """Down through the fixed bottom at 1 m/s, fibres and regions of up to hundred times E."""
    mesh = organ(6)
    scar = RegionMaterial("scar", 1e6, 0.3, 1060.0, 5e6)
    material = Material(5e4, 0.45, 1060.0, 1e6, (scar,))
    pose = np.array([SIZE / 2, SIZE / 2, SIZE, 0.0, 0.0, 0.0, 1.0])
    tool = ToolSpec("grasper", "grab", "sphere", (0.014,), tuple(pose.tolist()))
    simulation = Simulation(
        mesh, Scene(name, parameters={name: values}, material=material, tools=(tool,))
    )
    budget, lost = Budget(steps=10), 0

    def command(kind: str) -> FrameInputs:
        return FrameInputs(commands=(Command(kind, {"tool": "grasper"}),))

    simulation.advance(command("grab"), budget)
    for _ in range(7):
        pose = pose - np.array([0.0, 0.0, 1.0 / 60.0, 0.0, 0.0, 0.0, 0.0])
        frame = simulation.advance(FrameInputs(tools=(ToolSample("grasper", pose),)), budget)
        lost += bool(frame.lost)
    rows = mesh.node_rows
    assert np.abs(simulation.state.displacement[:rows]).max() > 0.1
    simulation.advance(command("release"), budget)
    for _ in range(300):
        lost += bool(simulation.advance(FrameInputs(), budget).lost)
    assert lost == 0
    assert np.abs(simulation.state.displacement[:rows]).max() < 0.05 * 7.0 / 60.0


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (Material(fibre_stiffness=-1.0), "fibre_stiffness = -1 is out of range; allowed: 0 to"),
        (
            Material(regions=(RegionMaterial("scar", -5.0, 0.3, 1e3),)),
            "region scar: young_modulus = -5 is out of range",
        ),
        (
            Material(regions=(RegionMaterial("scar", 5e4, 0.5, 1e3),)),
            "region scar: poisson_ratio = 0.5 is out of range",
        ),
        (
            Material(regions=(RegionMaterial("valve", 5e4, 0.3, 1e3),)),
            "no region 'valve'; its regions: 0, scar",
        ),
    ],
)
def test_materials_that_make_no_sense_are_refused(material: Material, message: str) -> None:
    with pytest.raises(MaterialError, match=message):
        registry.build("vertex_block_descent", organ(), material)


def test_stiff_fibres_want_a_direction() -> None:
    with pytest.raises(MaterialError, match="has a direction of fibres; give `fibres`"):
        registry.build("finite_element", organ(fibres="none"), Material(fibre_stiffness=1e4))


def test_models_without_fibres_say_so() -> None:
    model = registry.build("lr", organ(), Material(fibre_stiffness=1e4))
    assert "has no fibres" in model.events[0]
    assert "vertex_block_descent" in model.events[0]
