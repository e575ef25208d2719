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


@njit(cache=True, nogil=True)
def patches_of(
    nodes: NDArray[np.int32],
    start: NDArray[np.uint32],
    degree: NDArray[np.uint32],
    neighbour: NDArray[np.uint32],
) -> NDArray[np.int32]:
    """Number of the patch of each node: nodes that edges among them join form one.

    Args:
        nodes: Rows of nodes.
        start: Edges by node, as in `SpringArrays`.
        degree: Edges by node.
        neighbour: Edges by node.
    """
    place = np.full(len(start), -1, dtype=np.int32)
    for k in range(len(nodes)):
        place[nodes[k]] = k
    label = np.full(len(nodes), -1, dtype=np.int32)
    stack = np.empty(len(nodes), dtype=np.int32)
    patches = 0
    for k in range(len(nodes)):
        if label[k] >= 0:
            continue
        label[k], stack[0], waiting = patches, k, 1
        while waiting:
            waiting -= 1
            node = nodes[stack[waiting]]
            first = np.int64(start[node])
            for entry in range(first, first + np.int64(degree[node])):
                other = place[neighbour[entry]]
                if other >= 0 and label[other] < 0:
                    label[other] = patches
                    stack[waiting] = other
                    waiting += 1
        patches += 1
    return label
