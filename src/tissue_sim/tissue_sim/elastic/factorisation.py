"""Factors of sparse symmetric positive definite matrices, by SuperLU."""

from __future__ import annotations

from typing import Literal, TypeAlias

from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.linalg import SuperLU, splu

Order: TypeAlias = Literal["NATURAL", "MMD_AT_PLUS_A"]


def factorised(matrix: csr_matrix | csc_matrix, order: Order = "MMD_AT_PLUS_A") -> SuperLU:
    """Factors of a symmetric positive definite matrix, which needs no pivots off its diagonal.

    Args:
        matrix: The matrix.
        order: How its rows are ordered: as they are, or by minimum degree.

    Raises:
        RuntimeError: It is singular.
    """
    return splu(
        matrix.tocsc(), permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
