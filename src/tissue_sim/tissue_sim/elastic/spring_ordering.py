"""The order in which relaxation passes visit springs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.ordering import NodeOrdering
from tissue_sim.elastic.springs import SpringChange, SpringNetwork
from tissue_sim.kernels.networks import REMOVED, STIFFER
from tissue_sim.kernels.orderings import UNREACHED
from tissue_sim.kernels.relaxation import (
    APART,
    REMOVED_LENGTH,
    SpringList,
    Turns,
    list_springs,
    relist,
)
from tissue_sim.kernels.vectors import LANES

NODES_A_PASS = 4000
"""Nodes whose springs are listed before each pass while a new order is made: a few tenths of a
millisecond's work, of the several milliseconds that a large organ takes."""


class SpringOrdering:
    """Springs in the order of a relaxation pass: each at its end that the nodes' order has first.

    Springs that do not touch each other are brought forward into groups that are relaxed at once;
    two springs at one node keep their turn, so that the passes do what the plain order would do.

    A new order is made in parts, one before each pass, and taken when it is complete; until then
    passes follow the order before it. Springs that an edit makes are visited last until then;
    removed ones leave a tombstone.
    """

    def __init__(self, springs: SpringNetwork) -> None:
        self.springs = springs
        self._now, self._next = _Listing(springs), _Listing(springs)
        self._nodes: NodeOrdering | None = None
        self._done = 0

    @property
    def list(self) -> SpringList:
        """The springs for the kernels."""
        return self._now.list

    @property
    def used(self) -> int:
        """Springs of the list, tombstones included."""
        return self._now.used

    def order(self, nodes: NodeOrdering) -> None:
        """Begin to list the springs anew along an order of nodes; `advance` goes on with it."""
        self._nodes, self._done = nodes, 0

    def advance(self) -> bool:
        """Make the next part of a new order, if one was begun; whether it is taken now."""
        nodes = self._nodes
        if nodes is None:
            return False
        if self._done == 0:
            self._next.clear()
        end = min(self._done + NODES_A_PASS, nodes.used)
        self._next.append(nodes, self._done, end)
        self._done = end
        if end < nodes.used:
            return False
        self._now, self._next, self._nodes = self._next, self._now, None
        return True

    def complete(self) -> None:
        """Make the rest of a new order, if one was begun, at once."""
        while self._nodes is not None:
            self.advance()

    def follow(self, change: SpringChange) -> None:
        """Follow what an edit did to the springs, in time proportional to it.

        The order of nodes must have followed before: a new order that is being made begins again.
        """
        self._done = 0
        self._now.follow(change)


class _Listing:
    """A list of springs with room for what edits make."""

    def __init__(self, springs: SpringNetwork) -> None:
        self._springs = springs
        self.used = 0
        capacity, dtype = len(springs.springs.ends), springs.dtype
        slots = capacity + capacity // 8 + 64 * LANES
        self.list = SpringList(
            np.full(slots, 0, dtype=np.uint32), np.full(slots, 0, dtype=np.uint32),
            np.full(3 * slots, 0, dtype=dtype), np.full(slots, REMOVED_LENGTH, dtype=dtype),
        )  # fmt: skip
        groups = slots // LANES
        self._turns = Turns(
            np.full(self._nobody + 1, 0, dtype=np.int32), np.full(groups, 0, dtype=np.int32),
            np.full(groups, 0, dtype=np.int32),
        )  # fmt: skip
        self._place_of = np.full(capacity, UNREACHED, dtype=np.int32)

    @property
    def _nobody(self) -> int:
        """The node that does not exist, at which tombstones are."""
        return self._springs.mesh.node_capacity

    def clear(self) -> None:
        """Begin with no spring."""
        self._match_capacity()
        self._place_of[:] = UNREACHED
        self._turns.ready[:] = 0
        self.used = 0

    def append(self, nodes: NodeOrdering, begin: int, end: int) -> None:
        """List the springs of some places of the order of nodes, those before being listed."""
        springs = self._springs
        while begin < end:
            begin, self.used = list_springs(
                nodes.nodes, begin, end, nodes.key, springs.arrays, springs.spring_of, self.used,
                self.list, self._place_of, self._turns,
            )  # fmt: skip
            if begin < end:
                most = int(springs.arrays.degree[nodes.nodes[begin]])
                self._make_room(APART * (most + 1) * LANES)

    def follow(self, change: SpringChange) -> None:
        """Change, bury and append springs."""
        springs = self._springs.springs
        self._match_capacity()
        listed = change.kinds != STIFFER
        rows, kinds = change.rows[listed], change.kinds[listed]
        self._make_room(len(rows) * LANES)
        self.used = relist(
            rows, kinds == REMOVED, springs.ends, springs.length,
            self._springs.arrays.rest, self.used, self.list, self._place_of, self._nobody,
        )  # fmt: skip

    def _match_capacity(self) -> None:
        """Follow the capacity of the mesh and of the network."""
        extra = len(self._springs.springs.ends) - len(self._place_of)
        if extra > 0:
            unlisted = np.full(extra, UNREACHED, dtype=np.int32)
            self._place_of = np.concatenate([self._place_of, unlisted])
        nobody, ready = self._nobody, self._turns.ready
        if len(ready) <= nobody:
            for ends in (self.list.first, self.list.second):
                ends[ends == len(ready) - 1] = nobody
            self._turns = self._turns._replace(ready=np.zeros(nobody + 1, dtype=np.int32))

    def _make_room(self, more: int) -> None:
        """Make room for so many more places."""
        slots = len(self.list.length)
        if self.used + more <= slots:
            return
        groups = (more + slots // 4) // LANES + 1
        first, second, edge, length = self.list
        self.list = SpringList(
            _longer(first, groups * LANES), _longer(second, groups * LANES),
            _longer(edge, 3 * groups * LANES), _longer(length, groups * LANES),
        )  # fmt: skip
        ready, filled, free = self._turns
        self._turns = Turns(ready, _longer(filled, groups), _longer(free, groups))


def _longer(array: NDArray, extra: int) -> NDArray:
    return np.concatenate([array, np.zeros(extra, dtype=array.dtype)])
