"""Forces of springs whose force is not proportional to their elongation.

Symbols as in `kernels.springs`; e = (l - l0) / l0 is the elongation of a spring and f(e) its law: a
spring pulls with k l0 f(e) [N], f(e) = e for a linear one. Every law is a cubic polynomial between
two elongations and straight beyond them:

    f(e) = e (1 + quadratic e + cubic e^2)          for below <= e <= above,
    f(e) = force_above + slope_above (e - above)    for e > above, and alike for e < below.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST, SpringArrays


class Law(NamedTuple):
    """A law in the kernels' precision; see the head of the module."""

    one: np.floating
    quadratic: np.floating
    cubic: np.floating
    above: np.floating
    force_above: np.floating
    slope_above: np.floating
    below: np.floating
    force_below: np.floating
    slope_below: np.floating


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _secant(law, e):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """f(e) / e."""
    if e > law.above:
        return (law.force_above + law.slope_above * (e - law.above)) / e
    if e < law.below:
        return (law.force_below + law.slope_below * (e - law.below)) / e
    return law.one + e * (law.quadratic + law.cubic * e)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def law_forces(
    rows: int,
    springs: SpringArrays,
    law: Law,
    tiny: np.floating,
    u: NDArray[np.floating],
    F: NDArray[np.floating],
) -> None:
    """Forces of the springs on nodes [0, rows) [N]. Writes `F`, shape (node_capacity, 3).

    As in `kernels.springs`, lengths are not subtracted from each other: l - l0 = q / (l + l0).
    """
    rest, start, degree, neighbour, stiffness, length = springs
    for i in range(rows):
        X0, X1, X2 = rest[i, 0], rest[i, 1], rest[i, 2]
        u0, u1, u2 = u[i, 0], u[i, 1], u[i, 2]
        F0 = F1 = F2 = tiny - tiny
        begin = start[i]
        for spring in range(begin, begin + degree[i]):
            j = neighbour[spring]
            w0, w1, w2 = u[j, 0] - u0, u[j, 1] - u1, u[j, 2] - u2
            D0, D1, D2 = rest[j, 0] - X0, rest[j, 1] - X1, rest[j, 2] - X2
            e0, e1, e2 = D0 + w0, D1 + w1, D2 + w2
            q = (D0 + e0) * w0 + (D1 + e1) * w1 + (D2 + e2) * w2
            length_now = np.sqrt(e0 * e0 + e1 * e1 + e2 * e2 + tiny)
            longer = q / (length_now + length[spring])
            pull = stiffness[spring] * longer * _secant(law, longer / length[spring]) / length_now
            F0 += pull * e0
            F1 += pull * e1
            F2 += pull * e2
        F[i, 0], F[i, 1], F[i, 2] = F0, F1, F2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_home_forces(
    rows: int,
    stiffness: NDArray[np.floating],
    u: NDArray[np.floating],
    F: NDArray[np.floating],
) -> None:
    """Add the pull -k u of springs to the rest positions [N] to F[:rows], shape (rows, 3).

    Args:
        rows: Nodes [0, rows) take part.
        stiffness: Stiffness of each node's spring [N/m], shape (node_capacity,).
        u: Displacements [m].
        F: Forces [N]; added to.
    """
    for i in range(rows):
        for axis in range(3):
            F[i, axis] -= stiffness[i] * u[i, axis]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def largest_free(
    rows: int,
    springs: SpringArrays,
    prescribed: NDArray[np.bool_],
    F: NDArray[np.floating],
) -> float:
    """Largest squared force on a free node of [0, rows) [N^2]."""
    largest = 0.0
    for i in range(rows):
        if not prescribed[i] and springs.degree[i] > 0:
            squared = np.float64(F[i, 0]) ** 2 + np.float64(F[i, 1]) ** 2 + np.float64(F[i, 2]) ** 2
            largest = max(largest, squared)
    return largest
