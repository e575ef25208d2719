"""Sparse factors of 6x6 blocks solve what dense ones do."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import bsr_matrix

from tissue_sim.elastic.block_factors import BlockFactors


def positive_definite(
    count: int, edges: list[tuple[int, int]], seed: int
) -> tuple[bsr_matrix, NDArray[np.float64]]:
    """Springs in six dimensions between blocks, each block held weakly; sparse and dense."""
    random = np.random.default_rng(seed)
    A = np.zeros((6 * count, 6 * count))
    for block in range(count):
        at = slice(6 * block, 6 * block + 6)
        A[at, at] += 0.1 * np.eye(6)
    for first, second in edges:
        factor = random.normal(size=(6, 12)) * (random.random((6, 12)) < 0.7)
        rows = np.r_[6 * first : 6 * first + 6, 6 * second : 6 * second + 6]
        A[np.ix_(rows, rows)] += factor.T @ factor
    return bsr_matrix(A, blocksize=(6, 6)), A


@given(
    count=st.integers(1, 30),
    edges=st.lists(st.tuples(st.integers(0, 29), st.integers(0, 29)), max_size=80),
    seed=st.integers(0, 1000),
)
@settings(max_examples=40, deadline=None)
def test_four_right_hand_sides_are_solved_as_by_dense_factors(
    count: int, edges: list[tuple[int, int]], seed: int
) -> None:
    kept = [(a, b) for a, b in edges if a < count and b < count and a != b]
    sparse, dense = positive_definite(count, kept, seed)
    b = np.random.default_rng(seed).normal(size=(count, 6, 4))
    x = np.full_like(b, np.nan)
    BlockFactors(sparse, np.float64).solve(b, x)
    exact = np.linalg.solve(dense, b.reshape(6 * count, 4))
    assert np.allclose(x.reshape(6 * count, 4), exact, rtol=1e-9, atol=1e-9 * np.abs(exact).max())


def test_a_chain_in_any_order_is_factorised_without_fill() -> None:
    count = 200
    order = np.random.default_rng(3).permutation(count)
    sparse, _ = positive_definite(count, list(itertools.pairwise(order.tolist())), 3)
    factors = BlockFactors(sparse, np.float32)
    blocks_below = count - 1
    assert factors.bytes == 4 * 36 * (2 * blocks_below + count)


def test_a_singular_matrix_is_refused() -> None:
    with pytest.raises(RuntimeError, match="singular"):
        BlockFactors(bsr_matrix(np.ones((6, 6)), blocksize=(6, 6)), np.float64)
