"""Distances along the tissue from nodes that were let go of, and displacements blended by them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray


class Tissue(NamedTuple):
    """Which nodes are neighbours, and how far apart at rest.

    Attributes:
        start, degree, neighbour: Neighbours by node, as in `SpringArrays`.
        rest: Rest positions [m], shape (node_capacity, 3).
    """

    start: NDArray[np.uint32]
    degree: NDArray[np.uint32]
    neighbour: NDArray[np.uint32]
    rest: NDArray[np.float64]


class Queue(NamedTuple):
    """Nodes by key, the least first: a binary heap that knows where everything is.

    Attributes:
        key: Key of every node; infinite for those never queued, shape (node_capacity,).
        nodes: The heap, shape (node_capacity,).
        place: Place of each node in it, -1 for those not in it, shape (node_capacity,).
    """

    key: NDArray[np.float64]
    nodes: NDArray[np.int32]
    place: NDArray[np.int32]


@njit(cache=True, nogil=True)
def _rise(queue: Queue, at: int) -> None:
    node = queue.nodes[at]
    while at > 0:
        above = (at - 1) // 2
        other = queue.nodes[above]
        if queue.key[other] <= queue.key[node]:
            break
        queue.nodes[at] = other
        queue.place[other] = at
        at = above
    queue.nodes[at] = node
    queue.place[node] = at


@njit(cache=True, nogil=True)
def _put(queue: Queue, size: int, node: int, key: float) -> int:
    """Queue a node, or lower its key; returns the size."""
    queue.key[node] = key
    if queue.place[node] < 0:
        queue.nodes[size] = node
        queue.place[node] = size
        size += 1
    _rise(queue, queue.place[node])
    return size


@njit(cache=True, nogil=True)
def _take(queue: Queue, size: int) -> int:
    """Take out the node of least key; the size is one less afterwards."""
    first, last = queue.nodes[0], queue.nodes[size - 1]
    queue.place[first] = -1
    size -= 1
    if size == 0:
        return first
    at = 0
    while 2 * at + 1 < size:
        below = 2 * at + 1
        if below + 1 < size and (queue.key[queue.nodes[below + 1]] < queue.key[queue.nodes[below]]):
            below += 1
        other = queue.nodes[below]
        if queue.key[last] <= queue.key[other]:
            break
        queue.nodes[at] = other
        queue.place[other] = at
        at = below
    queue.nodes[at] = last
    queue.place[last] = at
    return first


@njit(cache=True, nogil=True)
def _squared(rest: NDArray[np.float64], a: int, b: int) -> float:
    squared = 0.0
    for axis in range(3):
        squared += (rest[a, axis] - rest[b, axis]) ** 2
    return squared


@njit(cache=True, nogil=True)
def _way(rest: NDArray[np.float64], a: int, b: int) -> float:
    return math.sqrt(_squared(rest, a, b))


@njit(cache=True, nogil=True)
def spread(
    sources: NDArray[np.int32],
    tissue: Tissue,
    barred: NDArray[np.bool_],
    reach: float,
    queue: Queue,
    found: NDArray[np.int32],
    met: NDArray[np.int32],
) -> tuple[int, int]:
    """Shortest ways along edges at rest from sources, nearest first.

    Args:
        sources: Nodes at distance 0.
        tissue: Neighbours.
        barred: Nodes that it does not enter (sources excepted), shape (node_capacity,).
        reach: Longest way [m].
        queue: Empty; its keys are the distances [m] of what is found afterwards.
        found: Nodes within reach, sources included; written.
        met: Barred nodes met on the way; written.

    Returns:
        How many were found, and how many met. The keys of both are finite.
    """
    size, n_found, n_met = 0, 0, 0
    for source in sources:
        size = _put(queue, size, source, 0.0)
    while size > 0:
        i = _take(queue, size)
        size -= 1
        found[n_found] = i
        n_found += 1
        for entry in range(tissue.start[i], tissue.start[i] + tissue.degree[i]):
            j = tissue.neighbour[entry]
            if queue.key[j] <= queue.key[i]:
                continue
            squared = _squared(tissue.rest, i, j)
            gain = min(queue.key[j], reach) - queue.key[i]
            if squared >= gain * gain:
                continue
            way = queue.key[i] + math.sqrt(squared)
            if barred[j]:
                if queue.key[j] == np.inf:
                    met[n_met] = j
                    n_met += 1
                queue.key[j] = way
            else:
                size = _put(queue, size, j, way)
    return n_found, n_met


@njit(cache=True, nogil=True)
def anchored(
    sources: NDArray[np.int32],
    tissue: Tissue,
    fixed: NDArray[np.bool_],
    rows: int,
    queue: Queue,
    mark: NDArray[np.int8],
    visited: NDArray[np.int32],
    kept: NDArray[np.int32],
) -> int:
    """Which sources hang together with a fixed node.

    It looks for one by going towards the fixed node nearest to the source. Where there is one that
    takes part of the nodes on the way; a piece without any is searched to its end. What was found
    out is kept in `mark`.

    Args:
        sources: Nodes to judge.
        tissue: Neighbours.
        fixed: Nodes that never move, shape (node_capacity,).
        rows: Nodes in use.
        queue: Empty before and after.
        mark: 1 for nodes known to hang together with a fixed node, -1 for those known not to, 0 for
            unknown; written, shape (node_capacity,).
        visited: Room for as many rows as there are nodes.
        kept: The sources that hang together with a fixed node, in order; written.

    Returns:
        How many those are.
    """
    n_visited, n_kept = 0, 0
    for source in sources:
        if mark[source] == 0:
            target, nearest = -1, np.inf
            for node in range(rows):
                if fixed[node] and _way(tissue.rest, source, node) < nearest:
                    target, nearest = node, _way(tissue.rest, source, node)
            if target < 0:
                return 0
            begin = n_visited
            verdict = -1
            size = _put(queue, 0, source, 0.0)
            visited[n_visited] = source
            n_visited += 1
            while size > 0 and verdict < 0:
                i = _take(queue, size)
                size -= 1
                for entry in range(tissue.start[i], tissue.start[i] + tissue.degree[i]):
                    j = tissue.neighbour[entry]
                    if fixed[j] or mark[j] == 1:
                        verdict = 1
                    elif queue.key[j] == np.inf and mark[j] == 0:
                        size = _put(queue, size, j, _way(tissue.rest, j, target))
                        visited[n_visited] = j
                        n_visited += 1
            for place in range(begin, n_visited):
                mark[visited[place]] = verdict
                queue.key[visited[place]] = np.inf
                queue.place[visited[place]] = -1
        if mark[source] == 1:
            kept[n_kept] = source
            n_kept += 1
    return n_kept


@njit(cache=True, nogil=True)
def pick_staying(
    nodes: NDArray[np.int32], fixed: NDArray[np.bool_], u: NDArray[np.floating]
) -> int:
    """Move those that are held, or fixed away from rest, to the front; returns how many."""
    n = 0
    for place in range(len(nodes)):
        node = nodes[place]
        if not fixed[node] or u[node, 0] != 0 or u[node, 1] != 0 or u[node, 2] != 0:
            nodes[n] = node
            n += 1
    return n


@njit(cache=True, nogil=True)
def blend(
    nodes: NDArray[np.int32],
    released: NDArray[np.float64],
    held: NDArray[np.float64],
    radius: float,
    u: NDArray[np.floating],
    previous: NDArray[np.floating],
) -> None:
    """Scale displacements by 0 at released nodes up to 1 at the radius, or at held nodes.

    Args:
        nodes: Nodes within the radius.
        released: Distance of every node from the released ones [m], shape (node_capacity,).
        held: Distance of every node from those that stay displaced [m]; infinite where far.
        radius: Where it ends [m].
        u: Displacements [m], shape (node_capacity, 3); modified in place.
        previous: Set to the same, so that nothing has a velocity; modified in place.
    """
    for node in nodes:
        way = released[node]
        share = min(way / min(radius, way + held[node]), 1.0) if way > 0.0 else 0.0
        weight = share * share * (3.0 - 2.0 * share)
        for axis in range(3):
            u[node, axis] = weight * u[node, axis]
            previous[node, axis] = u[node, axis]


@njit(cache=True, nogil=True)
def forget(nodes: NDArray[np.int32], queue: Queue) -> None:
    """Take back the keys of nodes. Modifies the queue in place."""
    for node in nodes:
        queue.key[node] = np.inf
        queue.place[node] = -1
