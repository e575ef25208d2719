"""Loops over springs: node sweeps and forces.

Symbols: X rest position [m], u displacement [m], D = X_j - X_i, w = u_j - u_i, e = D + w the
present edge, l = |e| its length, l0 = |D|, k stiffness [N/m]. Lengths are never subtracted from
each other:

    l^2 - l0^2 = (2 D + w) . w = q,    so    l - l0 = q / (l + l0),

which is exact to round-off for small displacements in single precision and exactly zero when w is
zero: tissue at rest, or moved without turning, has no force bit for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.vectors import (
    LANES,
    fetch_points,
    first_lanes,
    load,
    prefetch,
    root,
    select,
    splat,
    total,
)

FAST = {"contract", "nnan", "ninf", "nsz", "arcp"}
"""No `reassoc`: it turns the loops over neighbours into slow hardware gathers."""

TINY = {np.float32: 1e-30, np.float64: 1e-200}
"""Squared length [m^2] that counts as none, by precision.

Two nodes in one place pull in no direction instead of dividing by zero.
"""


TAUT = 0.5
"""How much taut springs shorten the step of a node with momentum.

Near rest the curvature of a node's energy is about a third of the sum of its stiffnesses; where all
springs are stretched far it is the sum, and momentum is stable for steps below 1.33 only.
"""


class SpringArrays(NamedTuple):
    """Springs by node, as kernels read them.

    Attributes:
        rest: Rest positions relative to a fixed origin [m], shape (node_capacity, 3), the kernel's
            precision.
        start: Where a node's list begins in `neighbour`, `stiffness` and `length`, shape
            (node_capacity,), uint32.
        degree: Length of the list, shape (node_capacity,), uint32.
        neighbour: Node at the other end, uint32. Behind the last list there is room for eight more
            entries, which are read though nothing depends on them.
        stiffness: k [N/m].
        length: l0 [m].
    """

    rest: NDArray[np.floating]
    start: NDArray[np.uint32]
    degree: NDArray[np.uint32]
    neighbour: NDArray[np.uint32]
    stiffness: NDArray[np.floating]
    length: NDArray[np.floating]


AHEAD = 2
"""Nodes between asking for a list and reading it."""


@njit(inline="always")
def _fetch_ahead(i, start, neighbour, stiffness, length):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Ask for a node's lists: they lie by row, not in the order of the sweep, and come late."""
    at = np.int64(start[i])
    prefetch(neighbour, at)
    prefetch(stiffness, at)
    prefetch(length, at)


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _pull(i, springs, u, tiny):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Internal force on node i [N]; what its springs resist [N/m] along and, if taut, across.

    Eight springs at once; what is behind the end of the list, other nodes' springs, counts nothing.
    """
    rest, start, degree, neighbour, stiffness, length = springs
    zero = tiny - tiny
    X0, X1, X2 = rest[i, 0], rest[i, 1], rest[i, 2]
    u0, u1, u2 = u[i, 0], u[i, 1], u[i, 2]
    F0 = F1 = F2 = K = across = splat(zero)
    begin, many = np.int64(start[i]), np.int64(degree[i])
    for past in range(0, many, LANES):
        at = begin + past
        w0, w1, w2 = fetch_points(u, neighbour, at)
        w0, w1, w2 = w0 - u0, w1 - u1, w2 - u2
        D0, D1, D2 = fetch_points(rest, neighbour, at)
        D0, D1, D2 = D0 - X0, D1 - X1, D2 - X2
        e0, e1, e2 = D0 + w0, D1 + w1, D2 + w2
        q = (D0 + e0) * w0 + (D1 + e1) * w1 + (D2 + e2) * w2
        length_now = root(e0 * e0 + e1 * e1 + e2 * e2 + tiny)
        k = first_lanes(load(stiffness, at), many - past)
        pull = k * q / (length_now * (length_now + load(length, at)))
        F0, F1, F2 = F0 + pull * e0, F1 + pull * e1, F2 + pull * e2
        K = K + k
        across = across + select(pull > zero, pull, zero)  # k (1 - l0/l)
    return total(F0), total(F1), total(F2), total(K), total(across)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def sweep_nodes(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    springs: SpringArrays,
    prescribed: NDArray[np.bool_],
    step: np.floating,
    force_step: np.floating,
    tiny: np.floating,
    u: NDArray[np.floating],
) -> np.floating:
    """One Gauss-Seidel sweep u_i += (step / sum_j k_ij + force_step) F_i over nodes[begin:end].

    Modifies `u` in place.

    The sum of a node's stiffnesses bounds the curvature of the elastic energy in that node's
    position wherever it is, so that no node's step with 0 < step < 2 can raise the energy: without
    a `force_step` [m/N], which nothing bounds, the sweep is stable without tuning.

    Returns:
        Largest squared distance a node moved [m^2].
    """
    _, start, degree, neighbour, stiffness, length = springs
    largest = tiny - tiny
    for place in range(begin, end):
        i = nodes[place]
        if place + AHEAD < end:
            _fetch_ahead(nodes[place + AHEAD], start, neighbour, stiffness, length)
        if prescribed[i] or degree[i] == 0:
            continue
        F0, F1, F2, K, _ = _pull(i, springs, u, tiny)
        scale = step / K + force_step
        F0, F1, F2 = F0 * scale, F1 * scale, F2 * scale
        squared = F0 * F0 + F1 * F1 + F2 * F2
        # Below 1e-15 m nothing moves: the front of a disturbance would fill with denormal numbers,
        # which are slow.
        if squared > tiny:
            u[i, 0] += F0
            u[i, 1] += F1
            u[i, 2] += F2
            largest = max(largest, squared)
    return largest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def sweep_nodes_with_momentum(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    springs: SpringArrays,
    prescribed: NDArray[np.bool_],
    step: np.floating,
    momentum: np.floating,
    tiny: np.floating,
    u: NDArray[np.floating],
    last_move: NDArray[np.floating],
) -> np.floating:
    """A sweep as `sweep_nodes`, before which every node repeats a share of its last move.

    All move before any force is computed: a node that went ahead alone would be pulled back by
    neighbours that have yet to follow. Modifies `u` and `last_move` [m], shape (node_capacity, 3),
    in place.

    Returns:
        Largest squared distance a node moved [m^2].
    """
    for place in range(begin, end):
        i = nodes[place]
        if prescribed[i]:
            continue
        for axis in range(3):
            move = momentum * last_move[i, axis]
            # Denormal numbers are slow.
            last_move[i, axis] = move if move * move > tiny else tiny - tiny
            u[i, axis] += last_move[i, axis]
    _, start, degree, neighbour, stiffness, length = springs
    largest = tiny - tiny
    for place in range(begin, end):
        i = nodes[place]
        if place + AHEAD < end:
            _fetch_ahead(nodes[place + AHEAD], start, neighbour, stiffness, length)
        if prescribed[i] or degree[i] == 0:
            continue
        F0, F1, F2, K, across = _pull(i, springs, u, tiny)
        scale = step / (K + TAUT * across)
        F0, F1, F2 = F0 * scale, F1 * scale, F2 * scale
        if tiny < F0 * F0 + F1 * F1 + F2 * F2:
            u[i, 0] += F0
            u[i, 1] += F1
            u[i, 2] += F2
            last_move[i, 0] += F0
            last_move[i, 1] += F1
            last_move[i, 2] += F2
        v0, v1, v2 = last_move[i, 0], last_move[i, 1], last_move[i, 2]
        largest = max(largest, v0 * v0 + v1 * v1 + v2 * v2)
    return largest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def node_forces(
    nodes: NDArray[np.int32],
    springs: SpringArrays,
    u: NDArray[np.floating],
    tiny: np.floating,
    out: NDArray[np.float64],
) -> None:
    """Internal forces on nodes [N]. Writes `out`, shape (len(nodes), 3)."""
    for place in range(len(nodes)):
        F0, F1, F2, _, _ = _pull(nodes[place], springs, u, tiny)
        out[place, 0], out[place, 1], out[place, 2] = F0, F1, F2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def largest_force(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    springs: SpringArrays,
    prescribed: NDArray[np.bool_],
    u: NDArray[np.floating],
    tiny: np.floating,
) -> tuple[np.floating, np.floating]:
    """Largest squared F_i [N^2] and F_i / sum_j k_ij [m^2] of free nodes in nodes[begin:end]."""
    largest = largest_step = tiny - tiny
    for place in range(begin, end):
        i = nodes[place]
        if not prescribed[i] and springs.degree[i] > 0:
            F0, F1, F2, K, _ = _pull(i, springs, u, tiny)
            squared = F0 * F0 + F1 * F1 + F2 * F2
            largest = max(largest, squared)
            largest_step = max(largest_step, squared / (K * K))
    return largest, largest_step
