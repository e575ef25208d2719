"""Loops of ChainMail on the edges of a mesh: limits are spread, then displacements averaged.

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

from tissue_sim.kernels.springs import FAST, SpringArrays

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


class Awake(NamedTuple):
    """Nodes that averaging visits.

    Attributes:
        nodes: Their rows, shape (node_capacity,).
        member: Whether a node is one, shape (node_capacity,).
    """

    nodes: NDArray[np.uint32]
    member: NDArray[np.bool_]


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
def _push_up(
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
def _pop(
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


@njit(cache=True, nogil=True)
def _begin(sources: NDArray[np.uint32], used: int, u: NDArray[np.floating], search: Search) -> None:
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
            waiting = _push_up(reach, heap, places, waiting, j)
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
        i = _pop(reach, heap, places, waiting)
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
            waiting = _push_up(reach, heap, places, waiting, j)
    counts[WAITING] = 0
    counts[CONFLICTS] += conflicts
    counts[CHANGES] += changes
    return visited


@njit(cache=True, nogil=True)
def _spread(
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


@njit(cache=True, nogil=True)
def _wake(
    i: int,
    start: NDArray[np.uint32],
    degree: NDArray[np.uint32],
    neighbour: NDArray[np.uint32],
    nodes: NDArray[np.uint32],
    member: NDArray[np.bool_],
    count: int,
) -> int:
    """Let a node and its neighbours be visited by averaging; returns how many are."""
    if not member[i]:
        member[i] = True
        nodes[count] = i
        count += 1
    for entry in range(start[i], start[i] + degree[i]):
        j = neighbour[entry]
        if not member[j]:
            member[j] = True
            nodes[count] = j
            count += 1
    return count


@njit(cache=True, nogil=True)
def _apply(
    springs: SpringArrays,
    prescribed: NDArray[np.bool_],
    u: NDArray[np.floating],
    search: Search,
    awake: Awake,
    count: int,
) -> int:
    """Put the bounded nodes within their bounds along an axis and clean up; how many are awake."""
    _, start, degree, neighbour, _, _ = springs
    nodes, member = awake
    reach, pushed, touched, counts = search.reach, search.pushed, search.touched, search.counts
    half = u.dtype.type(0.5)
    for place in range(counts[TOUCHED]):
        i = touched[place]
        low, high = reach[BELOW, i], -reach[ABOVE, i]
        reach[BELOW, i] = reach[ABOVE, i] = -np.inf
        pushed[BELOW, i] = pushed[ABOVE, i] = False
        if prescribed[i]:
            continue
        goal = low + (high - low) * half if low > high else min(max(u[i], low), high)
        if goal != u[i]:
            u[i] = goal
            count = _wake(i, start, degree, neighbour, nodes, member, count)
    return count


# No fastmath: with a number that is not finite the search must still come to an end.
@njit(cache=True, nogil=True, error_model="numpy")
def propagate(
    sources: NDArray[np.uint32],
    used: int,
    springs: SpringArrays,
    shares: NDArray[np.floating],
    prescribed: NDArray[np.bool_],
    u: NDArray[np.floating],
    search: Search,
    awake: Awake,
    count: int,
) -> tuple[int, int]:
    """Move what violates a limit with a source, or with what that moves. Modifies `u` in place.

    Args:
        sources: Nodes that may violate limits with their neighbours, in [0, used).
        used: How many.
        springs: Neighbours by node.
        shares: Shares of stretch, compression and shear, shape (3,).
        prescribed: Nodes that do not move.
        u: Displacements [m], shape (node_capacity, 3).
        search: To write on; `strained` and its count are of use afterwards.
        awake: Nodes that averaging visits; those that move join, with their neighbours.
        count: How many are awake.

    Returns:
        Nodes visited, those by several axes and bounds several times, and how many are awake.
    """
    visited = 0
    counts, strained, is_strained = search.counts, search.strained, search.is_strained
    counts[STRAINED] = 0
    for axis in range(3):
        _begin(sources, used, u[:, axis], search)
        visited += _spread(axis, springs, shares, prescribed, u[:, axis], search)
        count = _apply(springs, prescribed, u[:, axis], search, awake, count)
    for place in range(counts[STRAINED]):
        is_strained[strained[place]] = False
    return visited, count


FAR = 1e30
"""Displacement [m] that no limit reaches."""


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _within(D, along, across, w, shares, zero, low, high):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Narrow how far a node may move along an axis by one of its edges; never below none."""
    stretch = shares[0] * along + shares[2] * across
    compression = shares[1] * along + shares[2] * across
    above = stretch if zero <= D else compression
    below = compression if zero <= D else stretch
    return max(low, min(w - above, zero)), min(high, max(w + below, zero))


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _wanted(i, rest, start, degree, neighbour, shares, rate, u):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Way of a node towards the mean of its neighbours [m], as far as its limits allow."""
    zero = rate - rate
    X0, X1, X2 = rest[i, 0], rest[i, 1], rest[i, 2]
    u0, u1, u2 = u[i, 0], u[i, 1], u[i, 2]
    t0 = t1 = t2 = zero
    low0 = low1 = low2 = type(rate)(-FAR)
    high0 = high1 = high2 = type(rate)(FAR)
    for entry in range(start[i], start[i] + degree[i]):
        j = neighbour[entry]
        D0, D1, D2 = rest[j, 0] - X0, rest[j, 1] - X1, rest[j, 2] - X2
        w0, w1, w2 = u[j, 0] - u0, u[j, 1] - u1, u[j, 2] - u2
        m0, m1, m2 = abs(D0), abs(D1), abs(D2)
        low0, high0 = _within(D0, m0, m1 + m2, w0, shares, zero, low0, high0)
        low1, high1 = _within(D1, m1, m2 + m0, w1, shares, zero, low1, high1)
        low2, high2 = _within(D2, m2, m0 + m1, w2, shares, zero, low2, high2)
        t0 += w0
        t1 += w1
        t2 += w2
    scale = rate / type(rate)(degree[i])
    return (
        min(max(scale * t0, low0), high0),
        min(max(scale * t1, low1), high1),
        min(max(scale * t2, low2), high2),
    )


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def average(
    springs: SpringArrays,
    shares: NDArray[np.floating],
    prescribed: NDArray[np.bool_],
    rate: np.floating,
    tolerance: np.floating,
    u: NDArray[np.floating],
    awake: Awake,
    count: int,
) -> tuple[np.floating, int]:
    """One Gauss-Seidel sweep towards the mean of the neighbours' displacements.

    Modifies `u` and `awake` in place. A node stays within the limits it is within, and goes no
    farther out of those it is out of. Neighbours of a node that moves farther than `tolerance` [m]
    join for the next sweep.

    Returns:
        Largest move along an axis [m], and how many are awake.
    """
    rest, start, degree, neighbour, _, _ = springs
    nodes, member = awake
    largest = rate - rate
    for place in range(count):
        i = nodes[place]
        if prescribed[i] or degree[i] == 0:
            continue
        move0, move1, move2 = _wanted(i, rest, start, degree, neighbour, shares, rate, u)
        u[i, 0] += move0
        u[i, 1] += move1
        u[i, 2] += move2
        far = max(abs(move0), abs(move1), abs(move2))
        largest = max(largest, far)
        if far > tolerance:
            count = _wake(i, start, degree, neighbour, nodes, member, count)
    return largest, count


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def wake_unbalanced(
    springs: SpringArrays,
    shares: NDArray[np.floating],
    prescribed: NDArray[np.bool_],
    rate: np.floating,
    tolerance: np.floating,
    u: NDArray[np.floating],
    awake: Awake,
    count: int,
) -> int:
    """Wake the neighbours of those awake that would move farther than `tolerance` [m].

    Returns:
        How many are awake then.
    """
    rest, start, degree, neighbour, _, _ = springs
    nodes, member = awake
    before = count
    for place in range(before):
        i = nodes[place]
        for entry in range(start[i], start[i] + degree[i]):
            j = neighbour[entry]
            if member[j] or prescribed[j]:
                continue
            move0, move1, move2 = _wanted(j, rest, start, degree, neighbour, shares, rate, u)
            if max(abs(move0), abs(move1), abs(move2)) > tolerance:
                member[j] = True
                nodes[count] = j
                count += 1
    return count


@njit(cache=True, nogil=True)
def gather_sources(
    held: NDArray[np.int32],
    always: bool,
    strained: NDArray[np.uint32],
    strained_used: int,
    u: NDArray[np.floating],
    seen: NDArray[np.floating],
    sources: NDArray[np.uint32],
    used: int,
) -> int:
    """List the held nodes that moved, and those that violated limits before if anything did.

    Modifies `seen`, where held nodes were [m], shape (node_capacity, 3), and `sources` in place.

    Args:
        held: Rows of the held nodes.
        always: Whether they are all listed, moved or not.
        strained: Prescribed nodes that violated limits, in [0, strained_used).
        strained_used: How many.
        u: Displacements [m].
        seen: Where the held nodes were before.
        sources: Nodes, of which `used` are listed already; room for all.
        used: How many.

    Returns:
        How many sources there are.
    """
    for i in held:
        if always or u[i, 0] != seen[i, 0] or u[i, 1] != seen[i, 1] or u[i, 2] != seen[i, 2]:
            seen[i, 0], seen[i, 1], seen[i, 2] = u[i, 0], u[i, 1], u[i, 2]
            sources[used] = i
            used += 1
    if used > 0 or always:
        for place in range(strained_used):
            sources[used] = strained[place]
            used += 1
    return used


@njit(cache=True, nogil=True)
def wake_all(
    nodes: NDArray[np.uint32], used: int, springs: SpringArrays, awake: Awake, count: int
) -> int:
    """Wake nodes[:used] and their neighbours; returns how many are awake then."""
    _, start, degree, neighbour, _, _ = springs
    for place in range(used):
        count = _wake(nodes[place], start, degree, neighbour, awake.nodes, awake.member, count)
    return count
