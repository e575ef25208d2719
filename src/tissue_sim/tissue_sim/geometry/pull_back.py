"""Where a place at rest lies in elements that have been deformed."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FARTHEST = 10.0
"""Largest barycentric weight of a place in an element that is made use of."""


@njit(cache=True, nogil=True, error_model="numpy")
def _weigh(
    rest: NDArray[np.float64],
    tet: NDArray[np.int32],
    place: NDArray[np.float64],
    e: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Barycentric weights of a place in a tetrahedron; not finite in a flat one."""
    for axis in range(3):
        for corner in range(3):
            e[corner, axis] = rest[tet[corner + 1], axis] - rest[tet[0], axis]
        e[3, axis] = place[axis] - rest[tet[0], axis]
    total = 0.0
    for corner in range(3):
        j, k = (corner + 1) % 3, (corner + 2) % 3
        n0 = e[j, 1] * e[k, 2] - e[j, 2] * e[k, 1]
        n1 = e[j, 2] * e[k, 0] - e[j, 0] * e[k, 2]
        n2 = e[j, 0] * e[k, 1] - e[j, 1] * e[k, 0]
        volume = e[corner, 0] * n0 + e[corner, 1] * n1 + e[corner, 2] * n2
        out[corner + 1] = (e[3, 0] * n0 + e[3, 1] * n1 + e[3, 2] * n2) / volume
        total += out[corner + 1]
    out[0] = 1.0 - total


@njit(cache=True, nogil=True, error_model="numpy")
def _weigh_flat(
    rest: NDArray[np.float64],
    tet: NDArray[np.int32],
    place: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Barycentric weights of the foot of a place in a triangle; not finite in a flat one."""
    uu = uv = vv = up = vp = 0.0
    for axis in range(3):
        u = rest[tet[1], axis] - rest[tet[0], axis]
        v = rest[tet[2], axis] - rest[tet[0], axis]
        p = place[axis] - rest[tet[0], axis]
        uu, uv, vv, up, vp = uu + u * u, uv + u * v, vv + v * v, up + u * p, vp + v * p
    area = uu * vv - uv * uv
    out[1] = (vv * up - uv * vp) / area
    out[2] = (uu * vp - uv * up) / area
    out[0], out[3] = 1.0 - out[1] - out[2], 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def find_anchors(
    rest: NDArray[np.float64],
    tets: NDArray[np.int32],
    place_of: NDArray[np.int32],
    targets: NDArray[np.float64],
    anchors: NDArray[np.int32],
    weights: NDArray[np.float64],
) -> None:
    """For places near nodes, the element at the node that contains each, or is closest to do so.

    Args:
        rest: Rest positions [m], shape (n, 3).
        tets: Node rows of elements, shape (e, 4); those of a sheet are -1 in some places.
        place_of: Place of each node in `targets`, -1 for none, shape (n,).
        targets: Places [m], shape (m, 3).
        anchors: Nodes of the element found, shape (m, 4); kept where there is none, written. A
            triangle has no last one, whose weight is 0.
        weights: Weights of the place in it, shape (m, 4); kept where there is none, written.
    """
    best = np.full(len(targets), -FARTHEST)
    e, found = np.empty((4, 3)), np.empty(4)
    for tet in tets:
        corners = 4 if tet[3] >= 0 else 3
        if tet[2] < 0:
            continue  # A spring of a sheet contains no place.
        for corner in range(corners):
            k = place_of[tet[corner]]
            if k < 0:
                continue
            if corners == 4:
                _weigh(rest, tet, targets[k], e, found)
            else:
                _weigh_flat(rest, tet, targets[k], found)
            least, most = found[:corners].min(), found[:corners].max()
            if least > best[k] and most < FARTHEST:
                best[k] = least
                anchors[k, :corners], weights[k] = tet[:corners], found
