"""The springs of a network laid out for loops over all nodes at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.kernels.slices import Places, Slices, add_slices
from tissue_sim.kernels.vectors import LANES, ROW

ALIKE = 256
"""Rows of nodes among which those with equally many springs are put into the same slices."""


class SlicedSprings:
    """Springs by slices of eight nodes, and the nodes as vectors read them.

    Nodes whose springs an edit changes get new slices behind the others; where they were before
    nobody is now.

    Attributes:
        slices: The springs.
        places: The nodes; displacements and forces are for kernels to fill in.
        count: Slices in use.
    """

    def __init__(self, springs: SpringNetwork) -> None:
        """Lay out all springs of a network."""
        self._springs = springs
        self._lay_out()

    def _lay_out(self) -> None:
        springs = self._springs
        self.count = self._used = 0
        capacity, dtype = springs.mesh.node_capacity, springs.dtype
        slots = (capacity + capacity // 4) // LANES * LANES + 64 * LANES
        entries = int(springs.arrays.degree.sum(dtype=np.int64)) * 5 // 4 // LANES * LANES + 32768
        self.slices = Slices(
            np.full(slots, capacity, dtype=np.uint32), np.full(slots // LANES, 0, dtype=np.int64),
            np.full(slots // LANES, 0, dtype=np.int64), np.full(capacity + 1, -1, dtype=np.int32),
            np.full(entries, 0, dtype=np.uint32), np.full(entries, 0, dtype=dtype),
            np.full(entries, 0, dtype=dtype),
        )  # fmt: skip
        self.places = Places(
            *(np.full((capacity + 1, ROW), 0, dtype=dtype) for _ in Places._fields)
        )
        self._add(np.arange(springs.mesh.node_rows, dtype=np.int32))

    def _add(self, nodes: NDArray[np.int32]) -> None:
        """Give nodes new slices, those with most springs of every few hundred rows first."""
        degree = self._springs.arrays.degree[nodes].astype(np.int64)
        order = nodes[np.lexsort((nodes, -degree, nodes // ALIKE))]
        done = 0
        while done < len(order):
            done, self.count, self._used = add_slices(
                order, done, self._springs.arrays, self.count, self._used, self.slices, self.places
            )
            if done < len(order):
                self._make_room()

    def follow(self, nodes: NDArray[np.int32]) -> None:
        """Follow an edit that the network has followed, in time proportional to it.

        Args:
            nodes: Rows of the nodes whose springs or rest positions changed.
        """
        capacity = self._springs.mesh.node_capacity
        if capacity >= len(self.slices.slot):
            # Another row is nobody's now: everything is laid out anew, which is as rare as growth.
            self._lay_out()
            return
        self._add(nodes)

    def _make_room(self) -> None:
        slots = len(self.slices.nodes) // 4 // LANES * LANES + 64 * LANES
        entries = len(self.slices.neighbour) // 4 // LANES * LANES + 32768
        nodes, start, width, slot, neighbour, stiffness, length = self.slices
        self.slices = Slices(
            _longer(nodes, slots), _longer(start, slots // LANES), _longer(width, slots // LANES),
            slot, _longer(neighbour, entries), _longer(stiffness, entries),
            _longer(length, entries),
        )  # fmt: skip


def _longer(array: NDArray, extra: int) -> NDArray:
    return np.concatenate([array, np.zeros(extra, dtype=array.dtype)])
