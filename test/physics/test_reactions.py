"""Forces on what is held and fixed, of converged models: slopes of the energy, in balance.

Of the models that have forces only `lr` is not here: it converges to no minimum of an energy.
Where it is not elastic, relaxation puts nodes where springs keep their limits, whatever forces
that leaves in free nodes; these are what the forces on the hold then lack to a balance.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from support.elastic_scenes import MATERIAL, block_mesh, build, double, hold, top_ball
from support.spring_energy import spring_energy
from tissue_sim.elastic.model import Model, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.stiffness import lame_constants
from tissue_sim.elastic.vertex_block_descent import VertexBlockDescent
from tissue_sim.geometry.mesh import Mesh

MODELS: dict[str, tuple[str, dict[str, float]]] = {
    "finite_element": ("finite_element", {"tolerance": 1e-10, "rest_tolerance": 1e-13}),
    "corotated": (
        "finite_element",
        {"corotated": 1, "tolerance": 1e-10, "rest_tolerance": 1e-12},
    ),
    "spring_mass": ("spring_mass", {}),
    "vertex_block_descent": (
        "vertex_block_descent",
        {"levels": WHOLE_ORGAN, "rest_tolerance": 1e-12},
    ),
    "quasi_static": ("quasi_static", {"levels": WHOLE_ORGAN, "rest_tolerance": 1e-12}),
}


def energy_of(name: str, mesh: Mesh, model: Model, state: State, springs: SpringNetwork) -> float:
    if name in ("quasi_static", "spring_mass"):
        return spring_energy(springs, state.displacement)
    if name == "corotated":
        return corotated_energy(mesh, state.displacement)
    if name == "finite_element":
        rows = np.arange(mesh.node_rows, dtype=np.int32)
        return -0.5 * float((model.forces(state, rows) * state.displacement[rows]).sum())
    assert isinstance(model, VertexBlockDescent)
    return model.energy(state)


def corotated_energy(mesh: Mesh, u: np.ndarray) -> float:
    """Volume times mu |S - I|^2 + lam/2 tr(S - I)^2 with F = R S, by singular values."""
    lam, mu = lame_constants(MATERIAL)
    tets = mesh.tets[: mesh.element_rows]
    edges = mesh.rest[tets[:, 1:]] - mesh.rest[tets[:, :1]]
    x = mesh.rest + u
    F = np.linalg.solve(edges, x[tets[:, 1:]] - x[tets[:, :1]])
    assert (np.linalg.det(F) > 0).all()
    stretch = np.linalg.svd(F, compute_uv=False) - 1.0
    psi = mu * (stretch**2).sum(axis=1) + lam / 2 * stretch.sum(axis=1) ** 2
    return float((np.linalg.det(edges) / 6 * psi).sum())


@pytest.mark.parametrize("name", MODELS)
def test_the_force_on_a_hold_is_the_slope_of_the_energy_over_its_pose(name: str) -> None:
    mesh = block_mesh(5)
    springs, state = double(mesh)
    model_name, parameters = MODELS[name]
    model, _ = build(model_name, mesh, springs, state, **parameters)
    held = hold(model, state, top_ball(mesh, 0.022), mesh)
    rest = mesh.rest[held]
    centre = rest.mean(axis=0)
    turned = Rotation.from_rotvec([0.1, -0.05, 0.2]).apply(rest - centre)
    pose = turned + centre + [0.002, 0.0, 0.005]

    def settled(at: np.ndarray) -> float:
        state.displacement[held] = at - rest
        # A hold that is put elsewhere at once has no velocity.
        state.previous[held] = state.displacement[held]
        for _ in range(4000):
            model.step(state)
            if model.idle:
                break
        return energy_of(name, mesh, model, state, springs)

    h = 1e-6
    settled(pose)
    F = model.forces(state, held)
    # Along an axis, and a turn about another through the centre.
    motions = (np.broadcast_to([0.0, 0.6, 0.8], pose.shape), np.cross([1.0, 0.0, 0.0], turned))
    for motion in motions:
        slope = (settled(pose + h * motion) - settled(pose - h * motion)) / (2 * h)
        assert slope == pytest.approx(-(F * motion).sum(), rel=1e-3)
    settled(pose)
    forces = model.forces(state, np.flatnonzero(state.prescribed).astype(np.int32))
    points = (mesh.rest + state.displacement)[state.prescribed]
    assert np.abs(forces.sum(axis=0)).max() < 1e-4 * np.abs(forces).sum()
    # Linear elasticity takes its moments about the rest positions.
    arms = mesh.rest[state.prescribed] if name == "finite_element" else points
    moment = np.cross(arms, forces)
    assert np.abs(moment.sum(axis=0)).max() < 1e-4 * np.abs(moment).sum()
