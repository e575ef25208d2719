"""Loops over elements that have been turned inside out.

Symbols: J = V/V0, the volume of an element over that at rest, negative when it is inverted; B a
pressure [Pa]. Springs know no inside: an inverted element finds a second equilibrium there and
stays. A pressure p pushes every node of it away from the opposite face until J = 0,

    p = B min(1, -J / ramp)    for J < 0,

minus the derivative of an energy, without a jump.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _edge(rest, u, a, b):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return (
        rest[b, 0] - rest[a, 0] + (u[b, 0] - u[a, 0]),
        rest[b, 1] - rest[a, 1] + (u[b, 1] - u[a, 1]),
        rest[b, 2] - rest[a, 2] + (u[b, 2] - u[a, 2]),
    )


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _cross(a, b):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _faces(tet, rest, u):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """6 dV/dx of the last three corners, and 6 V."""
    i, j, k, m = tet[0], tet[1], tet[2], tet[3]
    e1, e2, e3 = _edge(rest, u, i, j), _edge(rest, u, i, k), _edge(rest, u, i, m)
    n1, n2, n3 = _cross(e2, e3), _cross(e3, e1), _cross(e1, e2)
    return n1, n2, n3, e1[0] * n1[0] + e1[1] * n1[1] + e1[2] * n1[2]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def list_inverted(
    begin: int,
    end: int,
    tets: NDArray[np.int32],
    alive: NDArray[np.bool_],
    volumes: NDArray[np.float64],
    rest: NDArray[np.floating],
    u: NDArray[np.floating],
    listed: NDArray[np.bool_],
    inverted: NDArray[np.int32],
    count: int,
) -> int:
    """Add the inverted ones of elements [begin, end) to a list; drop those far from inversion.

    What has just turned back stays listed for a while: found late when it swings back, it would
    gain the energy that it did not pay for on the way in.

    Args:
        begin: First row of elements to look at.
        end: One past the last.
        tets: Node rows, positively oriented at rest, shape (element_capacity, 4).
        alive: Elements that exist, shape (element_capacity,).
        volumes: V0 [m^3], shape (element_capacity,).
        rest: Rest positions [m], shape (node_capacity, 3).
        u: Displacements [m], shape (node_capacity, 3).
        listed: Whether an element is in the list, shape (element_capacity,); modified in place.
        inverted: The list, valid in [0, count), shape (element_capacity,); modified in place.
        count: How many are listed.

    Returns:
        How many are listed now.
    """
    kept = 0
    for place in range(count):
        row = inverted[place]
        listed[row] = alive[row] and _faces(tets[row], rest, u)[3] < volumes[row]
        if listed[row]:
            inverted[kept] = row
            kept += 1
    for row in range(begin, end):
        if alive[row] and not listed[row] and _faces(tets[row], rest, u)[3] < 0:
            listed[row] = True
            inverted[kept] = row
            kept += 1
    return kept


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_turning_forces(
    inverted: NDArray[np.int32],
    count: int,
    tets: NDArray[np.int32],
    volumes: NDArray[np.float64],
    rest: NDArray[np.floating],
    pressure: np.floating,
    ramp: np.floating,
    u: NDArray[np.floating],
    F: NDArray[np.floating],
) -> None:
    """Add the forces of the pressure in inverted elements [N] to `F`.

    Args:
        inverted: Rows of elements, valid in [0, count); those that are not inverted do nothing.
        count: How many.
        tets: Node rows, positively oriented at rest, shape (element_capacity, 4).
        volumes: V0 [m^3], shape (element_capacity,).
        rest: Rest positions [m], shape (node_capacity, 3).
        pressure: B/6 [Pa].
        ramp: Share of inversion at which the pressure is B.
        u: Displacements [m], shape (node_capacity, 3).
        F: Forces on nodes [N], shape (node_capacity, 3); added to.
    """
    for place in range(count):
        row = inverted[place]
        tet = tets[row]
        n1, n2, n3, volume = _faces(tet, rest, u)
        if volume >= 0:
            continue
        p = pressure * min(1.0, -volume / (6.0 * ramp * volumes[row]))
        for axis in range(3):
            a, b, c = p * n1[axis], p * n2[axis], p * n3[axis]
            F[tet[0], axis] -= a + b + c
            F[tet[1], axis] += a
            F[tet[2], axis] += b
            F[tet[3], axis] += c
