"""Loops over parts that move as rigid bodies: what of a field of vectors is such a motion.

A rigid motion of a part is six numbers y, v_i = t + w x a_i, t = y[:3], w = y[3:], a_i the arm of
node i from the middle of the part in lengths of the part.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def measure_parts(
    nodes: NDArray[np.int32],
    begin: NDArray[np.int64],
    rest: NDArray[np.float64],
    shape: NDArray[np.floating],
    prescribed: NDArray[np.bool_],
    arms: NDArray[np.float64],
    sums: NDArray[np.float64],
) -> None:
    """Arms of nodes, and sums of Z_i^T Z_i, v_i = Z_i y, over free and over prescribed nodes.

    Args:
        nodes: Of all parts, part by part.
        begin: First place of each part in `nodes`, and their number, shape (parts + 1,).
        rest: Rest positions [m], shape (node_capacity, 3).
        shape: Displacements [m], shape (node_capacity, 3).
        prescribed: Nodes whose motion is given, shape (node_capacity,).
        arms: Written, shape (len(nodes), 3).
        sums: Over free and prescribed nodes of each part; written, shape (parts, 2, 6, 6).
    """
    sums[:] = 0.0
    middle = np.empty(3)
    for part in range(len(begin) - 1):
        first, end = begin[part], begin[part + 1]
        middle[:] = 0.0
        for place in range(first, end):
            for k in range(3):
                arms[place, k] = rest[nodes[place], k] + shape[nodes[place], k]
                middle[k] += arms[place, k]
        spread = 0.0
        for place in range(first, end):
            for k in range(3):
                arms[place, k] -= middle[k] / (end - first)
                spread += arms[place, k] ** 2
        scale = np.sqrt((end - first) / max(spread, 1e-300))
        for place in range(first, end):
            for k in range(3):
                arms[place, k] *= scale
            _add_square(arms[place], sums[part, int(prescribed[nodes[place]])])


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _add_square(arm, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Add Z^T Z."""
    a, b, c = arm[0], arm[1], arm[2]
    square = a * a + b * b + c * c
    for i in range(3):
        out[i, i] += 1.0
        out[3 + i, 3 + i] += square
        for j in range(3):
            out[3 + i, 3 + j] -= arm[i] * arm[j]
    # v = t + w x a: t . (w x a) = w . (a x t).
    for row, column, value in ((0, 4, c), (0, 5, -b), (1, 3, -c), (1, 5, a), (2, 3, b), (2, 4, -a)):
        out[row, column] += value
        out[column, row] += value


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def remove_rigid_motions(
    nodes: NDArray[np.int32],
    begin: NDArray[np.int64],
    prescribed: NDArray[np.bool_],
    arms: NDArray[np.float64],
    inverse: NDArray[np.float64],
    v: NDArray[np.floating],
) -> None:
    """V_i -= Z_i G sum_j Z_j^T v_j over the free nodes of each part. Modifies `v`.

    Args:
        nodes: Of all parts, part by part.
        begin: First place of each part in `nodes`, and their number, shape (parts + 1,).
        prescribed: Nodes that are left alone, shape (node_capacity,).
        arms: Shape (len(nodes), 3).
        inverse: G of each part, shape (parts, 6, 6).
        v: Shape (node_capacity, 3).
    """
    for part in range(len(begin) - 1):
        s0 = s1 = s2 = s3 = s4 = s5 = 0.0
        for place in range(begin[part], begin[part + 1]):
            node = nodes[place]
            if prescribed[node]:
                continue
            v0, v1, v2 = np.float64(v[node, 0]), np.float64(v[node, 1]), np.float64(v[node, 2])
            a0, a1, a2 = arms[place, 0], arms[place, 1], arms[place, 2]
            s0 += v0
            s1 += v1
            s2 += v2
            s3 += a1 * v2 - a2 * v1
            s4 += a2 * v0 - a0 * v2
            s5 += a0 * v1 - a1 * v0
        g = inverse[part]
        t0 = _row(g[0], s0, s1, s2, s3, s4, s5)
        t1 = _row(g[1], s0, s1, s2, s3, s4, s5)
        t2 = _row(g[2], s0, s1, s2, s3, s4, s5)
        w0 = _row(g[3], s0, s1, s2, s3, s4, s5)
        w1 = _row(g[4], s0, s1, s2, s3, s4, s5)
        w2 = _row(g[5], s0, s1, s2, s3, s4, s5)
        for place in range(begin[part], begin[part + 1]):
            node = nodes[place]
            if prescribed[node]:
                continue
            a0, a1, a2 = arms[place, 0], arms[place, 1], arms[place, 2]
            v[node, 0] -= t0 + w1 * a2 - w2 * a1
            v[node, 1] -= t1 + w2 * a0 - w0 * a2
            v[node, 2] -= t2 + w0 * a1 - w1 * a0


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _row(g, s0, s1, s2, s3, s4, s5):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return g[0] * s0 + g[1] * s1 + g[2] * s2 + g[3] * s3 + g[4] * s4 + g[5] * s5
