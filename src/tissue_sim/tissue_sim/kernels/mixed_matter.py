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
from tissue_sim.kernels.springs import FAST

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
def _volume_change(k, n, at, gradients, w, e0, e1, e2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """J - 1 and cof(F) g of one lane."""
    g = at + k
    xx = xy = xz = yx = yy = yz = zx = zy = zz = e0 - e0
    g0 = g1 = g2 = e0 - e0
    for corner in range(3):
        p = 3 * corner * n
        w0, w1, w2 = w[p + k] - e0, w[p + n + k] - e1, w[p + n + n + k] - e2
        h0, h1, h2 = gradients[g + p], gradients[g + p + n], gradients[g + p + n + n]
        xx, xy, xz = xx + w0 * h0, xy + w0 * h1, xz + w0 * h2
        yx, yy, yz = yx + w1 * h0, yy + w1 * h1, yz + w1 * h2
        zx, zy, zz = zx + w2 * h0, zy + w2 * h1, zz + w2 * h2
        g0, g1, g2 = g0 - h0, g1 - h1, g2 - h2
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
def _stretch(k, n, at, rows, w, e0, e1, e2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """I_4 - |f|^2, y and s of one lane."""
    m = at + k
    d0 = d1 = d2 = s = e0 - e0
    for corner in range(3):
        p, along = 3 * corner * n, rows[m + (2 + corner) * n]
        d0 += along * (w[p + k] - e0)
        d1 += along * (w[p + n + k] - e1)
        d2 += along * (w[p + n + n + k] - e2)
        s -= along
    f0, f1, f2 = rows[m + 5 * n], rows[m + 6 * n], rows[m + 7 * n]
    half = f0 * d0 + f1 * d1 + f2 * d2
    q = half + half + (d0 * d0 + d1 * d1 + d2 * d2)
    return q, f0 + d0, f1 + d1, f2 + d2, s


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def mixed_response(lanes, start, gradients, rows, w, e0, e1, e2, half):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Force [N] (3), Hessian [N/m] (6) and two sums T of a node that has moved by e.

    T_1 + T_2 |d| times |d|^3 bounds the third derivative along a move d, over 3. The node's list
    begins at place `start`, in `gradients` and in `rows`, those of `write_matter`; `w` holds the
    displacements of the other corners before it moved [m], nine rows; `half` is 1/2 in the
    precision of the kernels.
    """
    n, at, here = np.int64(lanes), 10 * np.int64(start), ROWS * np.int64(start)
    zero = half - half
    F0 = F1 = F2 = K00 = K01 = K02 = K11 = K12 = K22 = T1 = T2 = zero * e0
    for k in range(n):
        P, stiff = rows[here + k], rows[here + n + k]
        if abs(P) > zero:
            j, c0, c1, c2 = _volume_change(k, n, at, gradients, w, e0, e1, e2)
            p = P * j
            F0, F1, F2 = F0 - p * c0, F1 - p * c1, F2 - p * c2
            p0, p1, p2 = P * c0, P * c1, P * c2
            K00, K01, K02 = K00 + p0 * c0, K01 + p0 * c1, K02 + p0 * c2
            K11, K12, K22 = K11 + p1 * c1, K12 + p1 * c2, K22 + p2 * c2
        if stiff > zero:
            q, y0, y1, y2, s = _stretch(k, n, here, rows, w, e0, e1, e2)
            pull = half * stiff * q * s
            F0, F1, F2 = F0 - pull * y0, F1 - pull * y1, F2 - pull * y2
            hold = stiff * s * s
            across = half * hold * max(q, zero)
            p0, p1, p2 = hold * y0, hold * y1, hold * y2
            K00, K01, K02 = K00 + across + p0 * y0, K01 + p0 * y1, K02 + p0 * y2
            K11, K12, K22 = K11 + across + p1 * y1, K12 + p1 * y2, K22 + across + p2 * y2
            length = np.sqrt(y0 * y0 + y1 * y1 + y2 * y2)
            T1 += hold * abs(s) * length
            T2 += hold * s * s
    return F0, F1, F2, K00, K01, K02, K11, K12, K22, T1, T2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def mixed_energy(lanes, start, gradients, rows, w, e0, e1, e2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Energy of `mixed_response` [J], zero at rest."""
    n, at, here = np.int64(lanes), 10 * np.int64(start), ROWS * np.int64(start)
    total = 0.0
    for k in range(n):
        P, stiff = np.float64(rows[here + k]), np.float64(rows[here + n + k])
        if abs(P) > 0.0:
            j, _, _, _ = _volume_change(k, n, at, gradients, w, e0, e1, e2)
            total += 0.5 * P * j * j
        if stiff > 0.0:
            q, _, _, _, _ = _stretch(k, n, here, rows, w, e0, e1, e2)
            total += 0.125 * stiff * q * q
    return total
