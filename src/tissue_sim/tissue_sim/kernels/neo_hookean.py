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
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST

SUMS = FAST | {"reassoc"}
"""Sums over a node's elements may be reordered, so that they are vectorised.

All of their operands are contiguous: there is nothing to gather.
"""


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


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def node_response(
    lanes: np.uint64,
    at: np.uint64,
    gradients: NDArray[np.floating],
    w: NDArray[np.floating],
    material: Constants,
) -> tuple[np.floating, ...]:
    """Sum of `corner_response` over the elements of a node.

    Args:
        lanes: Length of each row: elements at the node, filled up to a multiple of eight.
        at: Where the node's rows begin in `gradients`.
        gradients: Rows by node: g_a, g_b, g_c by components [1/m] and V [m^3].
        w: Displacements of the other corners relative to the node [m], nine rows.
        material: Constants.

    Returns:
        Force [N] (3), Hessian [N/m] (6) and the number of folded elements.
    """
    F0 = F1 = F2 = K00 = K01 = K02 = K11 = K12 = K22 = material.tiny - material.tiny
    folded = F0
    a1, a2, a3 = lanes, lanes + lanes, lanes + lanes + lanes
    b1, b2, b3 = a3 + a1, a3 + a2, a3 + a3
    c1, c2 = b3 + a1, b3 + a2
    g0, g1, g2, g3, g4, g5 = at, at + a1, at + a2, at + a3, at + b1, at + b2
    g6, g7, g8, g9 = at + b3, at + c1, at + c2, at + b3 + a3
    for k in range(lanes):
        f0, f1, f2, k00, k01, k02, k11, k12, k22, j = corner_response(
            (w[k], w[a1 + k], w[a2 + k]),
            (w[a3 + k], w[b1 + k], w[b2 + k]),
            (w[b3 + k], w[c1 + k], w[c2 + k]),
            (gradients[g0 + k], gradients[g1 + k], gradients[g2 + k]),
            (gradients[g3 + k], gradients[g4 + k], gradients[g5 + k]),
            (gradients[g6 + k], gradients[g7 + k], gradients[g8 + k]),
            gradients[g9 + k],
            material,
        )
        F0 += f0
        F1 += f1
        F2 += f2
        K00 += k00
        K01 += k01
        K02 += k02
        K11 += k11
        K12 += k12
        K22 += k22
        folded += material.one if j < material.folded else material.tiny
    return F0, F1, F2, K00, K01, K02, K11, K12, K22, folded
