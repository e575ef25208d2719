"""Arithmetic on lanes: four numbers side by side, one for each of four problems solved at once.

What is written for the four becomes one vector instruction. Arrays of lanes have the lane last, as
in shape (node_capacity, 3, 4); `c` is a component.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST

LANES = 4

Lanes: TypeAlias = tuple[np.floating, np.floating, np.floating, np.floating]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def load(a: NDArray[np.floating], i: int, c: int) -> Lanes:
    """The lanes a[i, c]."""
    return (a[i, c, 0], a[i, c, 1], a[i, c, 2], a[i, c, 3])


@njit(inline="always", error_model="numpy", fastmath=FAST)
def store(a: NDArray[np.floating], i: int, c: int, v: Lanes) -> None:
    """a[i, c] = v."""
    a[i, c, 0] = v[0]
    a[i, c, 1] = v[1]
    a[i, c, 2] = v[2]
    a[i, c, 3] = v[3]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def plus(a: Lanes, b: Lanes) -> Lanes:
    """a + b."""  # noqa: D403
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3])


@njit(inline="always", error_model="numpy", fastmath=FAST)
def minus(a: Lanes, b: Lanes) -> Lanes:
    """a - b."""  # noqa: D403
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3])


@njit(inline="always", error_model="numpy", fastmath=FAST)
def add_scaled(y: Lanes, k: np.floating, a: Lanes) -> Lanes:
    """y + k a, with one factor for all lanes."""  # noqa: D403
    return (y[0] + k * a[0], y[1] + k * a[1], y[2] + k * a[2], y[3] + k * a[3])


@njit(inline="always", error_model="numpy", fastmath=FAST)
def product_of(a: Lanes, b: Lanes) -> Lanes:
    """a b, lane by lane."""  # noqa: D403
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3])


@njit(inline="always", error_model="numpy", fastmath=FAST)
def add_product(y: Lanes, a: Lanes, b: Lanes) -> Lanes:
    """y + a b, lane by lane."""  # noqa: D403
    return (y[0] + a[0] * b[0], y[1] + a[1] * b[1], y[2] + a[2] * b[2], y[3] + a[3] * b[3])


@njit(inline="always", error_model="numpy", fastmath=FAST)
def add_wide(total: Lanes, a: Lanes) -> Lanes:
    """total + a, in double precision: a sum over many nodes."""  # noqa: D403
    return (
        total[0] + np.float64(a[0]), total[1] + np.float64(a[1]),
        total[2] + np.float64(a[2]), total[3] + np.float64(a[3]),
    )  # fmt: skip


@njit(inline="always", error_model="numpy", fastmath=FAST)
def larger(a: Lanes, b: Lanes) -> Lanes:
    """The larger of a and b, lane by lane."""
    return (max(a[0], b[0]), max(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3]))
