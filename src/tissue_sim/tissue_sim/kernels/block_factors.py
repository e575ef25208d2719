"""Solving with sparse factors of 6x6 blocks, for four right-hand sides at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.lanes import in_lanes, load_lanes, store_lanes
from tissue_sim.kernels.springs import FAST


class FactorArrays(NamedTuple):
    """L and the inverse of D, of a matrix P A P^T = L D L^T; L has identities on its diagonal.

    Attributes:
        order: Row of blocks of A that each row of L belongs to, shape (count,).
        start: Place of the first block below the diagonal by column, shape (count + 1,).
        row: Row of each block.
        blocks: L below its diagonal by column, blocks row by row, shape (len(row), 36).
        inverse: Blocks of the inverse of D, shape (count, 36).
    """

    order: NDArray[np.int32]
    start: NDArray[np.int32]
    row: NDArray[np.int32]
    blocks: NDArray[np.floating]
    inverse: NDArray[np.floating]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _six(a, i):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return (
        load_lanes(a, i, 0), load_lanes(a, i, 1), load_lanes(a, i, 2),
        load_lanes(a, i, 3), load_lanes(a, i, 4), load_lanes(a, i, 5),
    )  # fmt: skip


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _row_product(k, row, v):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """A row of a block times six numbers, lane by lane."""
    at = 6 * row
    first = k[at] * v[0] + k[at + 1] * v[1] + k[at + 2] * v[2] + k[at + 3] * v[3]
    return first + k[at + 4] * v[4] + k[at + 5] * v[5]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _add_row(sums, k, row, v):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Sums + a row of a block times one number, lane by lane."""
    at = 6 * row
    return (
        sums[0] + k[at] * v, sums[1] + k[at + 1] * v, sums[2] + k[at + 2] * v,
        sums[3] + k[at + 3] * v, sums[4] + k[at + 4] * v, sums[5] + k[at + 5] * v,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def solve_lanes(
    factors: FactorArrays,
    b: NDArray[np.floating],
    y: NDArray[np.floating],
    x: NDArray[np.floating],
) -> None:
    """X = A^-1 b.

    Args:
        factors: Of A.
        b: Shape (count, 6, 4).
        y: Overwritten, shape (count, 6, 4).
        x: Written, shape (count, 6, 4).
    """
    order, start, row, blocks, inverse = factors
    count = len(order)
    zeros = in_lanes(x.dtype.type(0))
    for i in range(count):
        for c in range(6):
            store_lanes(y, i, c, load_lanes(b, order[i], c))
    for j in range(count):
        v = _six(y, j)
        for place in range(start[j], start[j + 1]):
            i, block = row[place], blocks[place]
            for c in range(6):
                store_lanes(y, i, c, load_lanes(y, i, c) - _row_product(block, c, v))
    for j in range(count - 1, -1, -1):
        v = _six(y, j)
        sums = (zeros, zeros, zeros, zeros, zeros, zeros)
        for place in range(start[j], start[j + 1]):
            i, block = row[place], blocks[place]
            for c in range(6):
                sums = _add_row(sums, block, c, load_lanes(y, i, c))
        for c in range(6):
            value = _row_product(inverse[j], c, v) - sums[c]
            store_lanes(y, j, c, value)
            store_lanes(x, order[j], c, value)
