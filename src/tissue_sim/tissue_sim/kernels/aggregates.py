"""Loops that divide an organ into aggregates of neighbouring nodes."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def farthest_points(
    rest: NDArray[np.float64], rows: NDArray[np.int32], count: int
) -> NDArray[np.int32]:
    """Rows of nodes far from each other: each the farthest from those before it.

    Args:
        rest: Rest positions [m], shape (node_capacity, 3).
        rows: Nodes to choose from.
        count: How many to choose.
    """
    chosen = np.empty(count, dtype=np.int32)
    nearest = np.full(len(rows), np.inf)
    last = 0
    for place in range(count):
        chosen[place] = rows[last]
        centre = rest[rows[last]]
        last = 0
        for k in range(len(rows)):
            point = rest[rows[k]]
            squared = 0.0
            for axis in range(3):
                squared += (point[axis] - centre[axis]) ** 2
            nearest[k] = min(nearest[k], squared)
            if nearest[k] > nearest[last]:
                last = k
    return chosen


@njit(cache=True, nogil=True)
def spread_labels(
    seeds: NDArray[np.int32],
    start: NDArray[np.uint32],
    degree: NDArray[np.uint32],
    neighbour: NDArray[np.uint32],
    label: NDArray[np.int32],
) -> None:
    """Give every node the number of the seed that is fewest edges away.

    Args:
        seeds: Rows of nodes.
        start: Edges by node, as in `SpringArrays`.
        degree: Edges by node.
        neighbour: Edges by node.
        label: -1 everywhere; written, -1 where no seed can be reached, shape (node_capacity,).
    """
    queue = np.empty(len(label), dtype=np.int32)
    begin = end = 0
    for number in range(len(seeds)):
        if label[seeds[number]] < 0:
            label[seeds[number]] = number
            queue[end] = seeds[number]
            end += 1
    while begin < end:
        node = queue[begin]
        begin += 1
        first = np.int64(start[node])
        for place in range(first, first + np.int64(degree[node])):
            other = neighbour[place]
            if label[other] < 0:
                label[other] = label[node]
                queue[end] = other
                end += 1
