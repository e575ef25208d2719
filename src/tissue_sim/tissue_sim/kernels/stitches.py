"""Loops over stitches: their pull, Gauss-Seidel steps of the nodes they join, and limits.

Symbols: e the edge from one end of a stitch to the other [m], l = |e|, l0 its rest length, k its
stiffness [N/m]. A thread pulls and never pushes: its energy is k max(0, l - l0)^2 / 2, the force on
its first end k (e - d) with d = min(1, l0 / l) e. While it is taut, k |e - d|^2 / 2 with d kept is
an upper bound of the energy that touches it at the present edge: what lowers one lowers the other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST, SpringArrays, _pull


class Threads(NamedTuple):
    """Stitches by row: node rows of both ends (n, 2), k [N/m] and l0 [m]."""

    ends: NDArray[np.int32]
    stiffness: NDArray[np.float64]
    length: NDArray[np.float64]


class Sewn(NamedTuple):
    """Nodes with stitches, in the order in which they are visited.

    Attributes:
        nodes: Their rows, shape (s,).
        start: Where the stitches of each begin, shape (s + 1,).
        other: Place in `nodes` of the other end of each, shape (2 n,).
        thread: Row of each stitch, shape (2 n,).
    """

    nodes: NDArray[np.int32]
    start: NDArray[np.int32]
    other: NDArray[np.int32]
    thread: NDArray[np.int32]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _excess(a, b, k, l0, rest, u):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """K (e - d) of a stitch from node a to node b; whether it is taut; l."""
    e0 = rest[b, 0] - rest[a, 0] + (np.float64(u[b, 0]) - np.float64(u[a, 0]))
    e1 = rest[b, 1] - rest[a, 1] + (np.float64(u[b, 1]) - np.float64(u[a, 1]))
    e2 = rest[b, 2] - rest[a, 2] + (np.float64(u[b, 2]) - np.float64(u[a, 2]))
    length = np.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
    taut = length > l0
    share = k * (1.0 - l0 / length) if taut else 0.0
    return share * e0, share * e1, share * e2, taut, length


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_pulls(
    threads: Threads,
    rest: NDArray[np.float64],
    u: NDArray[np.floating],
    F: NDArray[np.floating],
) -> float:
    """Add the pull of all stitches to forces on nodes [N]; their energy [J].

    Args:
        threads: The stitches.
        rest: Rest positions [m], shape (node_capacity, 3).
        u: Displacements [m], shape (node_capacity, 3).
        F: Forces, shape (node_capacity, 3); added to.
    """
    energy = 0.0
    for s in range(len(threads.length)):
        a, b = threads.ends[s, 0], threads.ends[s, 1]
        k, l0 = threads.stiffness[s], threads.length[s]
        p0, p1, p2, taut, length = _excess(a, b, k, l0, rest, u)
        if taut:
            F[a, 0] += p0
            F[a, 1] += p1
            F[a, 2] += p2
            F[b, 0] -= p0
            F[b, 1] -= p1
            F[b, 2] -= p2
            energy += 0.5 * k * (length - l0) ** 2
    return energy


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def sewn_pulls(
    sewn: Sewn,
    threads: Threads,
    rest: NDArray[np.float64],
    u: NDArray[np.floating],
    F: NDArray[np.float64],
    K: NDArray[np.float64],
) -> None:
    """Pull of the taut stitches at each sewn node [N], and the sum of their stiffnesses [N/m].

    Adds to `F`, shape (s, 3), and `K`, shape (s,).
    """
    for place in range(len(sewn.nodes)):
        i = sewn.nodes[place]
        for at in range(sewn.start[place], sewn.start[place + 1]):
            s = sewn.thread[at]
            j = sewn.nodes[sewn.other[at]]
            k = threads.stiffness[s]
            p0, p1, p2, taut, _ = _excess(i, j, k, threads.length[s], rest, u)
            if taut:
                F[place, 0] += p0
                F[place, 1] += p1
                F[place, 2] += p2
                K[place] += k


@njit(inline="always", error_model="numpy", fastmath=FAST)
def aim(place, sewn, threads, F, K, moves, rest, u):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """What the stitches of a node do to it, the other ends answering.

    With F_j the force of the tissue and of its other stitches on the other end and K_j their
    stiffness, that end follows by F_j / K_j and gives way: the stitch counts with

        k' = k K_j / (k + K_j),    and pulls with    k' (e - d + F_j / K_j),

    which is k (e - d) where the other end is in balance. An end that has been visited before in
    this sweep, or does not move, counts as it is.

    Args:
        place: Of the node.
        sewn: Nodes with stitches.
        threads: The stitches.
        F: Force of the tissue on each sewn node [N], shape (s, 3).
        K: Stiffness of the tissue at each [N/m], shape (s,).
        moves: Which of them move, shape (s,).
        rest: Rest positions [m].
        u: Displacements [m].

    Returns:
        Force [N] and stiffness [N/m].
    """
    i = sewn.nodes[place]
    G0 = G1 = G2 = stiff = 0.0
    for at in range(sewn.start[place], sewn.start[place + 1]):
        s, there = sewn.thread[at], sewn.other[at]
        j, k = sewn.nodes[there], threads.stiffness[s]
        p0, p1, p2, taut, _ = _excess(i, j, k, threads.length[s], rest, u)
        if not taut:
            continue
        if there > place and moves[there]:
            f0, f1, f2, Kj = F[there, 0], F[there, 1], F[there, 2], K[there]
            for besides in range(sewn.start[there], sewn.start[there + 1]):
                t = sewn.thread[besides]
                if t == s:
                    continue
                m, kt = sewn.nodes[sewn.other[besides]], threads.stiffness[t]
                q0, q1, q2, also, _ = _excess(j, m, kt, threads.length[t], rest, u)
                f0, f1, f2 = f0 + q0, f1 + q1, f2 + q2
                Kj += kt if also else 0.0
            soft = Kj / (k + Kj)
            p0 = soft * p0 + k * f0 / (k + Kj)
            p1 = soft * p1 + k * f1 / (k + Kj)
            p2 = soft * p2 + k * f2 / (k + Kj)
            k *= soft
        G0, G1, G2 = G0 + p0, G1 + p1, G2 + p2
        stiff += k
    return G0, G1, G2, stiff


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def sweep_sewn(
    sewn: Sewn,
    threads: Threads,
    springs: SpringArrays,
    moves: NDArray[np.bool_],
    more: NDArray[np.float64],
    stiffer: NDArray[np.float64],
    F: NDArray[np.float64],
    K: NDArray[np.float64],
    rest: NDArray[np.float64],
    tiny: np.floating,
    u: NDArray[np.floating],
) -> float:
    """One Gauss-Seidel sweep over sewn nodes with springs. Modifies `u` in place.

    Args:
        sewn: Nodes with stitches.
        threads: The stitches.
        springs: Springs by node.
        moves: Which of the nodes move, shape (s,).
        more: Other forces of the tissue on them [N], shape (s, 3).
        stiffer: What those add to their stiffness [N/m], shape (s,).
        F: Scratch, shape (s, 3).
        K: Scratch, shape (s,).
        rest: Rest positions [m], shape (node_capacity, 3).
        tiny: `TINY` in the precision of `u`.
        u: Displacements [m], shape (node_capacity, 3).

    Returns:
        Largest squared distance a node moved [m^2].
    """
    largest = 0.0
    count = len(sewn.nodes)
    for place in range(count):
        f0, f1, f2, k, _ = _pull(sewn.nodes[place], springs, u, tiny)
        F[place, 0], F[place, 1] = f0 + more[place, 0], f1 + more[place, 1]
        F[place, 2], K[place] = f2 + more[place, 2], k + stiffer[place]
    for place in range(count):
        i = sewn.nodes[place]
        if not moves[place] or springs.degree[i] == 0:
            continue
        # A neighbour may have been visited.
        f0, f1, f2, _, _ = _pull(i, springs, u, tiny)
        g0, g1, g2, stiff = aim(place, sewn, threads, F, K, moves, rest, u)
        step = 1.0 / (K[place] + stiff)
        d0 = step * (f0 + more[place, 0] + g0)
        d1 = step * (f1 + more[place, 1] + g1)
        d2 = step * (f2 + more[place, 2] + g2)
        u[i, 0] += d0
        u[i, 1] += d1
        u[i, 2] += d2
        largest = max(largest, d0 * d0 + d1 * d1 + d2 * d2)
    return largest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def aim_all(
    sewn: Sewn,
    threads: Threads,
    begin: int,
    end: int,
    F: NDArray[np.float64],
    K: NDArray[np.float64],
    moves: NDArray[np.bool_],
    rest: NDArray[np.float64],
    u: NDArray[np.floating],
    out: NDArray[np.float64],
) -> None:
    """`aim` at places [begin, end). Writes force and stiffness into `out`, shape (s, 4)."""
    for place in range(begin, end):
        g0, g1, g2, k = aim(place, sewn, threads, F, K, moves, rest, u)
        out[place, 0], out[place, 1], out[place, 2], out[place, 3] = g0, g1, g2, k


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def limit_threads(
    threads: Threads,
    limits: NDArray[np.float64],
    rest: NDArray[np.float64],
    prescribed: NDArray[np.bool_],
    u: NDArray[np.floating],
) -> float:
    """Put every stitch longer than its limit at it, half by each end that may move.

    Modifies `u` in place.

    Args:
        threads: The stitches.
        limits: Longest length of each [m]; infinite: none.
        rest: Rest positions [m], shape (node_capacity, 3).
        prescribed: Nodes that do not move, shape (node_capacity,).
        u: Displacements [m], shape (node_capacity, 3).

    Returns:
        Largest squared distance a node moved [m^2].
    """
    largest = 0.0
    for s in range(len(limits)):
        a, b = threads.ends[s, 0], threads.ends[s, 1]
        if prescribed[a] and prescribed[b]:
            continue
        p0, p1, p2, beyond, _ = _excess(a, b, 1.0, limits[s], rest, u)
        if not beyond:
            continue
        of_a = 0.0 if prescribed[a] else 1.0 if prescribed[b] else 0.5
        of_b = 1.0 - of_a
        u[a, 0] += of_a * p0
        u[a, 1] += of_a * p1
        u[a, 2] += of_a * p2
        u[b, 0] -= of_b * p0
        u[b, 1] -= of_b * p1
        u[b, 2] -= of_b * p2
        squared = p0 * p0 + p1 * p1 + p2 * p2
        largest = max(largest, max(of_a, of_b) ** 2 * squared)
    return largest
