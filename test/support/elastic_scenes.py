"""Small organs, holds and cuts for tests of the elastic models, and plain twins of kernels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material, Model, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block, wall

MATERIAL = Material()
NO_ROWS = np.empty(0, dtype=np.int32)

VARIANTS: Mapping[str, tuple[str, Mapping[str, float]]] = {
    **{name: (name, {}) for name in registry.names()},
    "corotated": ("finite_element", {"corotated": 1.0}),
    "dynamic vertex_block_descent": ("vertex_block_descent", {"dynamic": 1.0}),
    "explicit Euler": ("spring_mass", {"integrator": 1.0, "damping": 0.2}),
    "Runge-Kutta 2": ("spring_mass", {"integrator": 2.0, "damping": 0.1}),
    "Runge-Kutta 4": ("spring_mass", {"integrator": 3.0}),
}
"""Every model with default parameters, and those that parameters make another method."""


def block_mesh(nodes: int = 7, fixed: bool = True, size: float = 0.06) -> Mesh:
    raw = block(nodes, nodes, nodes, size, size, size)
    return _mesh(raw, fixed)


def wall_mesh() -> Mesh:
    return _mesh(wall(), True)


def _mesh(raw: RawMesh, fixed: bool) -> Mesh:
    mask = np.zeros(len(raw.points), dtype=np.bool_)
    if fixed:
        mask[raw.node_sets["fixed"]] = True
    return Mesh(raw, mask)


def two_nodes(length: float = 0.01) -> tuple[Mesh, SpringNetwork]:
    """A tetrahedron of which only the spring between nodes 0 and 1 is of interest."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 0.5, 1]]) * length
    mesh = Mesh(RawMesh(points, np.array([[0, 1, 2, 3]])))
    return mesh, SpringNetwork(mesh, MATERIAL, np.float64)


def double(mesh: Mesh) -> tuple[SpringNetwork, State]:
    return SpringNetwork(mesh, MATERIAL, np.float64), State(mesh, np.float64)


def build(
    name: str,
    mesh: Mesh,
    springs: SpringNetwork | None = None,
    state: State | None = None,
    **parameters: float,
) -> tuple[Model, State]:
    """A model that has been told that nothing is held, and a state at rest."""
    model = registry.build(name, mesh, MATERIAL, parameters, springs)
    if state is None:
        state = State(mesh)
    model.prescribed_changed(state, NO_ROWS)
    return model, state


def hold(model: Model, state: State, rows: Iterable[int], mesh: Mesh) -> NDArray[np.int32]:
    held = np.array(sorted(rows), dtype=np.int32)
    state.prescribed[:] = mesh.fixed
    state.prescribed[held] = True
    model.prescribed_changed(state, held)
    return held


def release(model: Model, state: State, mesh: Mesh) -> None:
    hold(model, state, [], mesh)


def ball(mesh: Mesh, centre: NDArray[np.float64], radius: float) -> NDArray[np.int32]:
    rows = mesh.node_rows
    near = np.linalg.norm(mesh.rest[:rows] - centre, axis=1) <= radius
    return np.flatnonzero(near & ~mesh.fixed[:rows]).astype(np.int32)


def top_ball(mesh: Mesh, radius: float = 0.012) -> NDArray[np.int32]:
    points = mesh.rest[: mesh.node_rows]
    middle = points.mean(axis=0)
    return ball(mesh, np.array([middle[0], middle[1], points[:, 2].max()]), radius)


def steps(model: Model, state: State, count: int) -> None:
    for _ in range(count):
        model.step(state)


def settle(model: Model, state: State, most: int = 40) -> None:
    """Step until nothing moves by more than a nanometre in a hundred steps, or idles."""
    for _ in range(most):
        before = state.displacement.copy()
        for _ in range(100):
            model.step(state)
            if model.idle:
                return
        if np.abs(state.displacement - before).max() < 1e-9:
            return


def split_edit(mesh: Mesh, x: float, above: float = -np.inf) -> TopologyEdit:
    """Split a grid along its plane of nodes at x, for nodes higher than `above`."""
    rows, alive = mesh.node_rows, mesh.element_alive[: mesh.element_rows]
    points = mesh.rest[:rows]
    near = np.abs(points[:, 0] - x) < 1e-9
    parents = np.flatnonzero(near & (points[:, 2] > above) & mesh.node_alive[:rows])
    tets = mesh.tets[: mesh.element_rows]
    behind = alive & (points[tets][:, :, 0].mean(axis=1) > x)
    rewritten = np.flatnonzero(behind & np.isin(tets, parents).any(axis=1))
    place = np.full(rows, -1)
    place[parents] = np.arange(len(parents))
    nodes = tets[rewritten].astype(np.int64)
    nodes = np.where(place[nodes] >= 0, PROVISIONAL + place[nodes], nodes)
    return TopologyEdit(
        base_version=mesh.version,
        copied_nodes=(PROVISIONAL + np.arange(len(parents))).astype(np.uint32),
        copy_parents=parents.astype(np.uint32),
        rewritten_elements=rewritten.astype(np.uint32),
        rewritten_nodes=nodes.astype(np.uint32),
    )


def apply(mesh: Mesh, model: Model, state: State, edit: TopologyEdit) -> None:
    change = mesh.apply(edit)
    state.follow(mesh, change)
    model.topology_changed(change, state)


def plain_force(springs: SpringNetwork, u: NDArray[np.float64], node: int) -> NDArray[np.float64]:
    """Force on a node by the textbook formula k (l - l0) e / l."""
    x = springs.mesh.rest + u
    F = np.zeros(3)
    for row in np.flatnonzero(springs.springs.alive[: springs.rows]):
        a, b = springs.springs.ends[row]
        if node in (a, b):
            other = b if node == a else a
            e = x[other] - x[node]
            l0 = np.linalg.norm(springs.mesh.rest[other] - springs.mesh.rest[node])
            length = np.linalg.norm(e)
            F += springs.springs.stiffness[row] * (length - l0) * e / length
    return F


def plain_forces(springs: SpringNetwork, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Forces on all nodes by the textbook formula."""
    used = springs.springs.alive[: springs.rows]
    ends = springs.springs.ends[: springs.rows][used]
    rest, x = springs.mesh.rest, springs.mesh.rest + u
    e = x[ends[:, 1]] - x[ends[:, 0]]
    l0 = np.linalg.norm(rest[ends[:, 1]] - rest[ends[:, 0]], axis=1)
    length = np.linalg.norm(e, axis=1)
    pull = springs.springs.stiffness[: springs.rows][used] * (length - l0) / length
    F = np.zeros_like(u)
    np.add.at(F, ends[:, 0], pull[:, None] * e)
    np.add.at(F, ends[:, 1], -pull[:, None] * e)
    return F
