"""Lists of what meets at each node, with room to change in place."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

SLACK = 2
"""Spare places per list when it is built."""


@njit(cache=True, nogil=True)
def _fill(
    items: NDArray[np.int32],
    alive: NDArray[np.bool_],
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    data: NDArray[np.int32],
) -> None:
    for item in range(items.shape[0]):
        if alive[item]:
            for corner in range(items.shape[1]):
                node = items[item, corner]
                data[start[node] + count[node]] = item
                count[node] += 1


class Incidence:
    """For each node row the item rows (elements, springs) that meet there, in a stable order.

    Lists keep spare room; a list that outgrows it moves to the end of `data`. The order of a list depends only on the
    items it was built from and the changes made since, so that sweeps visit neighbours in a reproducible order.

    Attributes:
        start: Where each node's list begins in `data`, shape (node_capacity,).
        count: Length of each list, shape (node_capacity,).
        data: Item rows; valid in [start, start + count) for each node.
    """

    def __init__(self, node_capacity: int) -> None:
        self.start = np.zeros(node_capacity, dtype=np.int64)
        self.count = np.zeros(node_capacity, dtype=np.int32)
        self.room = np.zeros(node_capacity, dtype=np.int32)
        self.data = np.empty(0, dtype=np.int32)
        self.used = 0

    @classmethod
    def build(
        cls, items: NDArray[np.int32], alive: NDArray[np.bool_], node_capacity: int
    ) -> Incidence:
        """Build the lists of items by node.

        Args:
            items: Node rows of each item, shape (item_count, corners).
            alive: Items that count, shape (item_count,).
            node_capacity: Number of lists.
        """
        lists = cls(node_capacity)
        degree = np.bincount(items[alive].ravel(), minlength=node_capacity)
        lists.room[:] = degree + np.where(degree > 0, SLACK, 0)
        ends = np.cumsum(lists.room, dtype=np.int64)
        lists.start[1:] = ends[:-1]
        lists.used = int(ends[-1]) if node_capacity else 0
        lists.data = np.full(lists.used + lists.used // 8 + 64, -1, dtype=np.int32)
        _fill(items, alive, lists.start, lists.count, lists.data)
        return lists

    def of(self, node: int) -> NDArray[np.int32]:
        """Items at a node, shape (count,); a view."""
        begin = self.start[node]
        return self.data[begin : begin + self.count[node]]

    def add(self, node: int, item: int) -> None:
        """Append an item to a node's list. Modifies the lists in place."""
        if self.count[node] == self.room[node]:
            self._move_to_end(node)
        self.data[self.start[node] + self.count[node]] = item
        self.count[node] += 1

    def remove(self, node: int, item: int) -> None:
        """Take an item out of a node's list, keeping the order of the others. Modifies the lists in place.

        Raises:
            KeyError: The item is not in the list.
        """
        items = self.of(node)
        places = np.flatnonzero(items == item)
        if not len(places):
            raise KeyError(f"item {item} does not meet node row {node}")
        items[places[0] : -1] = items[places[0] + 1 :]
        self.count[node] -= 1

    def grow(self, node_capacity: int) -> None:
        """Make place for more nodes. Modifies the lists in place."""
        extra = node_capacity - len(self.start)
        if extra > 0:
            self.start = np.concatenate([self.start, np.zeros(extra, dtype=np.int64)])
            self.count = np.concatenate([self.count, np.zeros(extra, dtype=np.int32)])
            self.room = np.concatenate([self.room, np.zeros(extra, dtype=np.int32)])

    def _move_to_end(self, node: int) -> None:
        room = max(8, 2 * int(self.room[node]))
        if self.used + room > len(self.data):
            spare = np.full(len(self.data) // 2 + room, -1, dtype=np.int32)
            self.data = np.concatenate([self.data, spare])
        items = self.of(node).copy()
        self.start[node] = self.used
        self.room[node] = room
        self.data[self.used : self.used + len(items)] = items
        self.used += room
