"""Loops of a probe: which nodes are near it, and what they are to it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Rows = NDArray[np.int32]


class Capsule(NamedTuple):
    """A sphere swept along its axis.

    Attributes:
        tip: Where the axis begins [m], shape (3,).
        shaft: Unit direction of the axis, shape (3,).
        length: Of the axis [m]; 0: a sphere.
        radius: Of the sphere [m].
    """

    tip: Reals
    shaft: Reals
    length: float
    radius: float


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _squared_way(rest, u, node, capsule, way):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Squared distance of a node from the axis [m^2]; writes the way from it."""
    along = 0.0
    for d in range(3):
        way[d] = rest[node, d] + u[node, d] - capsule.tip[d]
        along += way[d] * capsule.shaft[d]
    along = min(max(along, 0.0), capsule.length)
    squared = 0.0
    for d in range(3):
        way[d] -= along * capsule.shaft[d]
        squared += way[d] * way[d]
    return squared


@njit(cache=True, nogil=True, error_model="numpy")
def nodes_near_axis(
    candidates: Rows,
    rest: Reals,
    u: NDArray[np.floating],
    capsule: Capsule,
    reach: float,
    found: Rows,
) -> int:
    """Find the candidates within a distance of an axis.

    Args:
        candidates: Rows that are looked at, shape (c,).
        rest: Rest positions [m], shape (n, 3).
        u: Displacements [m], shape (n, 3).
        capsule: Whose axis it is.
        reach: The distance [m].
        found: Rows found, in the order of the candidates; written, shape (c,) at least.

    Returns:
        How many there are.
    """
    count, way = 0, np.empty(3)
    for node in candidates:
        if _squared_way(rest, u, node, capsule, way) <= reach * reach:
            found[count] = node
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def gaps(
    nodes: Rows,
    rest: Reals,
    u: NDArray[np.floating],
    capsule: Capsule,
    gap: Reals,
    normal: Reals,
) -> None:
    """Signed distances of nodes from a probe, negative inside, and directions out of it.

    Args:
        nodes: Rows, shape (k,).
        rest: Rest positions [m], shape (n, 3).
        u: Displacements [m], shape (n, 3).
        capsule: The probe.
        gap: Written [m], shape (k,).
        normal: Written, shape (k, 3); the shaft's where a node lies on the axis.
    """
    way = np.empty(3)
    for k in range(len(nodes)):
        distance = math.sqrt(_squared_way(rest, u, nodes[k], capsule, way))
        gap[k] = distance - capsule.radius
        for d in range(3):
            normal[k, d] = way[d] / distance if distance > 1e-12 else capsule.shaft[d]


@njit(cache=True, nogil=True, error_model="numpy")
def _cross_size(rest, a, b, c):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    px, py, pz = rest[b, 0] - rest[a, 0], rest[b, 1] - rest[a, 1], rest[b, 2] - rest[a, 2]
    qx, qy, qz = rest[c, 0] - rest[a, 0], rest[c, 1] - rest[a, 1], rest[c, 2] - rest[a, 2]
    x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    return math.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True, error_model="numpy")
def _is_border(tets, elements, own, a, b, c):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Whether no other one of the elements has the face."""
    for e in elements:
        if e == own:
            continue
        there = 0
        for corner in range(4):
            node = tets[e, corner]
            there += node in (a, b, c)
        if there == 3:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def surface_at(
    nodes: Rows,
    tets: Rows,
    start: NDArray[np.int64],
    count: Rows,
    data: Rows,
    rest: Reals,
    area: Reals,
    stiffness: Reals,
) -> None:
    """Surface that belongs to nodes, and how stiffly their elements resist them.

    A third of each triangle of the surface at a node is its own; nodes inside have none. The sum
    of V |grad N|^2 over the elements at a node, times lambda + 2 mu, bounds the largest eigenvalue
    of its block of the stiffness matrix.

    Args:
        nodes: Rows, shape (k,).
        tets: Elements, shape (m, 4); of sheets, with -1 behind their corners.
        start: Where each node's list of elements begins in `data` (`geometry.incidence`).
        count: Elements at each node.
        data: Their rows.
        rest: Rest positions [m], shape (n, 3).
        area: Written [m^2], shape (k,).
        stiffness: Sum of V |grad N|^2 [m], written, shape (k,).
    """
    for k in range(len(nodes)):
        i = nodes[k]
        elements = data[start[i] : start[i] + count[i]]
        area[k] = stiffness[k] = 0.0
        for e in elements:
            a, b, c, d = tets[e, 0], tets[e, 1], tets[e, 2], tets[e, 3]
            if c < 0:
                continue
            if d < 0:
                area[k] += _cross_size(rest, a, b, c) / 6.0
                continue
            others = (b, c, d) if i == a else (a, c, d) if i == b else (a, b, d)
            if i == d:
                others = (a, b, c)
            x, y, z = others
            for face in ((i, x, y), (i, y, z), (i, x, z)):
                if _is_border(tets, elements, e, face[0], face[1], face[2]):
                    area[k] += _cross_size(rest, face[0], face[1], face[2]) / 6.0
            opposite = _cross_size(rest, x, y, z)
            px, py, pz = rest[y, 0] - rest[x, 0], rest[y, 1] - rest[x, 1], rest[y, 2] - rest[x, 2]
            qx, qy, qz = rest[z, 0] - rest[x, 0], rest[z, 1] - rest[x, 1], rest[z, 2] - rest[x, 2]
            rx, ry, rz = rest[i, 0] - rest[x, 0], rest[i, 1] - rest[x, 1], rest[i, 2] - rest[x, 2]
            volume = abs(
                rx * (py * qz - pz * qy) + ry * (pz * qx - px * qz) + rz * (px * qy - py * qx)
            ) / 6.0  # fmt: skip
            # |grad N| is the area of the opposite face over three volumes.
            gradient = opposite / (6.0 * volume)
            stiffness[k] += volume * gradient * gradient
