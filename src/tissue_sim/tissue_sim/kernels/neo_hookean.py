"""Stable neo-Hookean energy of tetrahedra, seen from one corner.

Symbols: H = grad u = sum_a (u_a - u_i) (x) g_a over the three other corners a of an element at node
i, g_a the rest gradients of their shape functions, g = -sum_a g_a that of node i, F = I + H,
I_C = |F|^2, J = det F, V the rest volume. The energy of Smith and others, without its constant:

    Psi = mu/2 (I_C - 3) + lam/2 (J - alpha)^2 - mu/2 log(I_C + 1),   alpha = 1 + 3 mu / (4 lam).

With q = I_C - 3 = 2 tr H + |H|^2 and j = J - 1 = tr H + tr cof H + det H its stress times g is

    P g = mu/4 q/(q + 4) p + lam j c + 3 mu/4 d,    p = F g,  c = cof(F) g,
    d = p - c = H g + H^T g - tr(H) g - cof(H) g,

in which nothing is subtracted that is of the size of mu: tissue at rest, or moved without turning,
has no force bit for bit, and small strains are exact to round-off in single precision. A move e of
node i changes F by e (x) g, I_C by a convex square and J by a linear term; so the energy is *convex
in one node's position*, however the element is deformed, and its Hessian there

    K = V [(3 mu/4 + mu/4 q/(q + 4)) |g|^2 I + 2 mu/(q + 4)^2 p p^T + lam c c^T]

is positive semidefinite without any projection; inverted elements are no exception.

References:
    B. Smith, F. de Goes, T. Kim, Stable neo-Hookean flesh simulation, ACM Transactions on Graphics
    37(2), 2018, doi 10.1145/3180491.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from tissue_sim.kernels.springs import FAST
from tissue_sim.kernels.vectors import LANES, bits, fetch_points, load, splat, total

FOLDED = 0.1
"""Share of its volume below which an element is crushed; inverted ones have less than none."""


class Constants(NamedTuple):
    """The material in a kernel's precision, so that no product becomes a double.

    Attributes:
        shear: 3 mu / 4 [Pa], Lame's shear modulus at small strain.
        quarter: mu / 4 [Pa].
        double: 2 mu [Pa].
        bulk: lam [Pa].
        one: 1.
        four: 4.
        folded: Elements with less than this j count as folded: crushed or inverted.
        tiny: `kernels.springs.TINY`.
    """

    shear: np.floating
    quarter: np.floating
    double: np.floating
    bulk: np.floating
    one: np.floating
    four: np.floating
    folded: np.floating
    tiny: np.floating


def constants(
    young_modulus: float, poisson_ratio: float, dtype: type[np.floating], tiny: np.floating
) -> Constants:
    """Smith's constants for a material whose linear limit is Hooke's law.

    mu = 4/3 mu_L and lam = lam_L + 5/6 mu_L (section 3.4 of the paper).
    """
    mu_linear = young_modulus / (2 * (1 + poisson_ratio))
    lam_linear = young_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    mu, lam = 4 / 3 * mu_linear, lam_linear + 5 / 6 * mu_linear
    numbers = (0.75 * mu, 0.25 * mu, 2 * mu, lam, 1.0, 4.0, FOLDED - 1.0, float(tiny))
    return Constants(*(dtype(number) for number in numbers))


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _gradient(a, b, c, ga, gb, gc):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """H, row by row, from relative displacements and gradients of three corners."""
    return (
        a[0] * ga[0] + b[0] * gb[0] + c[0] * gc[0],
        a[0] * ga[1] + b[0] * gb[1] + c[0] * gc[1],
        a[0] * ga[2] + b[0] * gb[2] + c[0] * gc[2],
        a[1] * ga[0] + b[1] * gb[0] + c[1] * gc[0],
        a[1] * ga[1] + b[1] * gb[1] + c[1] * gc[1],
        a[1] * ga[2] + b[1] * gb[2] + c[1] * gc[2],
        a[2] * ga[0] + b[2] * gb[0] + c[2] * gc[0],
        a[2] * ga[1] + b[2] * gb[1] + c[2] * gc[1],
        a[2] * ga[2] + b[2] * gb[2] + c[2] * gc[2],
    )


@njit(inline="always", error_model="numpy", fastmath=FAST)
def corner_response(a, b, c, ga, gb, gc, V, material):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Force -V P g [N], Hessian K [N/m], upper triangle by rows, and j of one element at a node."""
    shear, quarter, double, bulk, one, four, _, _ = material
    xx, xy, xz, yx, yy, yz, zx, zy, zz = _gradient(a, b, c, ga, gb, gc)
    g0, g1, g2 = -(ga[0] + gb[0] + gc[0]), -(ga[1] + gb[1] + gc[1]), -(ga[2] + gb[2] + gc[2])
    # cof H
    XX, XY, XZ = yy * zz - yz * zy, yz * zx - yx * zz, yx * zy - yy * zx
    YX, YY, YZ = xz * zy - xy * zz, xx * zz - xz * zx, xy * zx - xx * zy
    ZX, ZY, ZZ = xy * yz - xz * yy, xz * yx - xx * yz, xx * yy - xy * yx
    trace = xx + yy + zz
    j = trace + (XX + YY + ZZ) + (xx * XX + xy * XY + xz * XZ)
    squares = xx * xx + xy * xy + xz * xz + yx * yx + yy * yy + yz * yz
    q = trace + trace + (squares + zx * zx + zy * zy + zz * zz)
    h0 = xx * g0 + xy * g1 + xz * g2
    h1 = yx * g0 + yy * g1 + yz * g2
    h2 = zx * g0 + zy * g1 + zz * g2
    d0 = h0 + (xx - trace) * g0 + yx * g1 + zx * g2 - (XX * g0 + XY * g1 + XZ * g2)
    d1 = h1 + xy * g0 + (yy - trace) * g1 + zy * g2 - (YX * g0 + YY * g1 + YZ * g2)
    d2 = h2 + xz * g0 + yz * g1 + (zz - trace) * g2 - (ZX * g0 + ZY * g1 + ZZ * g2)
    p0, p1, p2 = g0 + h0, g1 + h1, g2 + h2
    c0, c1, c2 = p0 - d0, p1 - d1, p2 - d2
    r = one / (q + four)
    m = quarter * q * r
    along, shearing, pressing = V * m, V * shear, V * bulk * j
    isotropic = V * (shear + m) * (g0 * g0 + g1 * g1 + g2 * g2)
    radial, normal = V * double * r * r, V * bulk
    s0, s1, s2 = radial * p0, radial * p1, radial * p2
    t0, t1, t2 = normal * c0, normal * c1, normal * c2
    return (
        -(along * p0 + pressing * c0 + shearing * d0),
        -(along * p1 + pressing * c1 + shearing * d1),
        -(along * p2 + pressing * c2 + shearing * d2),
        isotropic + s0 * p0 + t0 * c0,
        s0 * p1 + t0 * c1,
        s0 * p2 + t0 * c2,
        isotropic + s1 * p1 + t1 * c1,
        s1 * p2 + t1 * c2,
        isotropic + s2 * p2 + t2 * c2,
        j,
    )


@njit(inline="always", error_model="numpy", fastmath=FAST)
def corner_energy(a, b, c, ga, gb, gc, V, material):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Elastic energy of one element [J], zero at rest."""
    shear, quarter, _, bulk, one, four, _, _ = material
    xx, xy, xz, yx, yy, yz, zx, zy, zz = _gradient(a, b, c, ga, gb, gc)
    XX, XY, XZ = yy * zz - yz * zy, yz * zx - yx * zz, yx * zy - yy * zx
    YY, ZZ = xx * zz - xz * zx, xx * yy - xy * yx
    trace = xx + yy + zz
    j = trace + (XX + YY + ZZ) + (xx * XX + xy * XY + xz * XZ)
    squares = xx * xx + xy * xy + xz * xz + yx * yx + yy * yy + yz * yz
    q = trace + trace + (squares + zx * zx + zy * zy + zz * zz)
    half = one / (one + one)
    stretch = (quarter + quarter) * (q - np.log1p(q / four))
    return V * (stretch + half * bulk * j * j - shear * j)


@njit(inline="always", error_model="numpy", fastmath=FAST)
def node_response(i, lanes, first, corners, gradients, u, material):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Sum of `corner_response` over the elements of a node, eight elements at once.

    Args:
        i: Row of the node.
        lanes: Length of each of its rows: elements at the node, filled up to a multiple of eight.
        first: First place of its list.
        corners: Three rows by node: the other corners.
        gradients: Ten rows by node: g_a, g_b, g_c by components [1/m] and V [m^3].
        u: Displacements [m], shape (node_capacity, 3).
        material: Constants.

    Returns:
        Force [N] (3), Hessian [N/m] (6) and whether an element is folded.
    """
    zero = material.tiny - material.tiny
    F0 = F1 = F2 = K00 = K01 = K02 = K11 = K12 = K22 = splat(zero)
    u0, u1, u2 = u[i, 0], u[i, 1], u[i, 2]
    n, begin = np.int64(lanes), np.int64(first)
    folded = 0
    for k in range(0, n, LANES):
        at, g = 3 * begin + k, 10 * begin + k
        a0, a1, a2 = fetch_points(u, corners, at)
        b0, b1, b2 = fetch_points(u, corners, at + n)
        c0, c1, c2 = fetch_points(u, corners, at + 2 * n)
        f0, f1, f2, k00, k01, k02, k11, k12, k22, j = corner_response(
            (a0 - u0, a1 - u1, a2 - u2),
            (b0 - u0, b1 - u1, b2 - u2),
            (c0 - u0, c1 - u1, c2 - u2),
            (load(gradients, g), load(gradients, g + n), load(gradients, g + 2 * n)),
            (load(gradients, g + 3 * n), load(gradients, g + 4 * n), load(gradients, g + 5 * n)),
            (load(gradients, g + 6 * n), load(gradients, g + 7 * n), load(gradients, g + 8 * n)),
            load(gradients, g + 9 * n),
            material,
        )
        F0, F1, F2 = F0 + f0, F1 + f1, F2 + f2
        K00, K01, K02 = K00 + k00, K01 + k01, K02 + k02
        K11, K12, K22 = K11 + k11, K12 + k12, K22 + k22
        folded |= bits(j < material.folded)
    return (
        total(F0), total(F1), total(F2), total(K00), total(K01), total(K02), total(K11),
        total(K12), total(K22), folded != 0,
    )  # fmt: skip
