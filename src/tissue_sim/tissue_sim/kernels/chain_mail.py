"""Loops of ChainMail on the edges of a mesh: from nodes that moved to all within their limits.

Symbols as in `kernels.chain_bounds`, which bounds the nodes; here they are put there.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.chain_averages import Awake, wake
from tissue_sim.kernels.chain_bounds import (
    ABOVE,
    BELOW,
    STRAINED,
    TOUCHED,
    Search,
    begin,
    spread,
)
from tissue_sim.kernels.springs import SpringArrays


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
            count = wake(i, start, degree, neighbour, nodes, member, count)
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
        begin(sources, used, u[:, axis], search)
        visited += spread(axis, springs, shares, prescribed, u[:, axis], search)
        count = _apply(springs, prescribed, u[:, axis], search, awake, count)
    for place in range(counts[STRAINED]):
        is_strained[strained[place]] = False
    return visited, count
