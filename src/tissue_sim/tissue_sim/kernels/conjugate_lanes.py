"""Loops of conjugate gradients for four right-hand sides: one sweep over the matrix for all.

Symbols as in `kernels.stiffness`; arrays of nodes have shape (node_capacity, 3, 4), the lane last.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.lanes import (
    add_product,
    add_scaled,
    add_wide,
    larger,
    load,
    minus,
    plus,
    product_of,
    store,
)
from tissue_sim.kernels.springs import FAST
from tissue_sim.kernels.stiffness import Aggregates, BlockRows, Vectors


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def product(
    count: int,
    rows: BlockRows,
    prescribed: NDArray[np.bool_],
    x: NDArray[np.floating],
    y: NDArray[np.floating],
    dots: NDArray[np.float64],
) -> None:
    """Y = K x in free nodes, zero in prescribed ones. Writes `y`, and x . y by lane to `dots`."""
    zero = x.dtype.type(0)
    zeros = (zero, zero, zero, zero)
    total = (0.0, 0.0, 0.0, 0.0)
    for i in range(count):
        y0 = y1 = y2 = zeros
        if not prescribed[i]:
            x0, x1, x2 = load(x, i, 0), load(x, i, 1), load(x, i, 2)
            y0, y1, y2 = _row(i, rows, x, x0, x1, x2, zeros)
            total = add_wide(total, _dot(x0, x1, x2, y0, y1, y2))
        store(y, i, 0, y0)
        store(y, i, 1, y1)
        store(y, i, 2, y2)
    dots[0], dots[1], dots[2], dots[3] = total


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _row(i, rows, x, x0, x1, x2, zeros):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """(K x)_i."""
    y0 = y1 = y2 = zeros
    begin = np.int64(rows.start[i])
    for place in range(begin, begin + np.int64(rows.degree[i])):
        j = rows.neighbour[place]
        d0 = minus(load(x, j, 0), x0)
        d1 = minus(load(x, j, 1), x1)
        d2 = minus(load(x, j, 2), x2)
        k = rows.blocks[place]
        y0 = add_scaled(add_scaled(add_scaled(y0, k[0], d0), k[1], d1), k[2], d2)
        y1 = add_scaled(add_scaled(add_scaled(y1, k[3], d0), k[4], d1), k[5], d2)
        y2 = add_scaled(add_scaled(add_scaled(y2, k[6], d0), k[7], d1), k[8], d2)
    return y0, y1, y2


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _dot(a0, a1, a2, b0, b1, b2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """a . b of one node, lane by lane."""  # noqa: D403
    return add_product(add_product(product_of(a0, b0), a1, b1), a2, b2)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def squared_forces(
    nodes: NDArray[np.int32],
    rows: BlockRows,
    x: NDArray[np.floating],
    out: NDArray[np.float64],
) -> None:
    """Sum of the squared internal forces on nodes [N^2], by lane. Writes `out`, shape (4,)."""
    zero = x.dtype.type(0)
    zeros = (zero, zero, zero, zero)
    total = (0.0, 0.0, 0.0, 0.0)
    for i in nodes:
        y0, y1, y2 = _row(i, rows, x, load(x, i, 0), load(x, i, 1), load(x, i, 2), zeros)
        total = add_wide(total, _dot(y0, y1, y2, y0, y1, y2))
    out[0], out[1], out[2], out[3] = total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def advance_solutions(
    count: int,
    steps: NDArray[np.floating],
    vectors: Vectors,
    aggregates: Aggregates,
    coarse: NDArray[np.floating],
    squared: NDArray[np.float64],
) -> None:
    """X += a p, r -= b q, and r summed over the aggregates' rigid motions.

    Args:
        count: Rows of nodes.
        steps: a and b by lane, shape (1, 2, 4); they differ where a solution begins.
        vectors: x and r are modified in place.
        aggregates: Parts that move as rigid bodies.
        coarse: Force and moment on each aggregate, shape (aggregates, 6, 4); written.
        squared: r . r by lane, shape (4,); written.
    """
    x, r, _, p, q = vectors
    aggregate, arms = aggregates
    coarse[:] = 0.0
    zero = x.dtype.type(0)
    norm = (0.0, 0.0, 0.0, 0.0)
    a, b = load(steps, 0, 0), minus((zero, zero, zero, zero), load(steps, 0, 1))
    for i in range(count):
        for c in range(3):
            store(x, i, c, add_product(load(x, i, c), a, load(p, i, c)))
        r0 = add_product(load(r, i, 0), b, load(q, i, 0))
        r1 = add_product(load(r, i, 1), b, load(q, i, 1))
        r2 = add_product(load(r, i, 2), b, load(q, i, 2))
        store(r, i, 0, r0)
        store(r, i, 1, r1)
        store(r, i, 2, r2)
        norm = add_wide(norm, _dot(r0, r1, r2, r0, r1, r2))
        g = aggregate[i]
        if g >= 0:
            s0, s1, s2 = arms[i, 0], arms[i, 1], arms[i, 2]
            store(coarse, g, 0, plus(load(coarse, g, 0), r0))
            store(coarse, g, 1, plus(load(coarse, g, 1), r1))
            store(coarse, g, 2, plus(load(coarse, g, 2), r2))
            store(coarse, g, 3, add_scaled(add_scaled(load(coarse, g, 3), s1, r2), -s2, r1))
            store(coarse, g, 4, add_scaled(add_scaled(load(coarse, g, 4), s2, r0), -s0, r2))
            store(coarse, g, 5, add_scaled(add_scaled(load(coarse, g, 5), s0, r1), -s1, r0))
    squared[0], squared[1], squared[2], squared[3] = norm


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def precondition(
    count: int,
    prescribed: NDArray[np.bool_],
    inverse: NDArray[np.floating],
    aggregates: Aggregates,
    coarse: NDArray[np.floating],
    vectors: Vectors,
    out: NDArray[np.float64],
) -> None:
    """Z = D^-1 r and the aggregates' rigid motions in free nodes. Modifies z in place.

    Args:
        count: Rows of nodes.
        prescribed: Nodes that do not move.
        inverse: Inverse diagonal blocks, shape (node_capacity, 9).
        aggregates: Parts that move as rigid bodies.
        coarse: What they do, shape (aggregates, 6, 4).
        vectors: r, and z, which is written.
        out: r . z, and the largest squared z of a node [m^2], by lane, shape (2, 4); written.
    """
    r, z = vectors.r, vectors.z
    aggregate, arms = aggregates
    zero = r.dtype.type(0)
    zeros = (zero, zero, zero, zero)
    largest = zeros
    dot = (0.0, 0.0, 0.0, 0.0)
    for i in range(count):
        z0 = z1 = z2 = zeros
        if not prescribed[i]:
            r0, r1, r2 = load(r, i, 0), load(r, i, 1), load(r, i, 2)
            d = inverse[i]
            z0 = add_scaled(add_scaled(add_scaled(zeros, d[0], r0), d[1], r1), d[2], r2)
            z1 = add_scaled(add_scaled(add_scaled(zeros, d[3], r0), d[4], r1), d[5], r2)
            z2 = add_scaled(add_scaled(add_scaled(zeros, d[6], r0), d[7], r1), d[8], r2)
            g = aggregate[i]
            if g >= 0:
                s0, s1, s2 = arms[i, 0], arms[i, 1], arms[i, 2]
                c3, c4, c5 = load(coarse, g, 3), load(coarse, g, 4), load(coarse, g, 5)
                z0 = add_scaled(add_scaled(plus(z0, load(coarse, g, 0)), s2, c4), -s1, c5)
                z1 = add_scaled(add_scaled(plus(z1, load(coarse, g, 1)), s0, c5), -s2, c3)
                z2 = add_scaled(add_scaled(plus(z2, load(coarse, g, 2)), s1, c3), -s0, c4)
            dot = add_wide(dot, _dot(r0, r1, r2, z0, z1, z2))
            largest = larger(largest, _dot(z0, z1, z2, z0, z1, z2))
        store(z, i, 0, z0)
        store(z, i, 1, z1)
        store(z, i, 2, z2)
    out[0, 0], out[0, 1], out[0, 2], out[0, 3] = dot
    out[1, 0], out[1, 1], out[1, 2], out[1, 3] = largest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def next_directions(
    count: int, betas: NDArray[np.floating], z: NDArray[np.floating], p: NDArray[np.floating]
) -> None:
    """P = z + beta p, with beta by lane, shape (1, 1, 4). Modifies `p` in place."""
    beta = load(betas, 0, 0)
    for i in range(count):
        for c in range(3):
            store(p, i, c, add_product(load(z, i, c), beta, load(p, i, c)))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_lanes(
    count: int,
    prescribed: NDArray[np.bool_],
    base: NDArray[np.floating],
    shares: NDArray[np.floating],
    x: NDArray[np.floating],
    u: NDArray[np.floating],
) -> None:
    """U = base + sum of the lanes' shares of x in free nodes. Writes `u`, shape (capacity, 3)."""
    s0, s1, s2, s3 = load(shares, 0, 0)
    for i in range(count):
        if not prescribed[i]:
            for c in range(3):
                x0, x1, x2, x3 = load(x, i, c)
                u[i, c] = base[i, c] + ((s0 * x0 + s1 * x1) + (s2 * x2 + s3 * x3))
