"""Shape of tetrahedra."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True, error_model="numpy")
def _distance(p: NDArray[np.float64], q: NDArray[np.float64]) -> float:
    x, y, z = p[0] - q[0], p[1] - q[1], p[2] - q[2]
    return np.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True, error_model="numpy")
def _twice_area(p: NDArray[np.float64], q: NDArray[np.float64], r: NDArray[np.float64]) -> float:
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return np.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True, error_model="numpy")
def six_volumes(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    c: NDArray[np.float64],
    d: NDArray[np.float64],
) -> float:
    """Six times the signed volume [m^3]."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return (
        (uy * vz - uz * vy) * wx + (uz * vx - ux * vz) * wy + (ux * vy - uy * vx) * wz
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def radius_ratio(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    c: NDArray[np.float64],
    d: NDArray[np.float64],
) -> float:
    """3 x inscribed / circumscribed radius, signed: 1 regular, 0 flat, negative inverted.

    r = 3 V / A with A the area of the four faces, and R = sqrt(s (s-2l)(s-2m)(s-2n)) / (24 V),
    where l, m and n are the products of opposite edges' lengths and s their sum.
    """
    six = six_volumes(a, b, c, d)
    area = 0.5 * (
        _twice_area(a, b, c) + _twice_area(a, b, d) + _twice_area(a, c, d) + _twice_area(b, c, d)
    )
    l = _distance(a, b) * _distance(c, d)  # noqa: E741
    m = _distance(a, c) * _distance(b, d)
    n = _distance(a, d) * _distance(b, c)
    product = (l + m + n) * (l + m - n) * (l - m + n) * (-l + m + n)
    if not product > 0.0 or not area > 0.0:
        return 0.0
    # 3 r / R = 3 (3 V / A) (24 V / sqrt(product)) with V = six / 6.
    return 6.0 * six * abs(six) / (area * np.sqrt(product))


@njit(cache=True, nogil=True)
def radius_ratios(
    points: NDArray[np.float64], tets: NDArray[np.int32], out: NDArray[np.float64]
) -> None:
    """`radius_ratio` of every element, into `out`, shape (element_count,)."""
    for e in range(tets.shape[0]):
        out[e] = radius_ratio(
            points[tets[e, 0]], points[tets[e, 1]], points[tets[e, 2]], points[tets[e, 3]]
        )


@njit(cache=True, nogil=True)
def total_volume(
    points: NDArray[np.float64], tets: NDArray[np.int32], alive: NDArray[np.bool_]
) -> float:
    """Volume of all living elements [m^3]."""
    total = 0.0
    for e in range(tets.shape[0]):
        if alive[e]:
            total += six_volumes(
                points[tets[e, 0]], points[tets[e, 1]], points[tets[e, 2]], points[tets[e, 3]]
            )
    return total / 6.0
