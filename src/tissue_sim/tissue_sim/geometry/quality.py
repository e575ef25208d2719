"""Sizes and shapes of tetrahedra."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def signed_volumes(points: NDArray[np.float64], tets: NDArray[np.integer]) -> NDArray[np.float64]:
    """Signed volumes of tetrahedra [m^3], positive if right-handed, shape (element_count,)."""
    a, b, c, d = (points[tets[:, corner]] for corner in range(4))
    return np.asarray(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0)


@njit(cache=True, nogil=True)
def total_volume(
    rest: NDArray[np.float64],
    displacement: NDArray[np.floating],
    tets: NDArray[np.int32],
    alive: NDArray[np.bool_],
) -> float:
    """Sum of the signed volumes of displaced tetrahedra [m^3]; quick enough for every frame.

    Args:
        rest: Rest positions of nodes [m], shape (n, 3).
        displacement: Displacements from there [m], shape (n, 3).
        tets: Nodes of the tetrahedra, shape (element_count, 4).
        alive: Which of them count, shape (element_count,).
    """
    total = 0.0
    edge = np.empty((3, 3))
    for element in range(len(tets)):
        if not alive[element]:
            continue
        first = tets[element, 0]
        for corner in range(3):
            node = tets[element, corner + 1]
            for axis in range(3):
                edge[corner, axis] = (rest[node, axis] - rest[first, axis]) + (
                    displacement[node, axis] - displacement[first, axis]
                )
        u, v, w = edge[0], edge[1], edge[2]
        total += (
            u[0] * (v[1] * w[2] - v[2] * w[1])
            + u[1] * (v[2] * w[0] - v[0] * w[2])
            + u[2] * (v[0] * w[1] - v[1] * w[0])
        )
    return total / 6.0


@njit(cache=True, nogil=True)
def count_flat(
    points: NDArray[np.float64],
    place_of: NDArray[np.int32],
    places: NDArray[np.float64],
    tets: NDArray[np.int32],
) -> int:
    """Number of tetrahedra whose volume is not positive; quick enough for use in a frame.

    Args:
        points: Positions of nodes [m], shape (n, 3).
        place_of: For each node, -1 or the row of `places` that it is at instead.
        places: Other positions [m], shape (m, 3).
        tets: Nodes of the tetrahedra, shape (element_count, 4).
    """
    flat = 0
    x = np.empty((4, 3))
    for element in range(len(tets)):
        for corner in range(4):
            node = tets[element, corner]
            place = place_of[node]
            for axis in range(3):
                x[corner, axis] = points[node, axis] if place < 0 else places[place, axis]
        u0, u1, u2 = x[1, 0] - x[0, 0], x[1, 1] - x[0, 1], x[1, 2] - x[0, 2]
        v0, v1, v2 = x[2, 0] - x[0, 0], x[2, 1] - x[0, 1], x[2, 2] - x[0, 2]
        w0, w1, w2 = x[3, 0] - x[0, 0], x[3, 1] - x[0, 1], x[3, 2] - x[0, 2]
        volume = u0 * (v1 * w2 - v2 * w1) + u1 * (v2 * w0 - v0 * w2) + u2 * (v0 * w1 - v1 * w0)
        if not volume > 0.0:
            flat += 1
    return flat


def longest_edges(points: NDArray[np.float64], tets: NDArray[np.integer]) -> NDArray[np.float64]:
    """Length of the longest edge of each tetrahedron [m], shape (element_count,)."""
    longest = np.zeros(len(tets))
    for i, j in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)):
        edge = points[tets[:, j]] - points[tets[:, i]]
        np.maximum(longest, np.einsum("ij,ij->i", edge, edge), out=longest)
    return np.asarray(np.sqrt(longest))


def radius_ratios(points: NDArray[np.float64], tets: NDArray[np.integer]) -> NDArray[np.float64]:
    """Quality q = 3 x inscribed / circumscribed radius, 1 regular, 0 flat, shape (elements,)."""
    a, b, c, d = (points[tets[:, corner]] for corner in range(4))
    u, v, w = b - a, c - a, d - a
    vw, wu, uv = np.cross(v, w), np.cross(w, u), np.cross(u, v)
    six_volumes = np.abs(np.einsum("ij,ij->i", u, vw))
    double_area = sum(np.linalg.norm(n, axis=1) for n in (vw, wu, uv, vw + wu + uv))
    squares = [np.einsum("ij,ij->i", e, e)[:, None] for e in (u, v, w)]
    # R = |u^2 (v x w) + v^2 (w x u) + w^2 (u x v)| / 12 V and r = 3 V / area
    numerator = np.linalg.norm(squares[0] * vw + squares[1] * wu + squares[2] * uv, axis=1)
    denominator = double_area * numerator
    safe = np.where(denominator > 0, denominator, 1.0)
    return np.asarray(np.where(denominator > 0, 6.0 * six_volumes**2 / safe, 0.0))
