"""Loops of conjugate gradients on a problem whose matrix and right-hand side change on the way.

Symbols: W the tangent, x the shape [m], r = f - W (x - x_0) the residual [N], z the preconditioned
residual [m], p the direction, q = W p.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST
from tissue_sim.kernels.stiffness import BlockRows, Vectors


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def follow_held(
    held: NDArray[np.int32],
    u: NDArray[np.floating],
    rows: BlockRows,
    prescribed: NDArray[np.bool_],
    vectors: Vectors,
) -> float:
    """Take over the places of held nodes; what that does to the free nodes beside them.

    x of held nodes and r of free nodes are modified in place.

    Returns:
        The largest squared move of a held node [m^2].
    """
    largest = 0.0
    x, r, blocks = vectors.x, vectors.r, rows.blocks
    for node in held:
        d0, d1, d2 = u[node, 0] - x[node, 0], u[node, 1] - x[node, 1], u[node, 2] - x[node, 2]
        squared = np.float64(d0 * d0 + d1 * d1 + d2 * d2)
        if squared == 0.0:
            continue
        largest = max(largest, squared)
        for k in range(3):
            x[node, k] = u[node, k]
        first = np.int64(rows.start[node])
        for place in range(first, first + np.int64(rows.degree[node])):
            j = rows.neighbour[place]
            if prescribed[j]:
                continue
            b = blocks[place]
            # W_ji is the transpose of W_ij.
            r[j, 0] -= b[0] * d0 + b[3] * d1 + b[6] * d2
            r[j, 1] -= b[1] * d0 + b[4] * d1 + b[7] * d2
            r[j, 2] -= b[2] * d0 + b[5] * d1 + b[8] * d2
    return largest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def next_conjugate_direction(count: int, pq: float, vectors: Vectors) -> tuple[float, float]:
    """P = z - (z . q) / pq p, conjugate to the last p whatever has become of r. Modifies p.

    Returns:
        r . p and the largest squared p of a node.
    """
    _, r, z, p, q = vectors
    dot = 0.0
    for i in range(count):
        dot += z[i, 0] * q[i, 0] + z[i, 1] * q[i, 1] + z[i, 2] * q[i, 2]
    b = p.dtype.type(-dot / pq if pq > 0.0 else 0.0)
    slope = widest = 0.0
    for i in range(count):
        p0, p1, p2 = z[i, 0] + b * p[i, 0], z[i, 1] + b * p[i, 1], z[i, 2] + b * p[i, 2]
        p[i, 0], p[i, 1], p[i, 2] = p0, p1, p2
        slope += r[i, 0] * p0 + r[i, 1] * p1 + r[i, 2] * p2
        widest = max(widest, np.float64(p0 * p0 + p1 * p1 + p2 * p2))
    return slope, widest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def subtract(
    count: int, x: NDArray[np.floating], y: NDArray[np.floating], out: NDArray[np.floating]
) -> float:
    """Write x - y to `out`.

    Returns:
        The largest squared component.
    """
    largest = 0.0
    for i in range(count):
        for k in range(3):
            d = x[i, k] - y[i, k]
            out[i, k] = d
            largest = max(largest, np.float64(d * d))
    return largest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def residual_from(
    count: int,
    prescribed: NDArray[np.bool_],
    f: NDArray[np.float64],
    q: NDArray[np.floating],
    r: NDArray[np.floating],
) -> float:
    """R = f - q in free nodes, zero in prescribed ones. Writes `r`.

    Returns:
        The sum of the squared forces on prescribed nodes [N^2].
    """
    total = 0.0
    for i in range(count):
        if prescribed[i]:
            total += f[i, 0] ** 2 + f[i, 1] ** 2 + f[i, 2] ** 2
            r[i, 0] = r[i, 1] = r[i, 2] = 0.0
            continue
        for k in range(3):
            r[i, k] = f[i, k] - q[i, k]
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def largest_squared(count: int, x: NDArray[np.floating]) -> float:
    """The largest squared row of x, shape (node_capacity, 3)."""
    largest = 0.0
    for i in range(count):
        largest = max(largest, np.float64(x[i, 0] ** 2 + x[i, 1] ** 2 + x[i, 2] ** 2))
    return largest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def step_back(
    count: int,
    share: float,
    prescribed: NDArray[np.bool_],
    from_: NDArray[np.floating],
    to: NDArray[np.floating],
    x: NDArray[np.floating],
) -> None:
    """X = from + share (to - from) in free nodes. Writes `x`."""
    s = x.dtype.type(share)
    for i in range(count):
        if not prescribed[i]:
            for k in range(3):
                x[i, k] = from_[i, k] + s * (to[i, k] - from_[i, k])
