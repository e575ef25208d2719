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
