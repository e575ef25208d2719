"""Where a straight line of sight crosses the surface of tissue."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

MOST = 256
"""More crossings of one ray than any organ has; those found after them are left out."""

_BESIDE = 1e-9
"""How far beside a triangle a ray still counts as hitting it, as a share of its edges.

A ray through an edge that two triangles share must not slip between them; it may hit both.
"""


class Crossings(NamedTuple):
    """Where a ray crosses triangles, nearest first.

    Attributes:
        distance: From the ray's origin [m], shape (k,).
        triangle: Rows of the triangles, shape (k,).
        leaving: Whether the ray goes out of the tissue there, along the outward normal,
            shape (k,).
    """

    distance: NDArray[np.float64]
    triangle: NDArray[np.int64]
    leaving: NDArray[np.bool_]


def crossings(
    positions: NDArray[np.floating],
    triangles: NDArray[np.integer],
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
) -> Crossings:
    """All crossings of one ray with a surface.

    Args:
        positions: Node positions [m], shape (n, 3).
        triangles: Nodes of triangles with outward normals, shape (t, 3).
        origin: Where the ray begins [m], shape (3,).
        direction: Unit vector, shape (3,).
    """
    distance = np.empty(MOST)
    triangle = np.empty(MOST, dtype=np.int64)
    leaving = np.empty(MOST, dtype=np.bool_)
    count = _cross(positions, triangles, origin, direction, distance, triangle, leaving)
    order = np.argsort(distance[:count], kind="stable")
    return Crossings(distance[order], triangle[order], leaving[order])


@njit(cache=True, nogil=True, error_model="numpy")
def _cross(
    positions: NDArray[np.floating],
    triangles: NDArray[np.integer],
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
    distance: NDArray[np.float64],
    triangle: NDArray[np.int64],
    leaving: NDArray[np.bool_],
) -> int:
    """Fill the last three arrays; the number of crossings (Moeller and Trumbore 1997).

    Nearly all triangles lie on one side of a plane through the ray, and are passed over.
    """
    dx, dy, dz = direction[0], direction[1], direction[2]
    # A direction across the ray: along the axis it is least along, without its part along the ray.
    axis = np.argmin(np.abs(direction))
    nx, ny, nz = -direction[axis] * dx, -direction[axis] * dy, -direction[axis] * dz
    nx, ny, nz = nx + (axis == 0), ny + (axis == 1), nz + (axis == 2)
    at = origin[0] * nx + origin[1] * ny + origin[2] * nz
    side = np.empty(len(positions))
    largest = 0.0
    for node in range(len(positions)):
        side[node] = (
            positions[node, 0] * nx + positions[node, 1] * ny + positions[node, 2] * nz - at
        )
        largest = max(largest, abs(side[node]))
    near = _BESIDE * largest
    count = 0
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if min(side[a], side[b], side[c]) > near or max(side[a], side[b], side[c]) < -near:
            continue
        ax, ay, az = (
            np.float64(positions[a, 0]),
            np.float64(positions[a, 1]),
            np.float64(positions[a, 2]),
        )
        ux, uy, uz = positions[b, 0] - ax, positions[b, 1] - ay, positions[b, 2] - az
        vx, vy, vz = positions[c, 0] - ax, positions[c, 1] - ay, positions[c, 2] - az
        px, py, pz = dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx
        # Minus the direction times the normal (twice the area as seen along the ray).
        seen = ux * px + uy * py + uz * pz
        if seen == 0.0:
            continue
        sx, sy, sz = origin[0] - ax, origin[1] - ay, origin[2] - az
        second = (sx * px + sy * py + sz * pz) / seen
        if second < -_BESIDE or second > 1.0 + _BESIDE:
            continue
        qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
        third = (dx * qx + dy * qy + dz * qz) / seen
        if third < -_BESIDE or second + third > 1.0 + _BESIDE:
            continue
        along = (vx * qx + vy * qy + vz * qz) / seen
        if along > 0.0 and count < MOST:
            distance[count], triangle[count], leaving[count] = along, t, seen < 0.0
            count += 1
    return count
