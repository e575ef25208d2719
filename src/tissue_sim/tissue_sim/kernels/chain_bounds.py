"""How far ChainMail pushes the nodes of a mesh: bounds that the limits of its edges carry along.

Symbols as in `kernels.springs`. The limits of an edge are a box for w = u_j - u_i. Along axis a,
with s, c, b the shares of stretch, compression and shear:

    m_a = |D_a|,    n_a = sum of the other |D|,
    -(c m_a + b n_a) <= w_a <= s m_a + b n_a    where D_a >= 0; s and c swap where D_a < 0.

The axes do not meet, and along each the limits read u_j - u_i <= h_ij: the nodes that have moved
bound every other node from below by L and from above by U,

    L_j = max over paths from a source s of (u_s - limits along the path),    U_j likewise,

paths through nodes that do not move excepted, which is a shortest-path problem. Put at

    clamp(u_j, min(L_j, M_j), max(U_j, M_j)),    M_j = (L_j + U_j) / 2,

all nodes are within their limits: L, U, M and the old u each obey u_j - u_i <= h_ij, and so do
least, greatest and mean of such functions. Best-first search finds L where it lies above u, and U
where it lies below, and looks at nothing else.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.chain_heap import pop, push_up
from tissue_sim.kernels.springs import SpringArrays

BELOW, ABOVE = 0, 1
"""The bounds: L, from below, and U, from above."""

TOUCHED, WAITING, STRAINED, CONFLICTS, CHANGES, COUNTS = range(6)
"""What a propagation counts: nodes in three lists of `Search`, bounds that cross, new bounds."""


class Search(NamedTuple):
    """What a propagation writes on; clean between two of them.

    Attributes:
        reach: L and -U along one axis [m], -inf where there is none, shape (2, node_capacity).
        pushed: Whether its neighbours know of a node's bounds, shape (2, node_capacity).
        touched: Nodes that have a bound, in the order of their first, shape (node_capacity,).
        heap: Nodes waiting for their visit, the farthest pushed on top, shape (node_capacity,).
        place: Place of each node in the heap, -1 for none, shape (node_capacity,).
        strained: Prescribed nodes that violate a limit, shape (node_capacity,).
        is_strained: Whether a node is one, shape (node_capacity,).
        counts: Shape (COUNTS,).
    """

    reach: NDArray[np.floating]
    pushed: NDArray[np.bool_]
    touched: NDArray[np.uint32]
    heap: NDArray[np.uint32]
    place: NDArray[np.int32]
    strained: NDArray[np.uint32]
    is_strained: NDArray[np.bool_]
    counts: NDArray[np.int64]


# Arrays are taken out of tuples before a loop: inside it, that counts references each time.


@njit(inline="always")
def limit_of(rest, shares, side, i, j, axis):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """How far w = u_j - u_i may be below zero, or above it, along an axis [m]."""
    D = rest[j, axis] - rest[i, axis]
    b, c = (axis + 1) % 3, (axis + 2) % 3
    across = abs(rest[j, b] - rest[i, b]) + abs(rest[j, c] - rest[i, c])
    along = shares[0] if (D < 0) == (side == BELOW) else shares[1]
    return along * abs(D) + shares[2] * across


@njit(cache=True, nogil=True)
def begin(sources: NDArray[np.uint32], used: int, u: NDArray[np.floating], search: Search) -> None:
    """Let the sources be bounded by where they are; `u` along one axis. Modifies `search`."""
    reach, counts, touched = search.reach, search.counts, search.touched
    counts[TOUCHED] = counts[WAITING] = counts[CONFLICTS] = 0
    for place in range(used):
        i = sources[place]
        if reach[BELOW, i] == -np.inf:
            touched[counts[TOUCHED]] = i
            counts[TOUCHED] += 1
            reach[BELOW, i], reach[ABOVE, i] = u[i], -u[i]


@njit(cache=True, nogil=True)
def _await(
    axis: int,
    side: int,
    springs: SpringArrays,
    shares: NDArray[np.floating],
    u: NDArray[np.floating],
    search: Search,
) -> None:
    """Let the nodes wait whose bound their neighbours do not know. Modifies `search`.

    Nodes that have the other bound only are bounded by their neighbours: it did not matter before.
    """
    rest, start, degree, neighbour, _, _ = springs
    heap, places, touched, counts = search.heap, search.place, search.touched, search.counts
    reach, other, pushed = search.reach[side], search.reach[1 - side], search.pushed[side]
    one = shares.dtype.type(1)
    sign = one if side == BELOW else -one
    waiting = counts[WAITING]
    for place in range(counts[TOUCHED]):
        j = touched[place]
        if reach[j] == -np.inf:
            if counts[CONFLICTS] == 0:
                continue
            best = min(sign * u[j], -other[j])
            for entry in range(start[j], start[j] + degree[j]):
                i = neighbour[entry]
                best = max(best, reach[i] - limit_of(rest, shares, side, i, j, axis))
            if not best > min(sign * u[j], -other[j]):
                continue
            reach[j] = best
            counts[CHANGES] += 1
        if not pushed[j]:
            waiting = push_up(reach, heap, places, waiting, j)
    counts[WAITING] = waiting


@njit(cache=True, nogil=True)
def _visit(
    axis: int,
    side: int,
    springs: SpringArrays,
    shares: NDArray[np.floating],
    prescribed: NDArray[np.bool_],
    u: NDArray[np.floating],
    search: Search,
) -> int:
    """Visit the waiting nodes, the farthest pushed first; each pushes its neighbours.

    Modifies `search` in place.

    Returns:
        Nodes visited.
    """
    rest, start, degree, neighbour, _, _ = springs
    heap, places, touched, counts = search.heap, search.place, search.touched, search.counts
    strained, is_strained = search.strained, search.is_strained
    reach, other, pushed = search.reach[side], search.reach[1 - side], search.pushed[side]
    one = shares.dtype.type(1)
    sign = one if side == BELOW else -one
    waiting, visited, conflicts, changes = counts[WAITING], 0, 0, 0
    while waiting > 0:
        i = pop(reach, heap, places, waiting)
        waiting -= 1
        visited += 1
        pushed[i] = True
        here = reach[i]
        for entry in range(start[i], start[i] + degree[i]):
            j = neighbour[entry]
            bound = here - limit_of(rest, shares, side, i, j, axis)
            if not bound > max(reach[j], min(sign * u[j], -other[j])):
                continue
            known = reach[j] != -np.inf or other[j] != -np.inf
            if prescribed[j]:
                conflicts += 1
                if not is_strained[j]:
                    is_strained[j] = True
                    strained[counts[STRAINED]] = j
                    counts[STRAINED] += 1
                if known:
                    continue
                bound = sign * u[j]
                other[j] = -bound
            reach[j] = bound
            if not known:
                touched[counts[TOUCHED]] = j
                counts[TOUCHED] += 1
            elif bound > -other[j]:
                conflicts += 1
            changes += 1
            waiting = push_up(reach, heap, places, waiting, j)
    counts[WAITING] = 0
    counts[CONFLICTS] += conflicts
    counts[CHANGES] += changes
    return visited


@njit(cache=True, nogil=True)
def spread(
    axis: int,
    springs: SpringArrays,
    shares: NDArray[np.floating],
    prescribed: NDArray[np.bool_],
    u: NDArray[np.floating],
    search: Search,
) -> int:
    """Spread the bounds of the sources along one axis; nodes visited. Modifies `search`."""
    counts, visited = search.counts, 0
    for side in range(2):
        _await(axis, side, springs, shares, u, search)
        visited += _visit(axis, side, springs, shares, prescribed, u, search)
    # Where bounds cross they matter beyond u as well.
    changes = counts[CONFLICTS]
    while changes > 0:
        counts[CHANGES] = 0
        for side in range(2):
            _await(axis, side, springs, shares, u, search)
            visited += _visit(axis, side, springs, shares, prescribed, u, search)
        changes = counts[CHANGES]
    return visited
