"""Vectors in kernels do what numpy does lane by lane."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.vectors import (
    LANES,
    bits,
    fetch_points,
    fetch_rows,
    first_lanes,
    load,
    put_rows,
    root,
    select,
    splat,
    store,
    total,
)


@njit
def arithmetic(a, b, s, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    x, y = load(a, 0), load(b, 0)
    store(out, 0, x + y)
    store(out, 8, x - s)
    store(out, 16, s * y)
    store(out, 24, x / y)
    store(out, 32, -x)
    store(out, 40, root(y))
    store(out, 48, select(x > y, x, s))
    z = splat(s)
    z += x
    z *= y
    z -= s
    store(out, 56, z)
    return bits(x > y), bits(x < s), total(x)


@njit
def move_rows(array, points, indices, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    a, b, c, d = fetch_rows(array, indices, 0)
    x, y, z = fetch_points(points, indices, 0)
    put_rows(out, indices, 8, (a + x, b + y, c + z, d))


def number(mask: NDArray[np.bool_]) -> int:
    return int((mask << np.arange(LANES)).sum())


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_arithmetic_is_that_of_numpy(dtype: type[np.floating]) -> None:
    random = np.random.default_rng(4)
    a = random.normal(size=LANES).astype(dtype)
    b = random.uniform(0.5, 2.0, LANES).astype(dtype)
    s, out = dtype(0.25), np.zeros(8 * LANES, dtype=dtype)
    more, less, in_all = arithmetic(a, b, s, out)
    expected = [a + b, a - s, s * b, a / b, -a, np.sqrt(b), np.where(a > b, a, s), (s + a) * b - s]
    close = 4.0 * float(np.finfo(dtype).eps)
    np.testing.assert_allclose(out.reshape(8, LANES), expected, rtol=close, atol=close)
    assert more == number(a > b)
    assert less == number(a < s)
    assert in_all == pytest.approx(a.sum(), rel=8 * close)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rows_are_fetched_and_put_where_their_indices_say(dtype: type[np.floating]) -> None:
    random = np.random.default_rng(5)
    array = random.normal(size=(40, 4)).astype(dtype)
    points = random.normal(size=(40, 3)).astype(dtype)
    # The last row is among them: nothing behind it is read.
    indices = np.concatenate([[39], random.permutation(39)[: 2 * LANES - 1]]).astype(np.uint32)
    out = np.zeros_like(array)
    move_rows(array, points, indices, out)
    expected = np.zeros_like(array)
    taken, places = indices[:LANES], indices[LANES:]
    expected[places] = array[taken]
    expected[places, :3] += points[taken]
    np.testing.assert_array_equal(out, expected)


@njit
def keep(a, count, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    store(out, 0, first_lanes(load(a, 0), count))


@pytest.mark.parametrize("count", [0, 1, 5, 8, 100])
def test_lanes_behind_a_count_are_zero(count: int) -> None:
    a, out = np.arange(1.0, LANES + 1, dtype=np.float32), np.ones(LANES, dtype=np.float32)
    a[-1] = np.inf
    keep(a, count, out)
    np.testing.assert_array_equal(out, np.where(np.arange(LANES) < count, a, 0))
