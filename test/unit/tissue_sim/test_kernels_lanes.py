"""Vectors of four lanes are what numpy makes of the same numbers."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError
from numpy.typing import NDArray

from tissue_sim.kernels.lanes import LANES, in_lanes, load_lanes, store_lanes, wide
from tissue_sim.kernels.vectors import bits, root, select, splat, store, total


@njit
def combine(a, b, out, sums, masks):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Everything that four lanes can do, and what is left of it."""
    zero = a[0, 0, 0] - a[0, 0, 0]
    wider = in_lanes(0.0)
    for i in range(len(a)):
        for c in range(a.shape[1]):
            x, y = load_lanes(a, i, c), load_lanes(b, i, c)
            masks[i, c] = bits(x > y)
            store_lanes(out, i, c, select(x > y, x * y - x, -y / (x + a[i, c, 0])) + zero)
            sums[i, c] = total(root(x * x + y * y))
            wider += wide(x) * wide(y)
    store(sums[len(a)], 0, wider)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_four_lanes_are_those_of_numpy(dtype: type[np.floating]) -> None:
    random = np.random.default_rng(5)
    a, b = (random.uniform(0.5, 2.0, (5, 6, LANES)).astype(dtype) for _ in range(2))
    out, masks = np.zeros_like(a), np.zeros((5, 6), dtype=np.int64)
    sums = np.zeros((6, 6))
    combine(a, b, out, sums, masks)
    rounding = 4 * float(np.finfo(dtype).eps)
    expected: NDArray[np.floating] = np.where(a > b, a * b - a, -b / (a + a[:, :, :1]))
    np.testing.assert_allclose(out, expected, rtol=rounding, atol=rounding)
    np.testing.assert_allclose(sums[:5], np.hypot(a, b).sum(axis=2), rtol=rounding)
    np.testing.assert_allclose(
        sums[5, :LANES], (a.astype(np.float64) * b).sum(axis=(0, 1)), rtol=1e-14
    )
    np.testing.assert_array_equal(masks, ((a > b) << np.arange(LANES)).sum(axis=2))


def test_vectors_of_four_and_of_eight_lanes_do_not_mix() -> None:
    @njit
    def mixed(value):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
        return total(in_lanes(value) + splat(value))

    with pytest.raises(TypingError):
        mixed(1.0)
