"""Lists of what meets at each node, with room to change in place."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

SLACK = 2
"""Spare places per list when it is built."""

LEAST_ROOM = 8
"""Places of a list that had none."""


def sorted_unique(rows: NDArray[np.int32]) -> NDArray[np.int32]:
    """Ascending, each once; much faster than `np.unique` on the few thousand of an edit."""
    ordered = np.sort(rows)
    keep = np.ones(len(ordered), dtype=np.bool_)
    np.not_equal(ordered[1:], ordered[:-1], out=keep[1:])
    return ordered[keep]


def among(rows: NDArray[np.integer], some: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Which rows are among some; quicker than `np.isin` on the few hundred of an edit."""
    if not len(some):
        return np.zeros(len(rows), dtype=np.bool_)
    ordered = np.sort(some)
    place = np.minimum(np.searchsorted(ordered, rows), len(ordered) - 1)
    return np.asarray(ordered[place] == rows)


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
                if node < 0:
                    continue
                data[start[node] + count[node]] = item
                count[node] += 1


@njit(cache=True, nogil=True)
def _has(items: NDArray[np.int32], k: int, node: int) -> bool:
    found = False
    for corner in range(items.shape[1]):
        found = found or items[k, corner] == node
    return found


@njit(cache=True, nogil=True)
def _rewire(
    items: NDArray[np.int32],
    old: NDArray[np.int32],
    new: NDArray[np.int32],
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    room: NDArray[np.int32],
    data: NDArray[np.int32],
    used: int,
) -> int:
    """Take items out of the lists of old nodes and put them into those of new ones, in order.

    `data` must have place for every list that outgrows its room. Returns the places used in `data`;
    -1 if an item was not in a list it should leave.
    """
    for k in range(items.shape[0]):
        for corner in range(old.shape[1]):
            node = old[k, corner]
            if node < 0 or _has(new, k, node):
                continue
            begin, end = start[node], start[node] + count[node]
            place = begin
            while place < end and data[place] != items[k]:
                place += 1
            if place == end:
                return -1
            for later in range(place, end - 1):
                data[later] = data[later + 1]
            count[node] -= 1
        for corner in range(new.shape[1]):
            node = new[k, corner]
            if node < 0 or _has(old, k, node):
                continue
            if count[node] == room[node]:
                room[node] = max(LEAST_ROOM, 2 * room[node])
                for m in range(count[node]):
                    data[used + m] = data[start[node] + m]
                start[node] = used
                used += room[node]
            place = start[node] + count[node]
            while place > start[node] and data[place - 1] > items[k]:
                data[place] = data[place - 1]
                place -= 1
            data[place] = items[k]
            count[node] += 1
    return used


@njit(cache=True, nogil=True)
def _gather(
    nodes: NDArray[np.int32],
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    data: NDArray[np.int32],
    out: NDArray[np.int32],
) -> None:
    place = 0
    for node in nodes:
        for k in range(count[node]):
            out[place] = data[start[node] + k]
            place += 1


class Incidence:
    """For each node row the item rows (elements, springs) that meet there, ascending.

    Lists keep spare room; a list that outgrows it moves to the end of `data`. Because lists are
    ascending, they depend only on what is there and not on how it came about: an edited mesh, one
    rebuilt from a keyframe and one loaded again visit neighbours in the same order.

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
            items: Node rows of each item, shape (item_count, corners); -1 for none.
            alive: Items that count, shape (item_count,).
            node_capacity: Number of lists.
        """
        lists = cls(node_capacity)
        corners = items[alive].ravel()
        degree = np.bincount(corners[corners >= 0], minlength=node_capacity)
        lists.room[:] = degree + np.where(degree > 0, SLACK, 0)
        ends = np.cumsum(lists.room, dtype=np.int64)
        lists.start[1:] = ends[:-1]
        lists.used = int(ends[-1]) if node_capacity else 0
        lists.data = np.full(lists.used + lists.used // 4 + 65536, -1, dtype=np.int32)
        _fill(items, alive, lists.start, lists.count, lists.data)
        return lists

    def of(self, node: int) -> NDArray[np.int32]:
        """Items at a node, shape (count,); a view."""
        begin = self.start[node]
        return self.data[begin : begin + self.count[node]]

    def add(self, node: int, item: int) -> None:
        """Put an item into a node's list. Modifies the lists in place."""
        if self.count[node] == self.room[node]:
            self._move_to_end(node)
        self.count[node] += 1
        items = self.of(node)
        place = int(np.searchsorted(items[:-1], item))
        items[place + 1 :] = items[place:-1].copy()
        items[place] = item

    def remove(self, node: int, item: int) -> None:
        """Take an item out of a node's list. Modifies the lists in place.

        Raises:
            KeyError: The item is not in the list.
        """
        items = self.of(node)
        places = np.flatnonzero(items == item)
        if not len(places):
            raise KeyError(f"item {item} does not meet node row {node}")
        items[places[0] : -1] = items[places[0] + 1 :]
        self.count[node] -= 1

    def rewire(
        self, items: NDArray[np.int32], old: NDArray[np.int32], new: NDArray[np.int32]
    ) -> None:
        """Move items between lists, as `remove` and `add` for each would. Modifies in place.

        Args:
            items: Items whose nodes change, shape (n,).
            old: Their nodes before, shape (n, corners); -1 for none.
            new: Their nodes after, shape (n, corners); -1 for none.

        Raises:
            KeyError: An item is not in the list of one of its old nodes.
        """
        joined = new[new >= 0]
        nodes = sorted_unique(joined)
        # A list doubles its room until it fits: all its moves together take less than this.
        places = self.used + 4 * int(self.room[nodes].sum() + len(joined) + LEAST_ROOM * len(nodes))
        if places > len(self.data):
            spare = np.full(places - len(self.data) + len(self.data) // 2, -1, dtype=np.int32)
            self.data = np.concatenate([self.data, spare])
        used = _rewire(items, old, new, self.start, self.count, self.room, self.data, self.used)
        if used < 0:
            raise KeyError("an item does not meet a node it should leave")
        self.used = used

    def of_all(self, nodes: NDArray[np.int32]) -> NDArray[np.int32]:
        """Items that meet any of the nodes, ascending, each once."""
        items = np.empty(int(self.count[nodes].sum()), dtype=np.int32)
        _gather(nodes, self.start, self.count, self.data, items)
        return sorted_unique(items)

    def grow(self, node_capacity: int) -> None:
        """Make place for more nodes. Modifies the lists in place."""
        extra = node_capacity - len(self.start)
        if extra > 0:
            self.start = np.concatenate([self.start, np.zeros(extra, dtype=np.int64)])
            self.count = np.concatenate([self.count, np.zeros(extra, dtype=np.int32)])
            self.room = np.concatenate([self.room, np.zeros(extra, dtype=np.int32)])

    def _move_to_end(self, node: int) -> None:
        room = max(LEAST_ROOM, 2 * int(self.room[node]))
        if self.used + room > len(self.data):
            spare = np.full(len(self.data) // 2 + room, -1, dtype=np.int32)
            self.data = np.concatenate([self.data, spare])
        items = self.of(node).copy()
        self.start[node] = self.used
        self.room[node] = room
        self.data[self.used : self.used + len(items)] = items
        self.used += room
