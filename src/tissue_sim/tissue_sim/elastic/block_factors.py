"""Sparse factors of a symmetric positive definite matrix of 6x6 blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_matrix, csc_matrix, csr_matrix, diags_array

from tissue_sim.elastic.factorisation import factorised
from tissue_sim.kernels.block_factors import FactorArrays, solve_lanes
from tissue_sim.kernels.lanes import LANES

SIZE = 6
"""Rows of a block."""


class BlockFactors:
    """L D L^T of a matrix whose blocks have been put in an order that leaves L sparse.

    Factorising is SuperLU's, by way of scipy; solving is ours, since a factor is a few megabytes
    of dense blocks, and a sweep over them takes hardly longer for four right-hand sides than for
    one.
    """

    def __init__(self, matrix: bsr_matrix, dtype: type[np.floating]) -> None:
        """Factorise.

        Args:
            matrix: Symmetric positive definite, blocks of shape (6, 6).
            dtype: Precision to solve in.

        Raises:
            RuntimeError: It is singular.
        """
        count = matrix.shape[0] // SIZE
        order = _sparse_order(matrix)
        rows = _dofs(order)
        factor = factorised(csc_matrix(matrix.tocsr()[rows][:, rows]), "NATURAL")
        # SuperLU goes along the elimination tree, on which the rows of a block are a chain.
        place = np.argsort(factor.perm_c).reshape(count, SIZE)
        order = order[place[:, 0] // SIZE]
        L = bsr_matrix(factor.L.tocsr(), blocksize=(SIZE, SIZE)).tocsr()
        lower = bsr_matrix(csc_matrix(L).T.tocsr(), blocksize=(SIZE, SIZE))
        lower.sort_indices()
        column = np.repeat(np.arange(count), np.diff(lower.indptr))
        blocks = lower.data.transpose(0, 2, 1)
        on = lower.indices == column
        corners = blocks[on]
        pivots = factor.U.diagonal().reshape(count, SIZE)
        inverse = np.linalg.inv(corners @ (pivots[:, :, None] * corners.transpose(0, 2, 1)))
        below = blocks[~on] @ np.linalg.inv(corners)[column[~on]]
        start = np.concatenate([[0], np.cumsum(np.bincount(column[~on], minlength=count))])
        self._arrays = FactorArrays(
            order.astype(np.int32), start.astype(np.int32), lower.indices[~on].astype(np.int32),
            np.ascontiguousarray(below.reshape(-1, SIZE * SIZE), dtype=dtype),
            np.ascontiguousarray(inverse.reshape(-1, SIZE * SIZE), dtype=dtype),
        )  # fmt: skip
        self._y = np.zeros((count, SIZE, LANES), dtype=dtype)

    @property
    def bytes(self) -> int:
        """Memory that a solution reads at least, L twice."""
        return 2 * self._arrays.blocks.nbytes + self._arrays.inverse.nbytes

    def solve(self, b: NDArray[np.floating], x: NDArray[np.floating]) -> None:
        """X = A^-1 b for four right-hand sides.

        Args:
            b: Shape (count, 6, 4).
            x: Written, shape (count, 6, 4).
        """
        solve_lanes(self._arrays, b, self._y, x)


def compile_solver(dtype: type[np.floating]) -> None:
    """Compile the solver, or load it from the cache, by solving nothing: steps must not have to."""
    start, none = np.zeros(1, dtype=np.int32), np.empty(0, dtype=np.int32)
    blocks, b = np.empty((0, SIZE * SIZE), dtype=dtype), np.empty((0, SIZE, LANES), dtype=dtype)
    solve_lanes(FactorArrays(none, start, none, blocks, blocks), b, b, b)


def _sparse_order(matrix: bsr_matrix) -> NDArray[np.int64]:
    """Rows of blocks in an order that leaves the factor sparse (minimum degree)."""
    ones = csr_matrix((np.ones(len(matrix.indices)), matrix.indices, matrix.indptr))
    dominant = csc_matrix(ones + diags_array(np.full(ones.shape[0], float(ones.shape[0]))))
    return np.argsort(factorised(dominant).perm_c)


def _dofs(order: NDArray[np.int64]) -> NDArray[np.int64]:
    return (SIZE * order[:, None] + np.arange(SIZE)).ravel()
