"""Loops of ChainMail's elastic relaxation: nodes go to the mean of their neighbours, within limits.

The limits are those of `kernels.chain_bounds`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST, SpringArrays

FAR = 1e30
"""Displacement [m] that no limit reaches."""


class Awake(NamedTuple):
    """Nodes that averaging visits.

    Attributes:
        nodes: Their rows, shape (node_capacity,).
        member: Whether a node is one, shape (node_capacity,).
    """

    nodes: NDArray[np.uint32]
    member: NDArray[np.bool_]


@njit(cache=True, nogil=True)
def wake(
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
def wake_all(
    nodes: NDArray[np.uint32], used: int, springs: SpringArrays, awake: Awake, count: int
) -> int:
    """Wake nodes[:used] and their neighbours; returns how many are awake then."""
    _, start, degree, neighbour, _, _ = springs
    for place in range(used):
        count = wake(nodes[place], start, degree, neighbour, awake.nodes, awake.member, count)
    return count


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
            count = wake(i, start, degree, neighbour, nodes, member, count)
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
