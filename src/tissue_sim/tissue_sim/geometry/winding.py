"""Inside and outside of a triangle surface, however dirty: generalised winding numbers.

The winding number of a place is the solid angle of the surface seen from it over 4 pi: 1 inside a
closed surface, 0 outside, 2 where the surface overlaps itself, and something between near a hole.
So "above one half" is a good notion of inside even for surfaces that intersect themselves. Far
parts of the surface are seen as dipoles, which makes it fast.

Limitations: needs triangles that agree which side is out; the dipoles' errors (below 0.2) make no
difference except near large holes.

References:
    A. Jacobson, L. Kavan, O. Sorkine-Hornung, Robust inside-outside segmentation using generalized
    winding numbers, ACM Transactions on Graphics 32(4), 2013, doi 10.1145/2461912.2461916.
    G. Barill et al., Fast winding numbers for soups and clouds, ACM Transactions on Graphics 37(4),
    2018, doi 10.1145/3197517.3201337.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

_LEAF = 2
_FAR = 2.0
"""A part is far beyond this multiple of its radius."""

_DEPTH = 64
"""Places on the stack of a walk through the tree, more than any tree is deep."""


class SurfaceTree(NamedTuple):
    """A complete binary tree over triangles sorted along a space-filling curve.

    Node k has the children 2k and 2k + 1; the leaves are the second half. Node 0 is unused.

    Attributes:
        order: Row of each sorted triangle in the surface, shape (triangle_count,).
        corners: Corners of the sorted triangles [m], shape (triangle_count, 3, 3).
        begin: First triangle of each leaf, one more than there are leaves.
        low: Lower corners of the nodes' boxes [m], shape (node_count, 3).
        high: Upper corners [m], shape (node_count, 3).
        centre: Places of the dipoles [m], shape (node_count, 3).
        dipole: Sums of area vectors [m^2], shape (node_count, 3).
        radius: Distance from the centre to the farthest corner of a triangle [m],
            shape (node_count,).
    """

    order: NDArray[np.int64]
    corners: NDArray[np.float64]
    begin: NDArray[np.int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    centre: NDArray[np.float64]
    dipole: NDArray[np.float64]
    radius: NDArray[np.float64]


def surface_tree(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> SurfaceTree:
    """Build the tree of a surface.

    Args:
        points: Node positions [m], shape (node_count, 3).
        triangles: Node rows, shape (triangle_count, 3), at least one.
    """
    corners = points[triangles]
    order = np.argsort(_morton(corners.mean(axis=1)), kind="stable")
    corners = np.ascontiguousarray(corners[order])
    leaves = 1 << max(0, (len(corners) - 1) // _LEAF).bit_length()
    begin = np.arange(leaves + 1) * len(corners) // leaves
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    low, high = np.full((2 * leaves, 3), np.inf), np.full((2 * leaves, 3), -np.inf)
    dipole, weight = np.zeros((2 * leaves, 3)), np.zeros(2 * leaves)
    moment = np.zeros((2 * leaves, 3))
    leaf = leaves + np.repeat(np.arange(leaves), np.diff(begin))
    size = np.linalg.norm(areas, axis=1)
    np.minimum.at(low, leaf, corners.min(axis=1))
    np.maximum.at(high, leaf, corners.max(axis=1))
    np.add.at(dipole, leaf, areas)
    np.add.at(weight, leaf, size)
    np.add.at(moment, leaf, size[:, None] * corners.mean(axis=1))
    for node in range(leaves - 1, 0, -1):
        pair = slice(2 * node, 2 * node + 2)
        low[node], high[node] = low[pair].min(axis=0), high[pair].max(axis=0)
        dipole[node], moment[node] = dipole[pair].sum(axis=0), moment[pair].sum(axis=0)
        weight[node] = weight[pair].sum()
    known = weight > 0
    centre = np.where(known[:, None], moment / np.where(known, weight, 1.0)[:, None], 0.0)
    radius = np.zeros(2 * leaves)
    node_of = leaf
    while node_of[0] > 0:
        reach = np.linalg.norm(corners - centre[node_of][:, None], axis=2).max(axis=1)
        np.maximum.at(radius, node_of, reach)
        node_of = node_of // 2
    return SurfaceTree(order, corners, begin, low, high, centre, dipole, radius)


def _morton(points: NDArray[np.float64]) -> NDArray[np.uint64]:
    """Place of points along the Z-order curve, shape (n,)."""
    low = points.min(axis=0)
    extent = float(np.ptp(points, axis=0).max()) or 1.0
    cells = ((points - low) / extent * ((1 << 20) - 1)).astype(np.uint64)
    code = np.zeros(len(points), dtype=np.uint64)
    for bit in range(20):
        for axis in range(3):
            one = (cells[:, axis] >> np.uint64(bit)) & np.uint64(1)
            code |= one << np.uint64(3 * bit + axis)
    return code


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def _leaf_angle(
    corners: NDArray[np.float64], first: int, last: int, x: float, y: float, z: float
) -> float:
    """Solid angle of some triangles seen from a place (Van Oosterom and Strackee 1983).

    The tangent of half a triangle's angle is a quotient; multiplying the complex numbers that have
    these angles adds them, so that the costly arc tangent is taken only now and then: before the
    sum could pass half a turn.
    """
    angle = 0.0
    real, imaginary = 1.0, 0.0
    for t in range(first, last):
        ax, ay, az = corners[t, 0, 0] - x, corners[t, 0, 1] - y, corners[t, 0, 2] - z
        bx, by, bz = corners[t, 1, 0] - x, corners[t, 1, 1] - y, corners[t, 1, 2] - z
        cx, cy, cz = corners[t, 2, 0] - x, corners[t, 2, 1] - y, corners[t, 2, 2] - z
        a = np.sqrt(ax * ax + ay * ay + az * az)
        b = np.sqrt(bx * bx + by * by + bz * bz)
        c = np.sqrt(cx * cx + cy * cy + cz * cz)
        product = a * b * c
        if product == 0.0:
            continue
        scale = 1.0 / product
        above = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        below = (ax * bx + ay * by + az * bz) * c + (bx * cx + by * cy + bz * cz) * a
        below += (cx * ax + cy * ay + cz * az) * b
        sine, cosine = above * scale, 1.0 + below * scale
        if cosine <= 0.0:
            angle += np.arctan2(sine, cosine)
            continue
        real, imaginary = real * cosine - imaginary * sine, real * sine + imaginary * cosine
        if real < 0.0:
            angle += np.arctan2(imaginary, real)
            real, imaginary = 1.0, 0.0
    return 2.0 * (angle + np.arctan2(imaginary, real))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def _winding(tree: SurfaceTree, x: float, y: float, z: float, stack: NDArray[np.int64]) -> float:
    begin, corners, centre = tree.begin, tree.corners, tree.centre
    dipole, radius = tree.dipole, tree.radius
    leaves = len(begin) - 1
    angle = 0.0
    stack[0] = 1
    count = 1
    while count > 0:
        count -= 1
        node = stack[count]
        dx, dy, dz = centre[node, 0] - x, centre[node, 1] - y, centre[node, 2] - z
        square = dx * dx + dy * dy + dz * dz
        far = _FAR * radius[node]
        if square > far * far:
            flux = dipole[node, 0] * dx + dipole[node, 1] * dy + dipole[node, 2] * dz
            angle += flux / (square * np.sqrt(square))
        elif node >= leaves:
            angle += _leaf_angle(corners, begin[node - leaves], begin[node - leaves + 1], x, y, z)
        else:
            stack[count] = 2 * node
            stack[count + 1] = 2 * node + 1
            count += 2
    return angle / (4.0 * np.pi)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def _nearest_on(
    q: NDArray[np.float64], t: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Square of the distance to triangle t and weights of its second and third corner there.

    See Ericson, Real-Time Collision Detection, 5.1.5.
    """
    apx, apy, apz = x - q[t, 0, 0], y - q[t, 0, 1], z - q[t, 0, 2]
    abx, aby, abz = q[t, 1, 0] - q[t, 0, 0], q[t, 1, 1] - q[t, 0, 1], q[t, 1, 2] - q[t, 0, 2]
    acx, acy, acz = q[t, 2, 0] - q[t, 0, 0], q[t, 2, 1] - q[t, 0, 1], q[t, 2, 2] - q[t, 0, 2]
    bpx, bpy, bpz = apx - abx, apy - aby, apz - abz
    cpx, cpy, cpz = apx - acx, apy - acy, apz - acz
    d1, d2 = abx * apx + aby * apy + abz * apz, acx * apx + acy * apy + acz * apz
    d3, d4 = abx * bpx + aby * bpy + abz * bpz, acx * bpx + acy * bpy + acz * bpz
    d5, d6 = abx * cpx + aby * cpy + abz * cpz, acx * cpx + acy * cpy + acz * cpz
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v, w = 0.0, 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    elif va + vb + vc > 0.0:
        v = vb / (va + vb + vc)
        w = vc / (va + vb + vc)
    rx, ry, rz = apx - v * abx - w * acx, apy - v * aby - w * acy, apz - v * abz - w * acz
    return rx * rx + ry * ry + rz * rz, v, w


@njit(cache=True, nogil=True)
def _square_to_box(
    low: NDArray[np.float64], high: NDArray[np.float64], node: int, x: float, y: float, z: float
) -> float:
    dx = max(low[node, 0] - x, 0.0, x - high[node, 0])
    dy = max(low[node, 1] - y, 0.0, y - high[node, 1])
    dz = max(low[node, 2] - z, 0.0, z - high[node, 2])
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def _nearest(
    tree: SurfaceTree, x: float, y: float, z: float, reach: float, stack: NDArray[np.int64]
) -> tuple[float, int, float, float]:
    """Distance, nearest triangle (-1 beyond reach) and weights of its second and third corner."""
    begin, corners, low, high = tree.begin, tree.corners, tree.low, tree.high
    leaves = len(begin) - 1
    best, triangle, second, third = reach * reach, -1, 0.0, 0.0
    stack[0] = 1
    count = 1
    while count > 0:
        count -= 1
        node = stack[count]
        if _square_to_box(low, high, node, x, y, z) >= best:
            continue
        if node >= leaves:
            for t in range(begin[node - leaves], begin[node - leaves + 1]):
                square, v, w = _nearest_on(corners, t, x, y, z)
                if square < best:
                    best, triangle, second, third = square, t, v, w
        else:
            left = _square_to_box(low, high, 2 * node, x, y, z)
            right = _square_to_box(low, high, 2 * node + 1, x, y, z)
            nearer = 2 * node if left <= right else 2 * node + 1
            stack[count] = nearer ^ 1
            stack[count + 1] = nearer
            count += 2
    return np.sqrt(best), triangle, second, third


@njit(cache=True, nogil=True)
def _signed_distances(
    tree: SurfaceTree,
    places: NDArray[np.float64],
    reach: float,
    offsets: NDArray[np.float64],
    closed: bool,
    out: NDArray[np.float64],
) -> None:
    stack = np.empty(_DEPTH, dtype=np.int64)
    # Around the last place whose side was found lies a ball without surface, all on that side.
    px, py, pz, ball, inside = 0.0, 0.0, 0.0, -1.0, False
    for k in range(len(places)):
        x, y, z = places[k, 0], places[k, 1], places[k, 2]
        distance, triangle, v, w = _nearest(tree, x, y, z, reach, stack)
        offset = 0.0
        if triangle >= 0:
            offset = (1.0 - v - w) * offsets[triangle, 0]
            offset += v * offsets[triangle, 1] + w * offsets[triangle, 2]
        if distance < offset:
            # What lies within the offset is inside, whatever the side.
            out[k] = distance - offset
            continue
        away = (x - px) * (x - px) + (y - py) * (y - py) + (z - pz) * (z - pz)
        if not closed or away >= ball * ball:
            inside = _winding(tree, x, y, z, stack) > 0.5
        px, py, pz, ball = x, y, z, distance
        out[k] = (-distance if inside else distance) - offset


@njit(cache=True, nogil=True)
def _winding_numbers(
    tree: SurfaceTree, places: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    stack = np.empty(_DEPTH, dtype=np.int64)
    for k in range(len(places)):
        out[k] = _winding(tree, places[k, 0], places[k, 1], places[k, 2], stack)


def winding_numbers(tree: SurfaceTree, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Winding numbers of places [m], shape (n, 3) -> (n,)."""
    out = np.empty(len(places))
    _winding_numbers(tree, np.ascontiguousarray(places, dtype=np.float64), out)
    return out


def signed_distances(
    tree: SurfaceTree,
    places: NDArray[np.float64],
    reach: float = np.inf,
    offsets: NDArray[np.float64] | None = None,
    closed: bool = False,
) -> NDArray[np.float64]:
    """Distances to the surface [m], negative where the winding number exceeds one half.

    Args:
        tree: The surface.
        places: Places [m], shape (n, 3).
        reach: Distances beyond this are cut to it [m]; less is faster. Must exceed the offsets.
        offsets: How far the surface is moved outwards at the corners of the tree's triangles [m],
            shape (triangle_count, 3).
        closed: Whether the surface has no hole; then places in an order of neighbours are faster.

    Returns:
        Shape (n,).
    """
    if offsets is None:
        offsets = np.zeros((len(tree.corners), 3))
    out = np.empty(len(places))
    places = np.ascontiguousarray(places, dtype=np.float64)
    _signed_distances(tree, places, reach, offsets, closed, out)
    return out


def in_parallel(
    function: Callable[..., NDArray[np.float64]],
    tree: SurfaceTree,
    places: NDArray[np.float64],
    *arguments: Any,
) -> NDArray[np.float64]:
    """Evaluate one of the functions above with two threads: the kernels hold no lock."""
    blocks = np.array_split(places, 2)
    with ThreadPoolExecutor(2) as pool:
        parts = pool.map(lambda block: function(tree, block, *arguments), blocks)
        return np.concatenate(list(parts))
