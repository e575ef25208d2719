"""Loops of conjugate gradients for four right-hand sides: one sweep over the matrix for all.

Symbols as in `kernels.stiffness`; arrays of nodes have shape (node_capacity, 3, 4), the lane last.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.lanes import in_lanes, load_lanes, store_lanes, wide
from tissue_sim.kernels.springs import FAST
from tissue_sim.kernels.stiffness import Aggregates, BlockRows, Vectors
from tissue_sim.kernels.vectors import select, store, total


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
    zeros = in_lanes(zero)
    sums = in_lanes(0.0)
    for i in range(count):
        y0 = y1 = y2 = zeros
        if not prescribed[i]:
            x0, x1, x2 = load_lanes(x, i, 0), load_lanes(x, i, 1), load_lanes(x, i, 2)
            y0, y1, y2 = _row(i, rows, x, x0, x1, x2, zeros)
            sums += wide(_dot(x0, x1, x2, y0, y1, y2))
        store_lanes(y, i, 0, y0)
        store_lanes(y, i, 1, y1)
        store_lanes(y, i, 2, y2)
    store(dots, 0, sums)


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _row(i, rows, x, x0, x1, x2, zeros):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """(K x)_i."""
    y0 = y1 = y2 = zeros
    begin = np.int64(rows.start[i])
    for place in range(begin, begin + np.int64(rows.degree[i])):
        j = rows.neighbour[place]
        d0 = load_lanes(x, j, 0) - x0
        d1 = load_lanes(x, j, 1) - x1
        d2 = load_lanes(x, j, 2) - x2
        k = rows.blocks[place]
        y0 = y0 + k[0] * d0 + k[1] * d1 + k[2] * d2
        y1 = y1 + k[3] * d0 + k[4] * d1 + k[5] * d2
        y2 = y2 + k[6] * d0 + k[7] * d1 + k[8] * d2
    return y0, y1, y2


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _dot(a0, a1, a2, b0, b1, b2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """a . b of one node, lane by lane."""  # noqa: D403
    return a0 * b0 + a1 * b1 + a2 * b2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def squared_forces(
    nodes: NDArray[np.int32],
    rows: BlockRows,
    x: NDArray[np.floating],
    out: NDArray[np.float64],
) -> None:
    """Sum of the squared internal forces on nodes [N^2], by lane. Writes `out`, shape (4,)."""
    zero = x.dtype.type(0)
    zeros = in_lanes(zero)
    sums = in_lanes(0.0)
    for i in nodes:
        y0, y1, y2 = _row(
            i, rows, x, load_lanes(x, i, 0), load_lanes(x, i, 1), load_lanes(x, i, 2), zeros
        )
        sums += wide(_dot(y0, y1, y2, y0, y1, y2))
    store(out, 0, sums)


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
    norm = in_lanes(0.0)
    a, b = load_lanes(steps, 0, 0), load_lanes(steps, 0, 1)
    for i in range(count):
        for c in range(3):
            store_lanes(x, i, c, load_lanes(x, i, c) + a * load_lanes(p, i, c))
        r0 = load_lanes(r, i, 0) - b * load_lanes(q, i, 0)
        r1 = load_lanes(r, i, 1) - b * load_lanes(q, i, 1)
        r2 = load_lanes(r, i, 2) - b * load_lanes(q, i, 2)
        store_lanes(r, i, 0, r0)
        store_lanes(r, i, 1, r1)
        store_lanes(r, i, 2, r2)
        norm += wide(_dot(r0, r1, r2, r0, r1, r2))
        g = aggregate[i]
        if g >= 0:
            s0, s1, s2 = arms[i, 0], arms[i, 1], arms[i, 2]
            store_lanes(coarse, g, 0, load_lanes(coarse, g, 0) + r0)
            store_lanes(coarse, g, 1, load_lanes(coarse, g, 1) + r1)
            store_lanes(coarse, g, 2, load_lanes(coarse, g, 2) + r2)
            store_lanes(coarse, g, 3, load_lanes(coarse, g, 3) + s1 * r2 - s2 * r1)
            store_lanes(coarse, g, 4, load_lanes(coarse, g, 4) + s2 * r0 - s0 * r2)
            store_lanes(coarse, g, 5, load_lanes(coarse, g, 5) + s0 * r1 - s1 * r0)
    store(squared, 0, norm)


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
    zeros = in_lanes(zero)
    largest = zeros
    dot = in_lanes(0.0)
    for i in range(count):
        z0 = z1 = z2 = zeros
        if not prescribed[i]:
            r0, r1, r2 = load_lanes(r, i, 0), load_lanes(r, i, 1), load_lanes(r, i, 2)
            d = inverse[i]
            z0 = d[0] * r0 + d[1] * r1 + d[2] * r2
            z1 = d[3] * r0 + d[4] * r1 + d[5] * r2
            z2 = d[6] * r0 + d[7] * r1 + d[8] * r2
            g = aggregate[i]
            if g >= 0:
                s0, s1, s2 = arms[i, 0], arms[i, 1], arms[i, 2]
                c3, c4, c5 = (
                    load_lanes(coarse, g, 3),
                    load_lanes(coarse, g, 4),
                    load_lanes(coarse, g, 5),
                )
                z0 = z0 + load_lanes(coarse, g, 0) + s2 * c4 - s1 * c5
                z1 = z1 + load_lanes(coarse, g, 1) + s0 * c5 - s2 * c3
                z2 = z2 + load_lanes(coarse, g, 2) + s1 * c3 - s0 * c4
            dot += wide(_dot(r0, r1, r2, z0, z1, z2))
            moved = _dot(z0, z1, z2, z0, z1, z2)
            largest = select(moved > largest, moved, largest)
        store_lanes(z, i, 0, z0)
        store_lanes(z, i, 1, z1)
        store_lanes(z, i, 2, z2)
    store(out[0], 0, dot)
    store(out[1], 0, wide(largest))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def next_directions(
    count: int, betas: NDArray[np.floating], z: NDArray[np.floating], p: NDArray[np.floating]
) -> None:
    """P = z + beta p, with beta by lane, shape (1, 1, 4). Modifies `p` in place."""
    beta = load_lanes(betas, 0, 0)
    for i in range(count):
        for c in range(3):
            store_lanes(p, i, c, load_lanes(z, i, c) + beta * load_lanes(p, i, c))


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
    s = load_lanes(shares, 0, 0)
    for i in range(count):
        if not prescribed[i]:
            for c in range(3):
                u[i, c] = base[i, c] + total(s * load_lanes(x, i, c))
