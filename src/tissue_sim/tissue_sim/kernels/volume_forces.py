"""Forces that keep the volume of tetrahedra.

Symbols: d_a = X_a - X_0 edges at rest and e_a = d_a + w_a now, a = 1, 2, 3; V the volume, a sixth
of e_1 . (e_2 x e_3), V0 at rest; g_a = dV/dx_a, a third of the area of the opposite face along its
normal; G = sum_a |g_a|^2 and G0 at rest; B the modulus [Pa]. The energy of an element is

    B V0 h(V/V0 - 1)    with    h(s) = s^2 / 2 for |s| <= 1 and |s| - 1/2 beyond:

a pressure p = B (V/V0 - 1), at most B, and forces -p g_a. The change of volume is summed from the
differences w of displacements,

    6 (V - V0) = w_1 . (e_2 x e_3) + d_1 . (w_2 x e_3) + d_1 . (d_2 x w_3),

which is exactly zero at rest and after a shift.

The stiffness B G / V0 of an element grows with its faces. So that a time step can be stable for
any deformation, the pressure is multiplied by reserve G0 / G where G > reserve G0: elements whose
faces have grown so much are weaker than the energy says. A pressure on the faces, whatever it is,
has no resultant and no moment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.networks import Elements
from tissue_sim.kernels.springs import FAST


class Volumes(NamedTuple):
    """What keeps the volume, in the kernels' precision: B [Pa], `reserve`, 1 and 1/6."""

    modulus: np.floating
    reserve: np.floating
    one: np.floating
    sixth: np.floating


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _edge(rest, a, b):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return rest[b, 0] - rest[a, 0], rest[b, 1] - rest[a, 1], rest[b, 2] - rest[a, 2]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _cross(a, b):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _dot(a, b):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _sum(a, b):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _squares(a, b, c):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """36 G of three face vectors 6 g and of the fourth, which closes their sum."""
    d = _sum(_sum(a, b), c)
    return _dot(a, a) + _dot(b, b) + _dot(c, c) + _dot(d, d)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_volume_forces(
    rows: int,
    tets: NDArray[np.int32],
    alive: NDArray[np.bool_],
    rest: NDArray[np.floating],
    volumes: Volumes,
    u: NDArray[np.floating],
    F: NDArray[np.floating],
) -> None:
    """Add the forces of elements [0, rows) that are alive [N] to `F`.

    Args:
        rows: Elements [0, rows) take part.
        tets: Node rows, shape (element_capacity, 4), positively oriented at rest.
        alive: Elements that exist, shape (element_capacity,).
        rest: Rest positions [m], shape (node_capacity, 3), the kernels' precision.
        volumes: Modulus and reserve.
        u: Displacements [m], shape (node_capacity, 3).
        F: Forces on nodes [N], shape (node_capacity, 3); added to.
    """
    modulus, reserve, one, sixth = volumes
    for row in range(rows):
        if not alive[row]:
            continue
        i, j, k, m = tets[row, 0], tets[row, 1], tets[row, 2], tets[row, 3]
        d1, d2, d3 = _edge(rest, i, j), _edge(rest, i, k), _edge(rest, i, m)
        w1, w2, w3 = _edge(u, i, j), _edge(u, i, k), _edge(u, i, m)
        e1, e2, e3 = _sum(d1, w1), _sum(d2, w2), _sum(d3, w3)
        n1, n2, n3 = _cross(e2, e3), _cross(e3, e1), _cross(e1, e2)
        r1, r3 = _cross(d2, d3), _cross(d1, d2)
        change = _dot(w1, n1) + _dot(d1, _cross(w2, e3)) + _dot(r3, w3)
        p = modulus * max(-one, min(one, change / _dot(d1, r1)))
        now, most = _squares(n1, n2, n3), reserve * _squares(r1, _cross(d3, d1), r3)
        if now > most:
            p *= most / now
        p *= sixth
        for axis in range(3):
            a, b, c = p * n1[axis], p * n2[axis], p * n3[axis]
            F[i, axis] += a + b + c
            F[j, axis] -= a
            F[k, axis] -= b
            F[m, axis] -= c


@njit(cache=True, nogil=True)
def volume_stiffness(
    nodes: NDArray[np.int32],
    elements: Elements,
    rest: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Sum of G0 / V0 [m] of the elements at each node. Writes out[nodes].

    B G0 / V0 is the one eigenvalue of an element's stiffness at rest that is not zero.
    """
    for node in nodes:
        total = 0.0
        for place in range(elements.start[node], elements.start[node] + elements.degree[node]):
            i, j, k, m = elements.tets[elements.data[place]]
            d1, d2, d3 = _edge(rest, i, j), _edge(rest, i, k), _edge(rest, i, m)
            r1 = _cross(d2, d3)
            faces = _squares(r1, _cross(d3, d1), _cross(d1, d2)) / 36.0
            total += faces / (_dot(d1, r1) / 6.0)
        out[node] = total
