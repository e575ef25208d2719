"""Springs with the constants of the thesis: one for all, or one for each category."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Material
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import CATEGORIES


@dataclass(frozen=True)
class SpringConstants:
    """Stiffness of springs that does not follow from the material.

    Attributes:
        stiffness: Of every spring [N/m].
        per_element: 1: as many springs lie along an edge as there are elements at it, as the thesis
            probably had them (THESIS.md, section 6); 0: one.
        connecting: What multiplies it for the springs between the two surfaces.
        bending, angular: The same for springs that keep curvature.
        node_mass: Mass of every node [kg]; 0: that of the material.
    """

    stiffness: float = 1.0
    per_element: float = 0.0
    connecting: float = 1.0
    bending: float = 1.0
    angular: float = 1.0
    node_mass: float = 0.0

    @classmethod
    def names(cls) -> list[str]:
        """Names of the constants."""
        return [entry.name for entry in fields(cls)]

    def checked(self) -> SpringConstants:
        """These constants, if they are in range.

        Raises:
            ValueError: One is not.
        """
        for name in self.names():
            value = getattr(self, name)
            low = 0.0 if name in ("per_element", "node_mass") else 1e-9
            if not np.isfinite(value) or not low <= value <= 1e9:
                raise ValueError(
                    f"springs.{name} = {value:g} is out of range; allowed: {low:g} to 1e+09"
                )
        if self.per_element not in (0.0, 1.0):
            raise ValueError(f"springs.per_element = {self.per_element:g}; allowed: 0 or 1")
        return self

    def network(
        self, mesh: Mesh, material: Material, dtype: type[np.floating] = np.float32
    ) -> SpringNetwork:
        """A network of a mesh with these constants; edits would give springs the material's."""
        network = SpringNetwork(mesh, material, dtype)
        network.set_stiffness(self._stiffness(network))
        if self.node_mass:
            network.masses[: mesh.node_rows] = self.node_mass
        return network

    def _stiffness(self, network: SpringNetwork) -> NDArray[np.float64]:
        rows = network.rows
        stiffness = np.full(rows, self.stiffness)
        if len(network.categories):
            factors = np.array([getattr(self, name, 1.0) for name in CATEGORIES])
            stiffness *= factors[network.categories[:rows]]
        if self.per_element:
            stiffness *= elements_at_springs(network)
        return stiffness


def elements_at_springs(network: SpringNetwork) -> NDArray[np.int64]:
    """Number of elements at each spring's edge, shape (rows,); 1 for springs of their own."""
    mesh = network.mesh
    living = mesh.element_alive[: mesh.element_rows]
    corners = mesh.tets[: mesh.element_rows][living].astype(np.int64)
    keys = []
    for first in range(4):
        for second in range(first + 1, 4):
            a, b = corners[:, first], corners[:, second]
            there = (a >= 0) & (b >= 0)
            keys.append((np.minimum(a, b) << 32 | np.maximum(a, b))[there])
    edges, counts = np.unique(np.concatenate(keys), return_counts=True)
    ends = np.sort(network.springs.ends[: network.rows].astype(np.int64), axis=1)
    wanted = ends[:, 0] << 32 | ends[:, 1]
    place = np.searchsorted(edges, wanted).clip(max=len(edges) - 1)
    found: NDArray[np.int64] = np.where(edges[place] == wanted, counts[place], 1)
    return found
