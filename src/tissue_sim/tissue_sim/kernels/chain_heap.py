"""A heap of the nodes that wait for their visit by ChainMail, the farthest pushed on top."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def push_up(
    reach: NDArray[np.floating],
    heap: NDArray[np.uint32],
    places: NDArray[np.int32],
    waiting: int,
    node: int,
) -> int:
    """Put a node into the heap, or move it up to where it belongs; returns how many wait."""
    place = places[node]
    if place < 0:
        place = waiting
        waiting += 1
    while place > 0:
        parent = (place - 1) >> 1
        above = heap[parent]
        if reach[node] <= reach[above]:
            break
        heap[place] = above
        places[above] = place
        place = parent
    heap[place] = node
    places[node] = place
    return waiting


@njit(cache=True, nogil=True)
def pop(
    reach: NDArray[np.floating], heap: NDArray[np.uint32], places: NDArray[np.int32], waiting: int
) -> int:
    """Take the node that has been pushed farthest out of a heap of `waiting` nodes."""
    top, node, last = heap[0], heap[waiting - 1], waiting - 2
    places[top] = -1
    if last < 0:
        return top
    place, child = 0, 1
    while child <= last:
        if child < last and reach[heap[child + 1]] > reach[heap[child]]:
            child += 1
        if reach[heap[child]] <= reach[node]:
            break
        heap[place] = heap[child]
        places[heap[child]] = place
        place, child = child, 2 * child + 1
    heap[place] = node
    places[node] = place
    return top
