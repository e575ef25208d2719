"""What the corotated strain of a tetrahedron is made of; inlined into the loops that need it."""

from __future__ import annotations

import numpy as np
from numba import njit

STRAIN_FAST = {"contract", "nnan", "ninf", "nsz", "arcp"}
"""What loops over strains let the compiler assume."""


@njit(inline="always")
def left_cauchy_green(rest, places, i, j, k, m):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Left Cauchy-Green tensor F F^T of a tetrahedron with corners i, j, k, m.

    Returns:
        Its components xx, yy, zz, yz, xz, xy; the determinant of F, six volumes at rest [m^3].
    """
    # Edges at rest as columns of a matrix, and its cofactors.
    ax, ay, az = rest[j, 0] - rest[i, 0], rest[j, 1] - rest[i, 1], rest[j, 2] - rest[i, 2]
    bx, by, bz = rest[k, 0] - rest[i, 0], rest[k, 1] - rest[i, 1], rest[k, 2] - rest[i, 2]
    cx, cy, cz = rest[m, 0] - rest[i, 0], rest[m, 1] - rest[i, 1], rest[m, 2] - rest[i, 2]
    ux, uy, uz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    vx, vy, vz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    wx, wy, wz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    six_volumes = ax * ux + ay * uy + az * uz
    inverse = 1.0 / six_volumes
    px, py, pz = (
        places[j, 0] - places[i, 0], places[j, 1] - places[i, 1], places[j, 2] - places[i, 2]
    )  # fmt: skip
    qx, qy, qz = (
        places[k, 0] - places[i, 0], places[k, 1] - places[i, 1], places[k, 2] - places[i, 2]
    )  # fmt: skip
    rx, ry, rz = (
        places[m, 0] - places[i, 0], places[m, 1] - places[i, 1], places[m, 2] - places[i, 2]
    )  # fmt: skip
    fxx = (px * ux + qx * vx + rx * wx) * inverse
    fxy = (px * uy + qx * vy + rx * wy) * inverse
    fxz = (px * uz + qx * vz + rx * wz) * inverse
    fyx = (py * ux + qy * vx + ry * wx) * inverse
    fyy = (py * uy + qy * vy + ry * wy) * inverse
    fyz = (py * uz + qy * vz + ry * wz) * inverse
    fzx = (pz * ux + qz * vx + rz * wx) * inverse
    fzy = (pz * uy + qz * vy + rz * wy) * inverse
    fzz = (pz * uz + qz * vz + rz * wz) * inverse
    turned = (
        fxx * (fyy * fzz - fyz * fzy)
        - fxy * (fyx * fzz - fyz * fzx)
        + fxz * (fyx * fzy - fyy * fzx)
    )
    return (
        fxx * fxx + fxy * fxy + fxz * fxz,
        fyx * fyx + fyy * fyy + fyz * fyz,
        fzx * fzx + fzy * fzy + fzz * fzz,
        fyx * fzx + fyy * fzy + fyz * fzz,
        fxx * fzx + fxy * fzy + fxz * fzz,
        fxx * fyx + fxy * fyy + fxz * fyz,
        turned,
        six_volumes,
    )


@njit(cache=True, nogil=True, error_model="numpy", fastmath=STRAIN_FAST)
def eigenvalues(
    xx: float, yy: float, zz: float, yz: float, xz: float, xy: float
) -> tuple[float, float, float]:
    """Eigenvalues of a symmetric matrix, the largest first."""
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    off = yz * yz + xz * xz + xy * xy
    p = np.sqrt((a * a + b * b + c * c + 2.0 * off) / 6.0)
    if p <= 1e-300:
        return mean, mean, mean
    det = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    r = min(1.0, max(-1.0, det / (2.0 * p * p * p)))
    angle = np.arccos(r) / 3.0
    first = mean + 2.0 * p * np.cos(angle)
    last = mean + 2.0 * p * np.cos(angle + 2.0943951023931953)
    return first, 3.0 * mean - first - last, last


@njit(inline="always")
def principal_stretches(xx, yy, zz, yz, xz, xy, turned):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Principal stretches, the largest first, from F F^T and the determinant of F.

    That of a tetrahedron turned inside out has its smallest stretch below zero.
    """
    square0, square1, square2 = eigenvalues(xx, yy, zz, yz, xz, xy)
    s2 = np.sqrt(max(square2, 0.0))
    if turned < 0.0:
        s2 = -s2
    return np.sqrt(max(square0, 0.0)), np.sqrt(max(square1, 0.0)), s2
