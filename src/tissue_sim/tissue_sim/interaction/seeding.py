"""Seeded release: what a hold lets go of starts from rest, and the tissue around it partly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels import seeding
from tissue_sim.kernels.seeding import Queue, Tissue

Rows = NDArray[np.integer]

LARGEST_RADIUS = 1.0
"""Largest radius allowed [m]."""


class Seeding:
    """Puts released nodes to rest, and those around them the less the farther they are.

    Distances go along edges of the rest shape, so that they do not cross cuts, and around nodes
    that are fixed or held. With d the distance from released nodes and e that from nodes that stay
    held, the displacement is multiplied by s^2 (3 - 2 s) with s = d / min(radius, d + e): 0 at
    released nodes, 1 at the radius and at held nodes. Held and fixed nodes are not touched, nor is
    a piece of tissue without a fixed node: it has no place to return to.

    Its time is that of the nodes within the radius; for the first release after an edit, in
    addition, that of a way to a fixed node.
    """

    def __init__(self, mesh: Mesh, radius: float) -> None:
        """Make room.

        Args:
            mesh: The mesh.
            radius: Distance from released nodes at which all stays where it is [m]; 0: no seeding.

        Raises:
            ValueError: The radius is not allowed.
        """
        if not 0.0 <= radius <= LARGEST_RADIUS:
            raise ValueError(
                f"seeded_release = {radius:g} m is not allowed; allowed: 0 to {LARGEST_RADIUS:g} m"
            )
        self.mesh, self.radius = mesh, radius
        if radius > 0.0:
            self._allocate()

    def warm_up(self, springs: SpringNetwork) -> None:
        """Compile or load the kernels now rather than in the frame of the first release."""
        if self.radius == 0.0:
            return
        free = np.flatnonzero(self.mesh.node_alive & ~self.mesh.fixed)
        self.seed(State(self.mesh), free[:1], springs)

    def _allocate(self) -> None:
        capacity = self.mesh.node_capacity
        self._released, self._held = (
            Queue(
                np.full(capacity, np.inf), np.zeros(capacity, dtype=np.int32),
                np.full(capacity, -1, dtype=np.int32),
            )
            for _ in range(2)
        )  # fmt: skip
        self._anchored, self._version = np.zeros(capacity, dtype=np.int8), -1
        self._outside = np.ones(capacity, dtype=np.bool_)
        self._rows = np.zeros((4, capacity), dtype=np.int32)

    def seed(self, state: State, freed: Rows, springs: SpringNetwork) -> NDArray[np.int32]:
        """Seed the surroundings of nodes that were let go of. Modifies the state in place.

        Args:
            state: Displacements, and which nodes are fixed or held now.
            freed: Rows of the nodes; those held again or gone do not count.
            springs: The network of the mesh's edges.

        Returns:
            Rows of the nodes that may have been moved; a view, valid until the next call.
        """
        freed = freed[self.mesh.node_alive[freed] & ~state.prescribed[freed]]
        if self.radius == 0.0 or not len(freed):
            return np.empty(0, dtype=np.int32)
        if len(self._anchored) < self.mesh.node_capacity:
            self._allocate()
        arrays = springs.arrays
        tissue = Tissue(arrays.start, arrays.degree, arrays.neighbour, self.mesh.rest)
        return self._seed(state, freed.astype(np.int32), tissue)

    def _seed(self, state: State, freed: NDArray[np.int32], tissue: Tissue) -> NDArray[np.int32]:
        mesh, u = self.mesh, state.displacement
        near, met, near_held, outer = self._rows
        if self._version != mesh.version:
            self._anchored[:] = 0
            self._version = mesh.version
        count = seeding.anchored(
            freed, tissue, mesh.fixed, mesh.node_rows, self._released, self._anchored, near, met
        )
        found, walls = seeding.spread(
            met[:count].copy(), tissue, state.prescribed, self.radius, self._released, near, met
        )
        nodes, walls_met = near[:found], met[:walls]
        seeding.forget(walls_met, self._released)
        staying = seeding.pick_staying(walls_met, mesh.fixed, u)
        # Distances from what stays displaced, within what was found.
        self._outside[nodes] = False
        reached, beyond = seeding.spread(
            met[:staying], tissue, self._outside, self.radius, self._held, near_held, outer
        )
        self._outside[nodes] = True
        seeding.blend(nodes, self._released.key, self._held.key, self.radius, u, state.previous)
        seeding.forget(nodes, self._released)
        seeding.forget(near_held[:reached], self._held)
        seeding.forget(outer[:beyond], self._held)
        return nodes
