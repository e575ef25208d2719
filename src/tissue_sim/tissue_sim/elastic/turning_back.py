"""Elements that a tool has left inside out are turned back."""

from __future__ import annotations

import numpy as np

from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.kernels.inverted import free_nodes_of_inverted
from tissue_sim.kernels.unflipping import unflip_nodes

WITHIN = 64
"""Steps within which every element is looked at once."""


class TurningBack:
    """Nodes of inverted elements are put where their neighbours' mean displacement puts them.

    Springs know no inside: an element pushed through itself finds a second equilibrium there and
    stays. The elements are looked at in turn, a share of them in each step.
    """

    def __init__(self, springs: SpringNetwork) -> None:
        self._springs, self._part = springs, 0
        self._nodes = np.zeros(0, dtype=np.uint32)
        self._unused = np.zeros_like(springs.arrays.rest)

    def look(self, state: State) -> int:
        """Turn back what is inside out in the next part of the mesh, and let it rest there.

        Modifies the state in place.

        Returns:
            Number of nodes put back.
        """
        springs, mesh = self._springs, self._springs.mesh
        most = mesh.element_rows // WITHIN + 1
        if len(self._nodes) < 4 * most:
            self._nodes = np.zeros(8 * most, dtype=np.uint32)
        begin = self._part * most
        self._part = (self._part + 1) % WITHIN
        count = free_nodes_of_inverted(
            begin, min(begin + most, mesh.element_rows), mesh.tets, mesh.element_alive,
            springs.arrays.rest, state.displacement, state.prescribed, self._nodes,
        )  # fmt: skip
        if not count:
            return 0
        if len(self._unused) != len(state.displacement):
            self._unused = np.zeros_like(state.displacement)
        put_back = unflip_nodes(
            self._nodes, 0, count, mesh.rest, springs.elements, springs.arrays,
            state.displacement, self._unused,
        )  # fmt: skip
        nodes = self._nodes[:count]
        state.previous[nodes] = state.displacement[nodes]
        return int(put_back)
