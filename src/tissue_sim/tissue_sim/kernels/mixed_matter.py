"""What regions and fibres add to the stable neo-Hookean energy of tetrahedra, seen from one corner.

Symbols as in `neo_hookean`: H, g_a, J, c = cof(F) g, w_a = u_a - u_i; f is the unit vector along an
element's fibres at rest, s_a = f . g_a, s = f . g = -sum_a s_a.

*Regions.* The homogeneous kernel runs with volumes scaled by mu_t / mu, mu_t the element's own
modulus and mu the tissue's. That is right for all terms but the one in J; with
P = V (lam_t - lam mu_t / mu) the rest is

    energy P/2 (J - 1)^2,   force -P (J - 1) c,   Hessian P c c^T,

so that only the sum of both kernels is positive where P is negative.

*Fibres* (standard reinforcing model) of stiffness k have the energy V k/8 (I_4 - 1)^2 with
I_4 = |F f|^2: half the stiffness times the square of Green's strain along f, and so of the linear
strain where that is small. With y = F f = f + sum_a s_a w_a and q = I_4 - |f|^2 = 2 f.(y - f) +
|y - f|^2,

    force -V k/2 q s y,   Hessian V k s^2 (q/2 I + y y^T),

of which a negative q/2, that of shortened fibres, is left out, so that it is positive
semidefinite. Along a move e the third derivative is at most 3 V k |s|^3 (|y| + |s| |e|) |e|^3.

References:
    G. Y. Qiu, T. J. Pence, Remarks on the behavior of simple directionally reinforced
    incompressible nonlinearly elastic solids, Journal of Elasticity 49, 1997,
    doi 10.1023/A:1007410321319.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.matter import Matter
from tissue_sim.kernels.neo_hookean import _gradient
from tissue_sim.kernels.springs import FAST
from tissue_sim.kernels.vectors import LANES, bits, fetch_points, load, root, select, splat, total

ROWS = 8
"""Rows of a node's list: P, V k, s_a, s_b, s_c and f by components."""

ROUNDING = 1e-12
"""Share of lambda below which a difference is none."""


@njit(cache=True, nogil=True)
def write_matter(
    lane: int,
    lanes: int,
    at: int,
    volume: float,
    element: int,
    base: NDArray[np.float64],
    matter: Matter,
    gradients: NDArray[np.float64],
    out: NDArray[np.floating],
) -> None:
    """Write one lane of a node's rows.

    Args:
        lane: Place in the rows.
        lanes: Length of each row.
        at: Where the node's rows begin.
        volume: Rest volume V [m^3]; 0 on filled-up places.
        element: Row of the element.
        base: lambda and mu of the tissue's own [Pa].
        matter: What the elements are made of.
        gradients: g_a, g_b, g_c [1/m], shape (9,).
        out: The rows; written.
    """
    for row in range(ROWS):
        out[at + row * lanes + lane] = 0.0
    if volume == 0.0:
        return
    kind = matter.kind[element]
    lam, mu, k = matter.table[kind, 0], matter.table[kind, 1], matter.table[kind, 2]
    # lam + 5/6 mu less mu / mu_0 times the same of the tissue's own, in which 5/6 mu drops out.
    more = lam - base[0] * (mu / base[1])
    out[at + lane] = volume * more if abs(more) > ROUNDING * lam else 0.0
    out[at + lanes + lane] = volume * k
    for axis in range(3):
        f = matter.fibres[element, axis]
        out[at + (5 + axis) * lanes + lane] = f
        for corner in range(3):
            out[at + (2 + corner) * lanes + lane] += f * gradients[3 * corner + axis]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _volume_change(a, b, c, ga, gb, gc):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """J - 1 and cof(F) g from relative displacements and gradients of three corners."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = _gradient(a, b, c, ga, gb, gc)
    g0, g1, g2 = -(ga[0] + gb[0] + gc[0]), -(ga[1] + gb[1] + gc[1]), -(ga[2] + gb[2] + gc[2])
    XX, XY, XZ = yy * zz - yz * zy, yz * zx - yx * zz, yx * zy - yy * zx
    YX, YY, YZ = xz * zy - xy * zz, xx * zz - xz * zx, xy * zx - xx * zy
    ZX, ZY, ZZ = xy * yz - xz * yy, xz * yx - xx * yz, xx * yy - xy * yx
    trace = xx + yy + zz
    j = trace + (XX + YY + ZZ) + (xx * XX + xy * XY + xz * XZ)
    # cof F = (1 + tr H) I - H^T + cof H.
    c0 = g0 + (trace - xx + XX) * g0 + (XY - yx) * g1 + (XZ - zx) * g2
    c1 = g1 + (YX - xy) * g0 + (trace - yy + YY) * g1 + (YZ - zy) * g2
    c2 = g2 + (ZX - xz) * g0 + (ZY - yz) * g1 + (trace - zz + ZZ) * g2
    return j, c0, c1, c2


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _stretch(a, b, c, sa, sb, sc, f):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """I_4 - |f|^2, y and s from relative displacements of three corners."""
    d0 = sa * a[0] + sb * b[0] + sc * c[0]
    d1 = sa * a[1] + sb * b[1] + sc * c[1]
    d2 = sa * a[2] + sb * b[2] + sc * c[2]
    half = f[0] * d0 + f[1] * d1 + f[2] * d2
    q = half + half + (d0 * d0 + d1 * d1 + d2 * d2)
    return q, f[0] + d0, f[1] + d1, f[2] + d2, -(sa + sb + sc)


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _corners(k, n, w, e0, e1, e2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Displacements of three corners of one lane relative to the node, which has moved by e."""
    n2 = n + n
    n3 = n2 + n
    n6 = n3 + n3
    return (
        (w[k] - e0, w[n + k] - e1, w[n2 + k] - e2),
        (w[n3 + k] - e0, w[n3 + n + k] - e1, w[n3 + n2 + k] - e2),
        (w[n6 + k] - e0, w[n6 + n + k] - e1, w[n6 + n2 + k] - e2),
    )


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _gradients(k, n, at, gradients):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """g_a, g_b and g_c of one lane."""
    g, n2 = at + k, n + n
    n3 = n2 + n
    n6 = n3 + n3
    return (
        (gradients[g], gradients[g + n], gradients[g + n2]),
        (gradients[g + n3], gradients[g + n3 + n], gradients[g + n3 + n2]),
        (gradients[g + n6], gradients[g + n6 + n], gradients[g + n6 + n2]),
    )


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _fibre(k, n, here, rows):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """V k, s_a, s_b, s_c and f of one lane."""
    m, n2 = here + k, n + n
    n4 = n2 + n2
    return (
        rows[m + n],
        rows[m + n2],
        rows[m + n2 + n],
        rows[m + n4],
        (rows[m + n4 + n], rows[m + n4 + n2], rows[m + n4 + n2 + n]),
    )


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _places(lanes, start):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Length of a row, and where the node's rows begin in `gradients` and in `rows`: unsigned."""
    n, first = np.uint64(lanes), np.uint64(start)
    two = first + first
    eight = two + two + two + two
    return n, eight + two, eight


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _pressing(P, j, c0, c1, c2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Force and Hessian of the terms in P."""
    p = P * j
    p0, p1, p2 = P * c0, P * c1, P * c2
    return (
        -(p * c0), -(p * c1), -(p * c2), p0 * c0, p0 * c1, p0 * c2, p1 * c1, p1 * c2, p2 * c2,
    )  # fmt: skip


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _reinforcing(stiff, q, stretched, y0, y1, y2, s, half):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Force and Hessian of fibres, `stretched` being q or 0; V k s^2."""
    pull, hold = half * stiff * q * s, stiff * s * s
    across = half * hold * stretched
    p0, p1, p2 = hold * y0, hold * y1, hold * y2
    return (
        -(pull * y0), -(pull * y1), -(pull * y2), across + p0 * y0, p0 * y1, p0 * y2,
        across + p1 * y1, p1 * y2, across + p2 * y2, hold,
    )  # fmt: skip


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _added(sums, more):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return (
        sums[0] + more[0], sums[1] + more[1], sums[2] + more[2], sums[3] + more[3],
        sums[4] + more[4], sums[5] + more[5], sums[6] + more[6], sums[7] + more[7],
        sums[8] + more[8],
    )  # fmt: skip


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _loaded(array, at, n):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Eight lanes of three rows."""
    return load(array, at), load(array, at + n), load(array, at + 2 * n)


@njit(inline="always", error_model="numpy", fastmath=FAST)
def mixed_sums(i, lanes, first, corners, gradients, rows, u, zero, half):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Force [N] (3), Hessian [N/m] (6) and two sums T of node i, eight elements at once.

    T_1 + T_2 |d| times |d|^3 bounds the third derivative along a move d, over 3. The lists are as
    in `neo_hookean.node_response`, `rows` those of `write_matter`; `zero` and `half` are numbers in
    the precision of the kernels.
    """
    none = splat(zero)
    sums = (none, none, none, none, none, none, none, none, none)
    T1 = T2 = none
    u0, u1, u2 = u[i, 0], u[i, 1], u[i, 2]
    n, begin = np.int64(lanes), np.int64(first)
    for k in range(0, n, LANES):
        at, g, m = 3 * begin + k, 10 * begin + k, ROWS * begin + k
        P, stiff = load(rows, m), load(rows, m + n)
        a0, a1, a2 = fetch_points(u, corners, at)
        b0, b1, b2 = fetch_points(u, corners, at + n)
        c0, c1, c2 = fetch_points(u, corners, at + 2 * n)
        a, b, c = (
            (a0 - u0, a1 - u1, a2 - u2),
            (b0 - u0, b1 - u1, b2 - u2),
            (c0 - u0, c1 - u1, c2 - u2),
        )
        if bits(zero < P * P):
            ga, gb, gc = (
                _loaded(gradients, g, n),
                _loaded(gradients, g + 3 * n, n),
                _loaded(gradients, g + 6 * n, n),
            )
            j, x0, x1, x2 = _volume_change(a, b, c, ga, gb, gc)
            sums = _added(sums, _pressing(P, j, x0, x1, x2))
        if bits(stiff > zero):
            q, y0, y1, y2, s = _stretch(
                a, b, c, load(rows, m + 2 * n), load(rows, m + 3 * n), load(rows, m + 4 * n),
                _loaded(rows, m + 5 * n, n),
            )  # fmt: skip
            found = _reinforcing(stiff, q, select(q > zero, q, zero), y0, y1, y2, s, half)
            sums = _added(sums, found)
            hold = found[9]
            T1 = T1 + hold * select(s > zero, s, -s) * root(y0 * y0 + y1 * y1 + y2 * y2)
            T2 = T2 + hold * s * s
    return (
        total(sums[0]), total(sums[1]), total(sums[2]), total(sums[3]), total(sums[4]),
        total(sums[5]), total(sums[6]), total(sums[7]), total(sums[8]), total(T1), total(T2),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def mixed_response(lanes, start, gradients, rows, w, e0, e1, e2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Force [N] (3) and Hessian [N/m] (6) of a node that has moved by e, in double precision.

    The node's list begins at place `start`; `w` holds the displacements of the other corners before
    it moved [m], nine rows.
    """
    n, at, here = _places(lanes, start)
    sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for k in range(n):
        a, b, c = _corners(k, n, w, e0, e1, e2)
        ga, gb, gc = _gradients(k, n, at, gradients)
        j, c0, c1, c2 = _volume_change(a, b, c, ga, gb, gc)
        sums = _added(sums, _pressing(np.float64(rows[here + k]), j, c0, c1, c2))
        stiff, sa, sb, sc, f = _fibre(k, n, here, rows)
        q, y0, y1, y2, s = _stretch(a, b, c, sa, sb, sc, f)
        found = _reinforcing(np.float64(stiff), q, max(q, 0.0), y0, y1, y2, s, 0.5)
        sums = _added(sums, found)
    return sums


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def mixed_energy(lanes, start, gradients, rows, w, e0, e1, e2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Energy of `mixed_response` [J], zero at rest."""
    n, at, here = _places(lanes, start)
    total = 0.0
    for k in range(n):
        a, b, c = _corners(k, n, w, e0, e1, e2)
        ga, gb, gc = _gradients(k, n, at, gradients)
        j, _, _, _ = _volume_change(a, b, c, ga, gb, gc)
        stiff, sa, sb, sc, f = _fibre(k, n, here, rows)
        q, _, _, _, _ = _stretch(a, b, c, sa, sb, sc, f)
        total += 0.5 * np.float64(rows[here + k]) * j * j + 0.125 * np.float64(stiff) * q * q
    return total
