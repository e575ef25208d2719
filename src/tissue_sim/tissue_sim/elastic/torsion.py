"""Torsion springs of a sheet: they keep the angles between its triangles, and so its curvature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Material
from tissue_sim.geometry.curvature_springs import hinges as hinge_nodes
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import triangle_normals
from tissue_sim.kernels.springs import TINY
from tissue_sim.kernels.torsion import LEAST_AREA, THRESHOLD, Hinges, measure_angles

RESERVE = 4.0
"""Growth of the squared slope of an angle up to which explicit integration is stable: triangles
may lose half of their height."""


class TorsionSprings:
    """One torsion spring per edge between two triangles, of the stiffness of a bent plate.

    A plate of thickness h has the flexural rigidity D = E h^3 / (12 (1 - nu^2)); the spring at an
    edge of length l between triangles of areas A and B gets k = factor D l^2 / (A + B) [N m/rad],
    which on equilateral triangles is exactly such a plate bent along a cylinder.

    Attributes:
        nodes: Edge and opposite nodes of each, shape (h, 4).
        stiffness: k [N m/rad], float64, shape (h,).
        arrays: What kernels read.
    """

    def __init__(
        self, mesh: Mesh, material: Material, factor: float, dtype: type[np.floating]
    ) -> None:
        """Measure the mesh at rest."""
        if mesh.sheet is None:
            raise ValueError(f"{mesh.name} has no triangles to keep the angles of")
        rows = mesh.node_rows
        rest = mesh.rest[:rows]
        self.nodes = hinge_nodes(mesh.sheet.triangles)
        a, b, c, d = self.nodes.T
        self._normals = [
            triangle_normals(rest, np.stack(corners, axis=1)) for corners in ((a, b, c), (b, a, d))
        ]
        doubled = [np.linalg.norm(normals, axis=1) for normals in self._normals]
        h = _hinge_thickness(mesh, self.nodes)
        rigidity = material.young_modulus * h**3 / (12.0 * (1.0 - material.poisson_ratio**2))
        squared = ((rest[b] - rest[a]) ** 2).sum(axis=1)
        self.stiffness = factor * rigidity * squared / (0.5 * (doubled[0] + doubled[1]))
        self._rest = rest
        self.last_move = np.zeros((mesh.node_capacity, 3), dtype=dtype)
        self.arrays = self._arrays(mesh.node_capacity, np.stack(doubled, axis=1), dtype)

    @classmethod
    def of(cls, mesh: Mesh, material: Material, dtype: type[np.floating]) -> TorsionSprings | None:
        """The torsion springs of a mesh; None where there are none."""
        if mesh.sheet is None or not mesh.sheet.stiffness.torsion:
            return None
        return cls(mesh, material, mesh.sheet.stiffness.torsion, dtype)

    def _arrays(
        self, capacity: int, doubled: NDArray[np.float64], dtype: type[np.floating]
    ) -> Hinges:
        at = self.nodes.ravel()
        order = np.argsort(at, kind="stable")
        counts = np.bincount(at, minlength=capacity)
        start = np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32)
        return Hinges(
            start, order.astype(np.uint32), self.nodes, self.stiffness.astype(dtype),
            np.zeros(len(self.nodes), dtype=dtype), ((LEAST_AREA * doubled) ** 2).astype(dtype),
            dtype(THRESHOLD[dtype]),
        )  # fmt: skip

    def measure(self, rest: NDArray[np.floating]) -> None:
        """Take the angles at rest from the positions that kernels read, shape (capacity, 3)."""
        none, tiny = np.zeros_like(rest), rest.dtype.type(TINY[rest.dtype.type])
        measure_angles(rest, none, self.nodes, tiny, self.arrays.angle)

    def gradients(self) -> NDArray[np.float64]:
        """Slopes of the angles at rest [rad/m], shape (h, 4, 3)."""
        a, b, c, d = self.nodes.T
        rest = self._rest
        edge = rest[b] - rest[a]
        squared = (edge**2).sum(axis=1)
        to_c, to_d = (
            -np.sqrt(squared)[:, None] * n / (n**2).sum(axis=1)[:, None] for n in self._normals
        )
        p = (np.einsum("ij,ij->i", rest[c] - rest[a], edge) / squared)[:, None]
        q = (np.einsum("ij,ij->i", rest[d] - rest[a], edge) / squared)[:, None]
        return np.stack(
            [-(1 - p) * to_c - (1 - q) * to_d, -p * to_c - q * to_d, to_c, to_d], axis=1
        )

    def node_stiffness(self, nodes: NDArray[np.int32]) -> NDArray[np.float64]:
        """Half a bound of the row sums of their tangent stiffness [N/m], shape (len(nodes),)."""
        slopes = np.linalg.norm(self.gradients(), axis=2)
        rows = self.stiffness[:, None] * slopes * slopes.sum(axis=1)[:, None]
        sums = np.bincount(self.nodes.ravel(), weights=rows.ravel(), minlength=len(self.last_move))
        return np.asarray(0.5 * RESERVE * sums[nodes])


def _hinge_thickness(mesh: Mesh, nodes: NDArray[np.int32]) -> NDArray[np.float64]:
    """Mean thickness of the sheet at the edge of each torsion spring [m], shape (h,)."""
    sheet = mesh.sheet
    if sheet is None:
        return np.zeros(len(nodes))
    corners = sheet.triangles.ravel()
    counts = np.maximum(np.bincount(corners, minlength=mesh.node_rows), 1)
    sums = np.bincount(corners, weights=np.repeat(sheet.thickness, 3), minlength=mesh.node_rows)
    return np.asarray((sums / counts)[nodes[:, :2]].mean(axis=1))
