"""Minimising an elastic energy in one node's position at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.mixed_matter import mixed_energy, mixed_response
from tissue_sim.kernels.neo_hookean import Constants, corner_energy, corner_response
from tissue_sim.kernels.springs import FAST
from tissue_sim.kernels.vertex_blocks import VertexBlocks

NEWTON_STEPS = 8
"""Most Newton steps for one node where its energy is far from quadratic."""

HALVINGS = 60
"""Most halvings of such a step: 2^-60 of it is nothing."""

ENOUGH = 1e-4
"""Share of the decrease that the slope promises and a step must bring (Armijo's rule)."""


class Inertia(NamedTuple):
    """Inertia of implicit Euler's step: m/h^2 |u - target|^2 / 2; zero in statics.

    Attributes:
        factor: m/h^2 of each node [N/m], shape (node_capacity,).
        target: Where it would go without forces [m], shape (node_capacity, 3).
    """

    factor: NDArray[np.floating]
    target: NDArray[np.floating]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def gather(lanes, at, corners, u, i, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Displacements of the other corners relative to node i, nine rows of `out`."""
    u0, u1, u2 = u[i, 0], u[i, 1], u[i, 2]
    two = lanes + lanes
    three = two + lanes
    first, second, third = at, at + lanes, at + two
    six = three + three
    for k in range(lanes):
        j = corners[first + k]
        out[k], out[lanes + k], out[two + k] = u[j, 0] - u0, u[j, 1] - u1, u[j, 2] - u2
        j, p = corners[second + k], three + k
        out[p], out[p + lanes], out[p + two] = u[j, 0] - u0, u[j, 1] - u1, u[j, 2] - u2
        j, p = corners[third + k], six + k
        out[p], out[p + lanes], out[p + two] = u[j, 0] - u0, u[j, 1] - u1, u[j, 2] - u2


@njit(inline="always", error_model="numpy", fastmath=FAST)
def solve(F0, F1, F2, K00, K01, K02, K11, K12, K22, zero):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """K^-1 F and det K / tr^3 K; nothing where the matrix is singular."""
    A00, A01, A02 = K11 * K22 - K12 * K12, K02 * K12 - K01 * K22, K01 * K12 - K02 * K11
    det = K00 * A00 + K01 * A01 + K02 * A02
    trace = K00 + K11 + K22
    cube = trace * trace * trace
    if not det > zero:
        return zero, zero, zero, zero
    A11, A12, A22 = K00 * K22 - K02 * K02, K01 * K02 - K00 * K12, K00 * K11 - K01 * K01
    x0 = (A00 * F0 + A01 * F1 + A02 * F2) / det
    x1 = (A01 * F0 + A11 * F1 + A12 * F2) / det
    x2 = (A02 * F0 + A12 * F1 + A22 * F2) / det
    return x0, x1, x2, det / cube


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _lane(k, lanes, at, gradients, w, e0, e1, e2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Corners relative to the node moved by e, gradients and volume of one element, in doubles."""
    g = at + k
    volume = np.float64(gradients[g + 9 * lanes])
    return (
        (w[k] - e0, w[lanes + k] - e1, w[2 * lanes + k] - e2),
        (w[3 * lanes + k] - e0, w[4 * lanes + k] - e1, w[5 * lanes + k] - e2),
        (w[6 * lanes + k] - e0, w[7 * lanes + k] - e1, w[8 * lanes + k] - e2),
        (
            np.float64(gradients[g]),
            np.float64(gradients[g + lanes]),
            np.float64(gradients[g + 2 * lanes]),
        ),
        (
            np.float64(gradients[g + 3 * lanes]),
            np.float64(gradients[g + 4 * lanes]),
            np.float64(gradients[g + 5 * lanes]),
        ),
        (
            np.float64(gradients[g + 6 * lanes]),
            np.float64(gradients[g + 7 * lanes]),
            np.float64(gradients[g + 8 * lanes]),
        ),
        volume,
    )


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def node_energy(lanes, at, gradients, w, e0, e1, e2, material):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Elastic energy of a node's elements once it has moved by e [J]."""
    total = 0.0
    for k in range(lanes):
        a, b, c, ga, gb, gc, V = _lane(k, lanes, at, gradients, w, e0, e1, e2)
        total += corner_energy(a, b, c, ga, gb, gc, V, material)
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _response(lanes, at, gradients, w, e0, e1, e2, material):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    F0 = F1 = F2 = K00 = K01 = K02 = K11 = K12 = K22 = 0.0
    for k in range(lanes):
        a, b, c, ga, gb, gc, V = _lane(k, lanes, at, gradients, w, e0, e1, e2)
        f0, f1, f2, k00, k01, k02, k11, k12, k22, _ = corner_response(
            a, b, c, ga, gb, gc, V, material
        )
        F0, F1, F2 = F0 + f0, F1 + f1, F2 + f2
        K00, K01, K02 = K00 + k00, K01 + k01, K02 + k02
        K11, K12, K22 = K11 + k11, K12 + k12, K22 + k22
    return F0, F1, F2, K00, K01, K02, K11, K12, K22


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def unfold_at(
    i: int, blocks: VertexBlocks, u: NDArray[np.floating], w: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Move of node i [m] to the mean displacement of its elements' other corners, by volume."""
    lanes, at = np.int64(blocks.lanes[i]), 10 * np.int64(blocks.start[i])
    gather(lanes, 3 * np.int64(blocks.start[i]), blocks.corners, u, i, w)
    e0 = e1 = e2 = 0.0
    volume = 1e-300
    for k in range(lanes):
        V = np.float64(blocks.gradients[at + 9 * lanes + k])
        e0 += V * (w[k] + w[3 * lanes + k] + w[6 * lanes + k])
        e1 += V * (w[lanes + k] + w[4 * lanes + k] + w[7 * lanes + k])
        e2 += V * (w[2 * lanes + k] + w[5 * lanes + k] + w[8 * lanes + k])
        volume += 3.0 * V
    return e0 / volume, e1 / volume, e2 / volume


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _energy(i, blocks, w, e0, e1, e2, material):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Elastic energy of the elements of node i once it has moved by e [J], fibres included."""
    lanes, start = np.int64(blocks.lanes[i]), np.int64(blocks.start[i])
    energy = node_energy(lanes, 10 * start, blocks.gradients, w, e0, e1, e2, material)
    if len(blocks.matter) > 0:
        energy += mixed_energy(lanes, start, blocks.gradients, blocks.matter, w, e0, e1, e2)
    return energy


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def minimise_at(
    i: int,
    blocks: VertexBlocks,
    u: NDArray[np.floating],
    inertia: Inertia,
    material: Constants,
    w: NDArray[np.float64],
) -> tuple[float, float, float]:
    """Move of node i [m] towards the minimum of the energy in its position.

    Newton's method with steps halved until the energy decreases, in double precision. Without
    fibres the function is convex, so that it finds the minimum from anywhere; it is for nodes whose
    elements are crushed or move by much of their size, where one Newton step cannot be trusted.

    Args:
        i: Row of the node.
        blocks: Elements by node.
        u: Displacements [m].
        inertia: Inertia, zero in statics.
        material: Constants, in double precision.
        w: Scratch, nine times the most lanes of a node.
    """
    lanes, at = np.int64(blocks.lanes[i]), 10 * np.int64(blocks.start[i])
    gather(lanes, 3 * np.int64(blocks.start[i]), blocks.corners, u, i, w)
    m, rows = np.float64(inertia.factor[i]), blocks.matter
    y0 = np.float64(inertia.target[i, 0]) - u[i, 0]
    y1 = np.float64(inertia.target[i, 1]) - u[i, 1]
    y2 = np.float64(inertia.target[i, 2]) - u[i, 2]
    floor = 1e-12 * (material.shear * blocks.shear[i] + m)
    e0 = e1 = e2 = 0.0
    for _ in range(NEWTON_STEPS):
        F0, F1, F2, K00, K01, K02, K11, K12, K22 = _response(
            lanes, at, blocks.gradients, w, e0, e1, e2, material
        )
        if len(rows) > 0:
            f0, f1, f2, k00, k01, k02, k11, k12, k22 = mixed_response(
                lanes, blocks.start[i], blocks.gradients, rows, w, e0, e1, e2
            )
            F0, F1, F2 = F0 + f0, F1 + f1, F2 + f2
            K00, K01, K02 = K00 + k00, K01 + k01, K02 + k02
            K11, K12, K22 = K11 + k11, K12 + k12, K22 + k22
        F0, F1, F2 = F0 + m * (y0 - e0), F1 + m * (y1 - e1), F2 + m * (y2 - e2)
        more = m + floor + 1e-9 * (K00 + K11 + K22)
        d0, d1, d2, _ = solve(F0, F1, F2, K00 + more, K01, K02, K11 + more, K12, K22 + more, 0.0)
        slope = F0 * d0 + F1 * d1 + F2 * d2
        if not slope > 0.0:
            break
        before = _energy(i, blocks, w, e0, e1, e2, material)
        before += 0.5 * m * ((e0 - y0) ** 2 + (e1 - y1) ** 2 + (e2 - y2) ** 2)
        t, halvings = 1.0, 0
        while halvings < HALVINGS:
            n0, n1, n2 = e0 + t * d0, e1 + t * d1, e2 + t * d2
            after = _energy(i, blocks, w, n0, n1, n2, material)
            after += 0.5 * m * ((n0 - y0) ** 2 + (n1 - y1) ** 2 + (n2 - y2) ** 2)
            if after <= before - ENOUGH * t * slope:
                e0, e1, e2 = n0, n1, n2
                break
            t *= 0.5
            halvings += 1
        moved = d0 * d0 + d1 * d1 + d2 * d2
        if halvings == HALVINGS or (t == 1.0 and moved < 1e-4 * (e0 * e0 + e1 * e1 + e2 * e2)):
            break
    return e0, e1, e2
