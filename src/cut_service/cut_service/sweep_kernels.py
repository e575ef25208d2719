"""Loops over elements, edges and points against the triangles of a sweep.

No fastmath here: which side of the sweep a node lies on must come out the same wherever it is
asked, bit for bit.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Rows = NDArray[np.int32]

EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]], dtype=np.int32)
"""Corners of a tetrahedron's six edges."""


@njit(cache=True, nogil=True, error_model="numpy")
def elements_in_box(
    positions: Reals, tets: Rows, alive: NDArray[np.bool_], lower: Reals, upper: Reals, out: Rows
) -> int:
    """Living elements whose bounding box meets a box.

    Their rows go to `out`, their number is returned.
    """
    found = 0
    for element in range(tets.shape[0]):
        if not alive[element]:
            continue
        a, b, c, d = tets[element, 0], tets[element, 1], tets[element, 2], tets[element, 3]
        apart = False
        for axis in range(3):
            xa, xb, xc, xd = (
                positions[a, axis], positions[b, axis], positions[c, axis], positions[d, axis],
            )  # fmt: skip
            if min(min(xa, xb), min(xc, xd)) > upper[axis]:
                apart = True
                break
            if max(max(xa, xb), max(xc, xd)) < lower[axis]:
                apart = True
                break
        if not apart:
            out[found] = element
            found += 1
    return found


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def above_plane(p: Reals, a: Reals, b: Reals, c: Reals) -> bool:
    """Whether a point lies on the positive side of a triangle's plane.

    A point in the plane counts as above.
    """
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return nx * (p[0] - a[0]) + ny * (p[1] - a[1]) + nz * (p[2] - a[2]) >= 0.0


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _turns_left(p: Reals, q: Reals, a: Reals, b: Reals, forward: bool) -> bool:
    """Side on which the line p q passes the segment a b, given `forward`, or b a.

    Callers order p, q and a, b the same way for every element and triangle. The two triangles at an
    edge of the sweep then see opposite sides, also when the line meets the edge exactly, so that no
    line slips through between them.
    """
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    ax, ay, az = a[0] - p[0], a[1] - p[1], a[2] - p[2]
    bx, by, bz = b[0] - p[0], b[1] - p[1], b[2] - p[2]
    volume = (
        dx * (ay * bz - az * by) + dy * (az * bx - ax * bz) + dz * (ax * by - ay * bx)
    )  # fmt: skip
    return (volume >= 0.0) == forward


@njit(cache=True, nogil=True, error_model="numpy")
def line_inside(p: Reals, q: Reals, vertices: Reals, triangle: Rows) -> bool:
    """Whether the line through two points passes through a triangle of a sweep."""
    first = False
    for side in range(3):
        i, j = triangle[side], triangle[(side + 1) % 3]
        low, high = min(i, j), max(i, j)
        left = _turns_left(p, q, vertices[low], vertices[high], i < j)
        if side == 0:
            first = left
        elif left != first:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def crossed_edges(
    positions: Reals,
    tets: Rows,
    candidates: Rows,
    vertices: Reals,
    triangles: Rows,
    masks: NDArray[np.uint8],
) -> None:
    """For each candidate element the edges that the sweep crosses, bits in the order of `EDGES`."""
    count = triangles.shape[0]
    lower, upper = np.empty((count, 3)), np.empty((count, 3))
    for t in range(count):
        for axis in range(3):
            x, y, z = (
                vertices[triangles[t, 0], axis],
                vertices[triangles[t, 1], axis],
                vertices[triangles[t, 2], axis],
            )
            lower[t, axis] = min(x, min(y, z))
            upper[t, axis] = max(x, max(y, z))
    box_low, box_high = np.empty(3), np.empty(3)
    above = np.empty(4, dtype=np.bool_)
    for k in range(candidates.shape[0]):
        nodes = tets[candidates[k]]
        for axis in range(3):
            box_low[axis] = positions[nodes[0], axis]
            box_high[axis] = box_low[axis]
            for corner in range(1, 4):
                x = positions[nodes[corner], axis]
                box_low[axis] = min(box_low[axis], x)
                box_high[axis] = max(box_high[axis], x)
        mask = 0
        for t in range(count):
            if (
                box_low[0] > upper[t, 0] or box_high[0] < lower[t, 0]
                or box_low[1] > upper[t, 1] or box_high[1] < lower[t, 1]
                or box_low[2] > upper[t, 2] or box_high[2] < lower[t, 2]
            ):  # fmt: skip
                continue
            a, b, c = (
                vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]],
            )  # fmt: skip
            number = 0
            for corner in range(4):
                above[corner] = above_plane(positions[nodes[corner]], a, b, c)
                number += above[corner]
            if number == 0 or number == 4:
                continue
            for edge in range(6):
                i, j = EDGES[edge, 0], EDGES[edge, 1]
                if above[i] == above[j] or mask & (1 << edge):
                    continue
                p, q = min(nodes[i], nodes[j]), max(nodes[i], nodes[j])
                if line_inside(positions[p], positions[q], vertices, triangles[t]):
                    mask |= 1 << edge
        masks[k] = mask


@njit(cache=True, nogil=True, error_model="numpy")
def closest_on_triangle(p: Reals, a: Reals, b: Reals, c: Reals, out: Reals) -> None:
    """The point of a triangle closest to p (Ericson 2005, Real-Time Collision Detection, 5.1.5)."""
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = np.dot(ab, ap), np.dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        out[:] = a
        return
    bp = p - b
    d3, d4 = np.dot(ab, bp), np.dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        out[:] = b
        return
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        out[:] = a + ab * (d1 / (d1 - d3))
        return
    cp = p - c
    d5, d6 = np.dot(ab, cp), np.dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        out[:] = c
        return
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        out[:] = a + ac * (d2 / (d2 - d6))
        return
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        out[:] = b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))
        return
    scale = 1.0 / (va + vb + vc)
    out[:] = a + ab * (vb * scale) + ac * (vc * scale)


@njit(cache=True, nogil=True, error_model="numpy")
def closest_on_sweep(
    points: Reals, corners: Reals, nearest: Reals, distances: Reals, which: Rows
) -> None:
    """Closest point of the sweep, its distance and its triangle for every point.

    Results into the last three.
    """
    place = np.empty(3)
    for k in range(points.shape[0]):
        best = np.inf
        for t in range(corners.shape[0]):
            closest_on_triangle(points[k], corners[t, 0], corners[t, 1], corners[t, 2], place)
            dx, dy, dz = points[k, 0] - place[0], points[k, 1] - place[1], points[k, 2] - place[2]
            square = dx * dx + dy * dy + dz * dz
            if square < best:
                best = square
                which[k] = t
                nearest[k] = place
        distances[k] = np.sqrt(best)
