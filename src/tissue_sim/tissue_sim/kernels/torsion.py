"""Loops over torsion springs: the angle between two triangles that share an edge.

Symbols: a, b the nodes of the edge, e = x_b - x_a, c and d the opposite nodes, n = e x (x_c - x_a)
and m = (x_d - x_a) x e the normals of the two triangles as long as twice their area, t the angle
from n to m about e, t0 that at rest, k stiffness [N m/rad]. The energy is k (t - t0)^2 / 2 and

    dt/dx_c = -|e| n / |n|^2,                dt/dx_d = -|e| m / |m|^2,
    dt/dx_a = -(1 - p) dt/dx_c - (1 - q) dt/dx_d,    dt/dx_b = -p dt/dx_c - q dt/dx_d,

p and q being where the feet of c and d lie along the edge, 0 at a and 1 at b. The four gradients
have no sum and no moment, so that momentum is kept whatever the angle.

As for springs, edges are differences at rest plus differences of displacements: tissue moved
without turning has the angles that it has at rest. What rounding makes of the angles of turned
tissue lies below a threshold that is taken off every change of angle.

References:
    E. Grinspun and others, Discrete shells, 2003, doi 10.2312/SCA03/062-067; H. Seung and
    D. Nelson, Defects in flexible membranes with crystalline order, 1988,
    doi 10.1103/PhysRevA.38.1005.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST, TAUT, SpringArrays, _pull

THRESHOLD = {np.float32: 2e-5, np.float64: 1e-12}
"""Change of an angle [rad] that counts as rounding, by precision."""

LEAST_AREA = 0.05
"""Share of its area at rest below which a triangle's forces grow no further as it collapses."""


class Hinges(NamedTuple):
    """Torsion springs, as kernels read them.

    Attributes:
        start: Where a node's list begins in `entry`, shape (node_capacity,), int64.
        degree: Length of each list, shape (node_capacity,), int32.
        entry: Rows of the torsion springs at each node, int32.
        nodes: a, b, c and d of each, int32, shape (h, 4); all 0 in a row without a spring, whose
            stiffness is 0.
        stiffness: k [N m/rad], shape (h,).
        angle: t0 [rad], shape (h,).
        least: Least |n|^2 and |m|^2 that forces are computed with [m^4], shape (h, 2).
        threshold: Change of an angle that counts as none [rad].
    """

    start: NDArray[np.int64]
    degree: NDArray[np.int32]
    entry: NDArray[np.int32]
    nodes: NDArray[np.int32]
    stiffness: NDArray[np.floating]
    angle: NDArray[np.floating]
    least: NDArray[np.floating]
    threshold: np.floating


@njit(error_model="numpy", fastmath=FAST)
def _edge(rest, u, i, j):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return (
        (rest[j, 0] - rest[i, 0]) + (u[j, 0] - u[i, 0]),
        (rest[j, 1] - rest[i, 1]) + (u[j, 1] - u[i, 1]),
        (rest[j, 2] - rest[i, 2]) + (u[j, 2] - u[i, 2]),
    )


@njit(error_model="numpy", fastmath=FAST)
def _cross(a, b):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(error_model="numpy", fastmath=FAST)
def _dot(a, b):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(error_model="numpy", fastmath=FAST)
def _fold(rest, u, nodes, row, tiny):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Angle t [rad], e, n, m, |e|, p and q of a torsion spring."""
    a, b, c, d = nodes[row, 0], nodes[row, 1], nodes[row, 2], nodes[row, 3]
    e = _edge(rest, u, a, b)
    to_c, to_d = _edge(rest, u, a, c), _edge(rest, u, a, d)
    n, m = _cross(e, to_c), _cross(to_d, e)
    squared = _dot(e, e) + tiny
    length = np.sqrt(squared)
    angle = math.atan2(_dot(_cross(n, m), e), _dot(n, m) * length)
    return angle, n, m, length, _dot(to_c, e) / squared, _dot(to_d, e) / squared


@njit(error_model="numpy", fastmath=FAST)
def _change(hinges, row, angle):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Change of the angle from rest [rad], the shorter way round, less the threshold."""
    zero = angle - angle
    change = angle - hinges.angle[row]
    if change > math.pi:
        change -= 2.0 * math.pi
    elif change < -math.pi:
        change += 2.0 * math.pi
    if change > hinges.threshold:
        return zero + (change - hinges.threshold)
    if change < -hinges.threshold:
        return zero + (change + hinges.threshold)
    return zero


@njit(error_model="numpy", fastmath=FAST)
def _at_place(place, c, d, p, q, n, m):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """dt/dx of the node at a place: c n + d m for the opposite nodes, their shares for others."""
    if place == 0:
        c, d = -(1 - p) * c, -(1 - q) * d
    elif place == 1:
        c, d = -p * c, -q * d
    elif place == 2:
        d = d - d
    else:
        c = c - c
    return c * n[0] + d * m[0], c * n[1] + d * m[1], c * n[2] + d * m[2]


@njit(error_model="numpy", fastmath=FAST)
def _turn(i, springs, hinges, u, tiny):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Force of the torsion springs on node i [N], and what they resist [N/m]."""
    rest = springs.rest
    F0 = F1 = F2 = K = tiny - tiny
    for at in range(hinges.start[i], hinges.start[i] + hinges.degree[i]):
        row, place = hinges.entry[at], 0
        while hinges.nodes[row, place] != i:
            place += 1
        angle, n, m, length, p, q = _fold(rest, u, hinges.nodes, row, tiny)
        change = _change(hinges, row, angle)
        c = -length / max(_dot(n, n), hinges.least[row, 0])
        d = -length / max(_dot(m, m), hinges.least[row, 1])
        g = _at_place(place, c, d, p, q, n, m)
        k = hinges.stiffness[row]
        F0 -= k * change * g[0]
        F1 -= k * change * g[1]
        F2 -= k * change * g[2]
        K += k * _dot(g, g) * (1 + abs(change))
    return F0, F1, F2, K


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def measure_angles(
    rest: NDArray[np.floating],
    u: NDArray[np.floating],
    nodes: NDArray[np.int32],
    tiny: np.floating,
    out: NDArray[np.floating],
) -> None:
    """Angles t of torsion springs [rad]. Writes `out`, shape (h,)."""
    for row in range(len(nodes)):
        out[row] = _fold(rest, u, nodes, row, tiny)[0]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def sweep_folded_nodes(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    springs: SpringArrays,
    hinges: Hinges,
    prescribed: NDArray[np.bool_],
    step: np.floating,
    momentum: np.floating,
    tiny: np.floating,
    u: NDArray[np.floating],
    last_move: NDArray[np.floating],
) -> np.floating:
    """`kernels.springs.sweep_nodes_with_momentum` with torsion springs; momentum may be 0.

    Modifies `u` and `last_move` [m], shape (node_capacity, 3), in place.

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
    largest = tiny - tiny
    taut = TAUT if momentum > largest else 0.0
    for place in range(begin, end):
        i = nodes[place]
        if prescribed[i] or springs.degree[i] == 0:
            continue
        F0, F1, F2, K, across = _pull(i, springs, u, tiny)
        T0, T1, T2, turning = _turn(i, springs, hinges, u, tiny)
        scale = step / (K + turning + taut * across)
        F0, F1, F2 = (F0 + T0) * scale, (F1 + T1) * scale, (F2 + T2) * scale
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
def largest_folded_force(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    springs: SpringArrays,
    hinges: Hinges,
    prescribed: NDArray[np.bool_],
    u: NDArray[np.floating],
    tiny: np.floating,
) -> tuple[np.floating, np.floating]:
    """`kernels.springs.largest_force` with torsion springs."""
    largest = largest_step = tiny - tiny
    for place in range(begin, end):
        i = nodes[place]
        if not prescribed[i] and springs.degree[i] > 0:
            F0, F1, F2, K, _ = _pull(i, springs, u, tiny)
            T0, T1, T2, turning = _turn(i, springs, hinges, u, tiny)
            F0, F1, F2 = F0 + T0, F1 + T1, F2 + T2
            squared = F0 * F0 + F1 * F1 + F2 * F2
            largest = max(largest, squared)
            largest_step = max(largest_step, squared / (K + turning) ** 2)
    return largest, largest_step


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_torsion_at(
    nodes: NDArray[np.int32],
    springs: SpringArrays,
    hinges: Hinges,
    u: NDArray[np.floating],
    tiny: np.floating,
    out: NDArray[np.float64],
) -> None:
    """Add the force of the torsion springs on nodes [N] to `out`, shape (len(nodes), 3)."""
    for place in range(len(nodes)):
        F0, F1, F2, _ = _turn(nodes[place], springs, hinges, u, tiny)
        out[place, 0] += F0
        out[place, 1] += F1
        out[place, 2] += F2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_torsion_forces(
    springs: SpringArrays,
    hinges: Hinges,
    tiny: np.floating,
    u: NDArray[np.floating],
    F: NDArray[np.floating],
) -> None:
    """Add the forces of all torsion springs [N] to `F`, shape (node_capacity, 3)."""
    for row in range(len(hinges.nodes)):
        angle, n, m, length, p, q = _fold(springs.rest, u, hinges.nodes, row, tiny)
        change = _change(hinges, row, angle)
        if change == tiny - tiny:
            continue
        pull = hinges.stiffness[row] * change
        c = -length / max(_dot(n, n), hinges.least[row, 0])
        d = -length / max(_dot(m, m), hinges.least[row, 1])
        for place in range(4):
            g = _at_place(place, c, d, p, q, n, m)
            node = hinges.nodes[row, place]
            F[node, 0] -= pull * g[0]
            F[node, 1] -= pull * g[1]
            F[node, 2] -= pull * g[2]
