"""Loops that measure the machine."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST
from tissue_sim.kernels.vectors import LANES, load, root, splat, total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def triad(
    a: NDArray[np.floating], b: NDArray[np.floating], c: NDArray[np.floating], s: np.floating
) -> None:
    """Write b + s c to `a`."""
    for i in range(len(a)):
        a[i] = b[i] + s * c[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def root_and_quotient(numbers: NDArray[np.floating], one: np.floating) -> np.floating:
    """Sum of 1 / (r (r + 1)) with r the root of each number: a root and a division, as a spring.

    Eight at once, as kernels take them: a multiple of eight numbers.
    """
    sums = splat(one - one)
    for at in range(0, len(numbers), LANES):
        r = root(load(numbers, at))
        sums += one / (r * (r + one))
    return total(sums)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def multiply_and_add(numbers: NDArray[np.floating], s: np.floating, c: np.floating) -> None:
    """Sixteen times x <- s x + c for every number, in registers: 32 operations each."""
    for i in range(len(numbers)):
        x = numbers[i]
        for _ in range(16):
            x = s * x + c
        numbers[i] = x
