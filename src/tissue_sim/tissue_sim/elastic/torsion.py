"""Torsion springs of a sheet: they keep the angles between its triangles, and so its curvature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.material_field import MaterialField
from tissue_sim.elastic.model import Material
from tissue_sim.geometry.curvature_springs import hinges_and_triangles
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.incidence import Incidence, among, sorted_unique
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import triangle_normals
from tissue_sim.kernels.springs import TINY
from tissue_sim.kernels.torsion import LEAST_AREA, THRESHOLD, Hinges, measure_angles

RESERVE = 4.0
"""Growth of the squared slope of an angle up to which explicit integration is stable: triangles
may lose half of their height."""

Rows = NDArray[np.int32]


class TorsionSprings:
    """One torsion spring per edge between two triangles, of the stiffness of a bent plate.

    A plate of thickness h has the flexural rigidity D = E h^3 / (12 (1 - nu^2)); the spring at an
    edge of length l between triangles of areas A and B gets k = factor D l^2 / (A + B) [N m/rad],
    which on equilateral triangles is exactly such a plate bent along a cylinder. h is the mean of
    the two triangles'.

    An edit takes the springs away between triangles that come apart, in time proportional to it;
    their rows stay, without stiffness, until a later edit makes others.

    Attributes:
        nodes: Edge and opposite nodes of each, all 0 where there is none, shape (h, 4).
        stiffness: k [N m/rad], float64, shape (h,).
        last_move: What a sweep without momentum moves nodes by [m], shape (node_capacity, 3).
        arrays: What kernels read; edits replace it.
    """

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        factor: float,
        dtype: type[np.floating],
        field: MaterialField | None = None,
    ) -> None:
        """Measure the mesh at rest; the material of each triangle is that of `field`."""
        if mesh.sheet is None:
            raise ValueError(f"{mesh.name} has no triangles to keep the angles of")
        self._mesh, self._dtype = mesh, dtype
        self._field = field if field is not None else MaterialField(mesh, material)
        self._rigidity = factor * material.young_modulus / (12.0 * (1 - material.poisson_ratio**2))
        self.last_move = np.zeros((mesh.node_capacity, 3), dtype=dtype)
        solid = np.flatnonzero(mesh.element_alive[: mesh.element_rows]).astype(np.int32)
        self.nodes, stiffness, doubled = self._measured(self._solid(solid))
        there = np.ones(len(self.nodes), dtype=np.bool_)
        self._lists = Incidence.build(self.nodes, there, mesh.node_capacity)
        self.stiffness = stiffness
        self._least = (LEAST_AREA * doubled) ** 2
        self._angles = np.zeros(len(self.nodes), dtype=dtype)
        self._free = np.empty(0, dtype=np.int32)
        self._expose()

    @classmethod
    def of(
        cls,
        mesh: Mesh,
        material: Material,
        dtype: type[np.floating],
        field: MaterialField | None = None,
    ) -> TorsionSprings | None:
        """The torsion springs of a mesh; None where there are none."""
        if mesh.sheet is None or not mesh.sheet.stiffness.torsion:
            return None
        return cls(mesh, material, mesh.sheet.stiffness.torsion, dtype, field)

    def _solid(self, elements: Rows) -> Rows:
        """Those of some elements that are triangles of tissue."""
        rows = self._mesh.sheet_rows
        return elements if rows is None else elements[rows.carries(elements)]

    def _measured(self, triangles: Rows) -> tuple[Rows, NDArray[np.float64], NDArray[np.float64]]:
        """Nodes, stiffness, and twice the areas at each side of the springs among triangles."""
        mesh, rest = self._mesh, self._mesh.rest
        nodes, pair = hinges_and_triangles(mesh.tets[triangles, :3])
        tissue = np.zeros(0) if mesh.sheet_rows is None else mesh.sheet_rows.tissue
        thickness = tissue[triangles[pair]].mean(axis=1)
        doubled = np.stack([np.linalg.norm(n, axis=1) for n in _normals(rest, nodes)], axis=1)
        squared = ((rest[nodes[:, 1]] - rest[nodes[:, 0]]) ** 2).sum(axis=1)
        # Patches have an edge of their own: both triangles are of one material.
        rigidity = self._rigidity * self._field.stiffness_of(triangles[pair[:, 0]])
        stiffness = rigidity * thickness**3 * squared / (0.5 * doubled.sum(axis=1))
        return nodes, stiffness, doubled

    def _expose(self) -> None:
        lists, dtype = self._lists, self._dtype
        self.arrays = Hinges(
            lists.start, lists.count, lists.data, self.nodes, self.stiffness.astype(dtype),
            self._angles, self._least.astype(dtype), dtype(THRESHOLD[dtype]),
        )  # fmt: skip

    def measure(self, rest: NDArray[np.floating]) -> None:
        """Take the angles at rest from the positions that kernels read, shape (capacity, 3)."""
        self._measure_at(np.arange(len(self.nodes)), rest)

    def _measure_at(self, rows: NDArray[np.integer], rest: NDArray[np.floating]) -> None:
        tiny = rest.dtype.type(TINY[rest.dtype.type])
        angles = np.zeros(len(rows), dtype=self._dtype)
        measure_angles(rest, np.zeros_like(rest), self.nodes[rows], tiny, angles)
        self._angles[rows] = angles

    def follow(self, change: EditChange, rest: NDArray[np.floating]) -> None:
        """Follow an edit that the mesh has applied.

        Modifies the springs in place.

        Args:
            change: What the edit did.
            rest: Rest positions after it that kernels read [m], shape (node_capacity, 3).
        """
        mesh, among_nodes = self._mesh, change.nodes
        self._lists.grow(mesh.node_capacity)
        extra = mesh.node_capacity - len(self.last_move)
        if extra > 0:
            more = np.zeros((extra, 3), dtype=self._dtype)
            self.last_move = np.concatenate([self.last_move, more])
        old = self._within(self._lists.of_all(among_nodes), self.nodes, among_nodes)
        near = self._solid(mesh.incident.of_all(among_nodes))
        nodes, stiffness, doubled = self._measured(near)
        inside = np.flatnonzero(self._inside(nodes, among_nodes))
        rows = self._replace(old, nodes[inside])
        self.stiffness[rows] = stiffness[inside]
        self._least[rows] = (LEAST_AREA * doubled[inside]) ** 2
        self._measure_at(rows, rest)
        self._expose()

    @staticmethod
    def _inside(nodes: Rows, some: Rows) -> NDArray[np.bool_]:
        """Whether both ends of the edges of springs are among some nodes."""
        return among(nodes[:, 0], some) & among(nodes[:, 1], some)

    def _within(self, rows: Rows, nodes: Rows, some: Rows) -> Rows:
        return rows[self._inside(nodes[rows], some)]

    def _replace(self, old: Rows, nodes: Rows) -> Rows:
        """Put springs in the place of old ones; rows of the new ones, shape (len(nodes),).

        Those that are the same keep their rows, others get free ones.
        """
        keys = {
            tuple(quad): int(row) for row, quad in zip(old, self.nodes[old].tolist(), strict=True)
        }
        kept = np.array([keys.pop(tuple(quad), -1) for quad in nodes.tolist()], dtype=np.int32)
        gone = np.array(sorted(keys.values()), dtype=np.int32)
        new = np.flatnonzero(kept < 0)
        free = sorted_unique(np.concatenate([self._free, gone]))
        self._make_rows(len(new) - len(free))
        more = np.arange(len(self.nodes) - max(len(new) - len(free), 0), len(self.nodes))
        free = np.concatenate([free, more.astype(np.int32)])
        kept[new], self._free = free[: len(new)], free[len(new) :]
        self._rewire(gone, np.full((len(gone), 4), -1, dtype=np.int32))
        self.nodes[gone], self.stiffness[gone] = 0, 0.0
        self._rewire(kept[new], nodes[new])
        self.nodes[kept[new]] = nodes[new]
        return kept

    def _rewire(self, rows: Rows, nodes: Rows) -> None:
        there = self.stiffness[rows] > 0.0
        old = np.where(there[:, None], self.nodes[rows], -1).astype(np.int32)
        self._lists.rewire(rows, old, nodes)

    def _make_rows(self, extra: int) -> None:
        if extra > 0:
            self.nodes = np.concatenate([self.nodes, np.zeros((extra, 4), dtype=np.int32)])
            self.stiffness = np.concatenate([self.stiffness, np.zeros(extra)])
            self._least = np.concatenate([self._least, np.zeros((extra, 2))])
            self._angles = np.concatenate([self._angles, np.zeros(extra, dtype=self._dtype)])

    def gradients(self, rows: Rows | None = None) -> NDArray[np.float64]:
        """Slopes of the angles at rest [rad/m] of all springs or some, shape (h, 4, 3)."""
        nodes = self.nodes if rows is None else self.nodes[rows]
        a, b, c, d = nodes.T
        rest = self._mesh.rest
        edge = rest[b] - rest[a]
        squared = (edge**2).sum(axis=1)
        # Rows without a spring: nothing over something.
        squared[squared == 0.0] = 1.0
        to_c, to_d = (
            -np.sqrt(squared)[:, None] * n / np.maximum((n**2).sum(axis=1), 1e-300)[:, None]
            for n in _normals(rest, nodes)
        )
        p = (np.einsum("ij,ij->i", rest[c] - rest[a], edge) / squared)[:, None]
        q = (np.einsum("ij,ij->i", rest[d] - rest[a], edge) / squared)[:, None]
        return np.stack(
            [-(1 - p) * to_c - (1 - q) * to_d, -p * to_c - q * to_d, to_c, to_d], axis=1
        )

    def node_stiffness(self, nodes: NDArray[np.int32]) -> NDArray[np.float64]:
        """Half a bound of the row sums of their tangent stiffness [N/m], shape (len(nodes),)."""
        at = self._lists.of_all(np.asarray(nodes, dtype=np.int32))
        slopes = np.linalg.norm(self.gradients(at), axis=2)
        rows = self.stiffness[at, None] * slopes * slopes.sum(axis=1)[:, None]
        corners = self.nodes[at].ravel()
        sums = np.bincount(corners, weights=rows.ravel(), minlength=len(self.last_move))
        return np.asarray(0.5 * RESERVE * sums[nodes])


def _normals(
    rest: NDArray[np.float64], nodes: Rows
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normals of the two triangles at each edge, as long as twice their area [m^2]."""
    a, b, c, d = nodes.T
    one, other = (np.stack(corners, axis=1) for corners in ((a, b, c), (b, a, d)))
    return triangle_normals(rest, one), triangle_normals(rest, other)
