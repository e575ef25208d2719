"""What every simulator is given: a mesh, a material, a pull, and where the tissue should end."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import spsolve

from tissue_sim.elastic.model import Material
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.mesh import Mesh

BLOCK = {"nodes_x": 15, "nodes_y": 14, "nodes_z": 15}
"""Nodes along the sides of the block."""

BLOCK_HOLD = 0.0125
"""Radius of what is held in the middle of the block's top [m]."""


class Simulator(Protocol):
    """A simulator that holds the tissue at rest; `step` is one of its own time steps or sweeps."""

    def pull(self) -> None:
        """Put the held nodes where they are pulled to, at once."""

    def step(self) -> None:
        """Do one step."""

    def displacement(self) -> NDArray[np.floating]:
        """Displacements of all nodes from rest [m], shape (node_count, 3)."""


@dataclass(frozen=True)
class Task:
    """A tissue that is fixed at some nodes and pulled at others.

    Attributes:
        geometry: Name of the geometry.
        mesh: Its mesh.
        held: Rows of the nodes held, sorted.
        vector: Where they are pulled to, from rest [m], shape (3,).
        material: What it is made of.
    """

    geometry: str
    mesh: Mesh
    held: NDArray[np.int32]
    vector: NDArray[np.float64]
    material: Material

    @property
    def points(self) -> NDArray[np.float64]:
        """Rest positions [m], shape (node_count, 3)."""
        return self.mesh.rest[: self.mesh.node_rows]

    @cached_property
    def tets(self) -> NDArray[np.int64]:
        """Right-handed corners of the elements, shape (element_count, 4)."""
        rows = self.mesh.element_rows
        return self.mesh.tets[:rows][self.mesh.element_alive[:rows]].astype(np.int64)

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """Which nodes never move, shape (node_count,)."""
        return self.mesh.fixed[: self.mesh.node_rows]

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """Which nodes are neither fixed nor held, shape (node_count,)."""
        free = ~self.fixed
        free[self.held] = False
        return free

    @property
    def lame(self) -> tuple[float, float]:
        """Lame's constants lambda and mu [Pa]."""
        E, nu = self.material.young_modulus, self.material.poisson_ratio
        return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))

    @cached_property
    def masses(self) -> NDArray[np.float64]:
        """A quarter of each element's mass for each of its corners [kg], shape (node_count,)."""
        share = self.material.density * _volumes(self.points, self.tets) / 4
        masses = np.zeros(len(self.points))
        np.add.at(masses, self.tets, share[:, None])
        return masses

    @cached_property
    def exact(self) -> NDArray[np.float64]:
        """Equilibrium of linear elasticity, solved for directly [m], shape (node_count, 3)."""
        solution = np.zeros((len(self.points), 3))
        solution[self.held] = self.vector
        matrix = stiffness(self.points, self.tets, self.lame)
        unknown = np.repeat(self.free, 3)
        load = -(matrix @ solution.ravel())[unknown]
        solution[self.free] = spsolve(matrix[unknown][:, unknown].tocsc(), load).reshape(-1, 3)
        return solution

    def error(self, displacement: NDArray[np.floating]) -> float:
        """Norm of what free nodes are off by, over the norm of their exact displacement."""
        return _norm((displacement - self.exact)[self.free]) / _norm(self.exact[self.free])

    def largest_error(self, displacement: NDArray[np.floating]) -> float:
        """Largest distance that a free node is off by, over the length of the pull."""
        off = np.linalg.norm((displacement - self.exact)[self.free], axis=1)
        return float(off.max()) / _norm(self.vector)


def task_of(geometry: str, material: Material | None = None) -> Task:
    """The wall, its free side pulled 1 mm out of its plane, or the block, its top pulled 0.6 mm up.

    A hundredth of their size: small enough for all laws of elasticity to agree.

    Args:
        geometry: "wall" or "block".
        material: What it is made of; default as everywhere.
    """
    scene = scene_geometry.load(geometry, parameters=BLOCK if geometry == "block" else None)
    if geometry == "block":
        held, vector = scene.raw.node_sets["top"], np.array([0.0, 0.0, 0.0006])
        points = scene.mesh.rest[held]
        near = np.linalg.norm(points - points.mean(axis=0), axis=1) <= BLOCK_HOLD
        held = held[near]
    else:
        held, vector = scene.raw.node_sets["hold"], np.array([0.0, 0.0, 0.001])
    rows = np.sort(held).astype(np.int32)
    return Task(geometry, scene.mesh, rows, vector, material or Material())


def stiffness(
    points: NDArray[np.float64], tets: NDArray[np.int64], lame: tuple[float, float]
) -> csr_matrix:
    """Stiffness matrix of linear tetrahedra [N/m], shape (3 node_count, 3 node_count).

    Block (a, b) of an element is V (lam g_a g_b^T + mu g_b g_a^T + mu g_a.g_b I), g_a the gradient
    of a corner's shape function.
    """
    lam, mu = lame
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    # Rows of the inverse transposed are the gradients of corners 1 to 3; all four sum to zero.
    inner = np.linalg.inv(edges).transpose(0, 2, 1)
    g = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    outer = np.einsum("eai,ebj->eabij", g, g)
    blocks = lam * outer + mu * outer.transpose(0, 1, 2, 4, 3)
    blocks += mu * np.einsum("eabii->eab", outer)[..., None, None] * np.eye(3)
    blocks *= _volumes(points, tets)[:, None, None, None, None]
    rows = 3 * tets[:, :, None, None, None] + np.arange(3)[:, None]
    columns = 3 * tets[:, None, :, None, None] + np.arange(3)
    shape = blocks.shape
    index = (np.broadcast_to(rows, shape).ravel(), np.broadcast_to(columns, shape).ravel())
    size = 3 * len(points)
    return coo_matrix((blocks.ravel(), index), shape=(size, size)).tocsr()


def _volumes(points: NDArray[np.float64], tets: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]]) / 6


def _norm(array: NDArray[np.floating]) -> float:
    return float(np.linalg.norm(array))
