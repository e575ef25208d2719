"""The order in which relaxation passes visit springs."""

from __future__ import annotations

import numpy as np

from tissue_sim.elastic.ordering import NodeOrdering
from tissue_sim.elastic.springs import REMOVED, SpringChange, SpringNetwork
from tissue_sim.kernels.orderings import UNREACHED
from tissue_sim.kernels.relaxation import (
    BLOCK,
    REMOVED_LENGTH,
    SpringList,
    list_springs,
    relist,
)

NODES_A_PASS = 4000
"""Nodes whose springs are listed before each pass while a new order is made: a few tenths of a
millisecond's work, of the several milliseconds that a large organ takes."""


class SpringOrdering:
    """Springs in the order of a relaxation pass: each at its end that the nodes' order has first.

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
        self._next.end()
        self._now, self._next, self._nodes = self._next, self._now, None
        return True

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
        self._allocate(len(springs.springs.ends))

    def _allocate(self, capacity: int) -> None:
        dtype = self._springs.dtype
        rows = capacity + BLOCK
        self.list = SpringList(
            np.full(rows, 0, dtype=np.uint32), np.full(rows, 0, dtype=np.uint32),
            np.full((rows, 3), 0, dtype=dtype), np.full(rows, REMOVED_LENGTH, dtype=dtype),
        )  # fmt: skip
        self._place_of = np.full(capacity, UNREACHED, dtype=np.int32)

    def clear(self) -> None:
        """Begin with no spring."""
        if len(self._place_of) < len(self._springs.springs.ends):
            self._allocate(len(self._springs.springs.ends))
        self._place_of[:] = UNREACHED
        self.used = 0

    def append(self, nodes: NodeOrdering, begin: int, end: int) -> None:
        """List the springs of some places of the order of nodes, those before being listed."""
        springs = self._springs
        self.used = list_springs(
            nodes.nodes, begin, end, nodes.rank, springs.arrays, springs.spring_of, self.used,
            self.list, self._place_of,
        )  # fmt: skip

    def end(self) -> None:
        """Bury what an earlier, longer list left behind the last spring."""
        self.list.length[self.used :] = REMOVED_LENGTH

    def follow(self, change: SpringChange) -> None:
        """Change, bury and append springs."""
        springs = self._springs.springs
        self._reserve(len(springs.ends), len(change.rows))
        self.used = relist(
            change.rows, change.kinds == REMOVED, springs.ends, springs.length,
            self._springs.arrays.rest, self.used, self.list, self._place_of,
        )  # fmt: skip

    def _reserve(self, rows: int, more: int) -> None:
        short = max(rows, self.used + more) - len(self._place_of)
        if short <= 0:
            return
        extra = short + len(self._place_of) // 4
        self.list = SpringList(
            *(
                np.concatenate([array, np.zeros((extra, *array.shape[1:]), dtype=array.dtype)])
                for array in self.list
            )
        )
        self.list.length[self.used :] = REMOVED_LENGTH
        unlisted = np.full(extra, UNREACHED, dtype=np.int32)
        self._place_of = np.concatenate([self._place_of, unlisted])
