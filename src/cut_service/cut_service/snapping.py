"""Moving the nodes of a cut surface onto the sweep, so that the cut is smooth.

Nodes move where the person sees them, in the deformed configuration. A node's new place lies in one
of its own elements, and its rest position is the place of the same material point: both are the
same weights of that element's nodes. Along the way from the old place to the new one all of this is
linear in one number t from 0 to 1, and a node goes as far as it can: t is the largest found at
which no incident element is worse than the quality floor, in either configuration. One that already
was worse may not get worse still.

Surface nodes slide within a triangle of the surface, nodes on a crease along the crease, corners
stay: the organ keeps its shape. What sliding on a curved surface still changes in rest volume is
    counted and stops at a budget.

Limitations: a node moves at most across one of its own elements, so a cut through elements much
larger than the distance between two bends of the sweep stays faceted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.neighbours import NOBODY, Links, across, has_node
from cut_service.quality import radius_ratio, six_volumes
from cut_service.sweep import Sweep
from cut_service.sweep_kernels import closest_on_triangle
from tissue_sim.geometry.faces import LOCAL_FACES

Reals = NDArray[np.float64]

PASSES = 3
HALVINGS = 5
OWN_WEIGHT = 0.05
"""A node keeps at least this weight on its own old place.

It never reaches the far side of its element.
"""
SMALLEST_STEP = 1e-3
"""Shorter moves, as a share of the way to the sweep, are not worth an edit."""
ON_SWEEP = 1e-4
"""A node this close to its place on the sweep, as a share of an edge, is there already."""
BENT = -0.75
"""Cosine between a crease's two edges at a node above which the node counts as a corner."""


@dataclass(frozen=True)
class Snapping:
    """Nodes that move.

    Attributes:
        nodes: Node rows, shape (n,).
        rest: New rest positions [m], shape (n, 3).
        anchors: Node rows of the element that contains the new place, shape (n, 4).
        weights: Barycentric weights of the new place in it, before anything moved, shape (n, 4).
        elements: Row of that element, shape (n,).
    """

    nodes: NDArray[np.int32]
    rest: Reals
    anchors: NDArray[np.int32]
    weights: Reals
    elements: NDArray[np.int32]


class _Bodies(NamedTuple):
    """The two configurations before (`*_old`) and while nodes move."""

    rest_old: Reals
    rest: Reals
    shape_old: Reals
    shape: Reals


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(p: Reals, corners: Reals, out: Reals) -> int:
    best, which = np.inf, 0
    place = np.empty(3)
    for t in range(corners.shape[0]):
        closest_on_triangle(p, corners[t, 0], corners[t, 1], corners[t, 2], place)
        square = np.dot(p - place, p - place)
        if square < best:
            best, which = square, t
            out[:] = place
    return which


@njit(cache=True, nogil=True)
def _cross(u: Reals, v: Reals) -> Reals:
    out = np.empty(3)
    out[0] = u[1] * v[2] - u[2] * v[1]
    out[1] = u[2] * v[0] - u[0] * v[2]
    out[2] = u[0] * v[1] - u[1] * v[0]
    return out


@njit(cache=True, nogil=True)
def _unit(v: Reals) -> Reals:
    length = np.sqrt(np.dot(v, v))
    return v / length if length > 0.0 else v


@njit(cache=True, nogil=True)
def _surface_at(links: Links, node: int, triangles: NDArray[np.int32]) -> int:
    """Boundary triangles at a node, rows (element, a, b).

    Node, a, b turn left seen from outside.
    """
    found = 0
    for k in range(links.start[node], links.start[node] + links.length[node]):
        element = links.data[k]
        for corner in range(4):
            if links.tets[element, corner] == node or across(links, element, corner) != NOBODY:
                continue
            for i in range(3):
                if links.tets[element, LOCAL_FACES[corner, i]] == node:
                    triangles[found, 0] = element
                    triangles[found, 1] = links.tets[element, LOCAL_FACES[corner, (i + 1) % 3]]
                    triangles[found, 2] = links.tets[element, LOCAL_FACES[corner, (i + 2) % 3]]
                    found += 1
    return found


@njit(cache=True, nogil=True)
def _creases(
    rest: Reals, node: int, triangles: NDArray[np.int32], crease: float, ends: NDArray[np.int32]
) -> int:
    """Far ends of the sharp edges at a node, into `ends`; their number."""
    count = triangles.shape[0]
    normals = np.empty((count, 3))
    for k in range(count):
        u = rest[triangles[k, 1]] - rest[node]
        v = rest[triangles[k, 2]] - rest[node]
        normals[k] = _unit(_cross(u, v))
    found = 0
    for k in range(count):
        for m in range(count):
            # The edge to b of one triangle is the edge to a of the next.
            if (
                triangles[k, 2] == triangles[m, 1]
                and np.dot(normals[k], normals[m]) < crease
                and found < ends.shape[0]
            ):
                ends[found] = triangles[k, 2]
                found += 1
    return found


@njit(cache=True, nogil=True)
def _way_in_triangle(
    f: float, fa: float, fb: float, to_a: Reals, to_b: Reals
) -> tuple[float, float]:
    """Weights of a and b at the point closest to the node where a linear function is zero.

    The function is f at the node, fa and fb at the triangle's other two nodes. Weights are -1 where
    the line misses the triangle.
    """
    ends = np.empty((3, 2))
    number = 0
    if f * fa <= 0.0 and f != fa:
        ends[number, 0], ends[number, 1] = f / (f - fa), 0.0
        number += 1
    if f * fb <= 0.0 and f != fb:
        ends[number, 0], ends[number, 1] = 0.0, f / (f - fb)
        number += 1
    if fa * fb <= 0.0 and fa != fb:
        share = fa / (fa - fb)
        ends[number, 0], ends[number, 1] = 1.0 - share, share
        number += 1
    if number < 2:
        return -1.0, -1.0
    first, second = ends[0], ends[1]
    p = first[0] * to_a + first[1] * to_b
    q = second[0] * to_a + second[1] * to_b
    square = np.dot(q - p, q - p)
    share = 0.0 if square == 0.0 else min(1.0, max(0.0, -np.dot(p, q - p) / square))
    way = first + share * (second - first)
    return way[0], way[1]


@njit(cache=True, nogil=True)
def _put_weight(links: Links, element: int, node: int, weight: float, weights: Reals) -> None:
    for corner in range(4):
        if links.tets[element, corner] == node:
            weights[corner] = weight


@njit(cache=True, nogil=True)
def _slide(
    links: Links,
    bodies: _Bodies,
    node: int,
    triangles: NDArray[np.int32],
    corners: Reals,
    crease: float,
    weights: Reals,
) -> int:
    """Where a surface node should slide.

    An element and the weights there of its other nodes; `NOBODY`: it stays.
    """
    x = bodies.shape_old
    place = np.empty(3)
    which = _nearest(x[node], corners, place)
    origin = corners[which, 0]
    normal = _unit(_cross(corners[which, 1] - origin, corners[which, 2] - origin))
    f = np.dot(normal, x[node] - origin)
    weights[:] = 0.0
    ends = np.empty(8, dtype=np.int32)
    sharp = _creases(bodies.rest_old, node, triangles, crease, ends)
    if sharp == 0:
        best, chosen, best_a, best_b = np.inf, NOBODY, 0.0, 0.0
        for k in range(triangles.shape[0]):
            a, b = triangles[k, 1], triangles[k, 2]
            fa, fb = np.dot(normal, x[a] - origin), np.dot(normal, x[b] - origin)
            to_a, to_b = x[a] - x[node], x[b] - x[node]
            wa, wb = _way_in_triangle(f, fa, fb, to_a, to_b)
            if wa < 0.0:
                continue
            way = wa * to_a + wb * to_b
            if np.dot(way, way) < best:
                best, chosen, best_a, best_b = np.dot(way, way), k, wa, wb
        if chosen == NOBODY:
            return NOBODY
        element = triangles[chosen, 0]
        _put_weight(links, element, triangles[chosen, 1], best_a, weights)
        _put_weight(links, element, triangles[chosen, 2], best_b, weights)
        return element
    if sharp != 2:
        return NOBODY
    first = _unit(bodies.rest_old[ends[0]] - bodies.rest_old[node])
    second = _unit(bodies.rest_old[ends[1]] - bodies.rest_old[node])
    if np.dot(first, second) > BENT:
        return NOBODY
    best, end = 2.0, NOBODY
    for k in range(2):
        fa = np.dot(normal, x[ends[k]] - origin)
        if f * fa < 0.0 and f / (f - fa) < best:
            best, end = f / (f - fa), ends[k]
    if end == NOBODY:
        return NOBODY
    for k in range(links.start[node], links.start[node] + links.length[node]):
        if has_node(links, links.data[k], end):
            _put_weight(links, links.data[k], end, best, weights)
            return links.data[k]
    return NOBODY


@njit(cache=True, nogil=True)
def _drop(links: Links, bodies: _Bodies, node: int, corners: Reals, weights: Reals) -> int:
    """The element of an inner node towards the sweep, and weights there of its other nodes."""
    x = bodies.shape_old
    place = np.empty(3)
    _nearest(x[node], corners, place)
    best, chosen = -1e-9, NOBODY
    trial = np.empty(4)
    for k in range(links.start[node], links.start[node] + links.length[node]):
        element = links.data[k]
        nodes = links.tets[element]
        whole = six_volumes(x[nodes[0]], x[nodes[1]], x[nodes[2]], x[nodes[3]])
        if not whole > 0.0:
            continue
        lowest = np.inf
        for corner in range(4):
            if nodes[corner] == node:
                trial[corner] = 0.0
                continue
            a = place if corner == 0 else x[nodes[0]]
            b = place if corner == 1 else x[nodes[1]]
            c = place if corner == 2 else x[nodes[2]]
            d = place if corner == 3 else x[nodes[3]]
            trial[corner] = six_volumes(a, b, c, d) / whole
            lowest = min(lowest, trial[corner])
        if lowest > best:
            best, chosen = lowest, element
            for corner in range(4):
                weights[corner] = max(0.0, trial[corner])
    return chosen


@njit(cache=True, nogil=True, error_model="numpy")
def _star_quality(links: Links, points: Reals, node: int, place: Reals, quality: Reals) -> float:
    """Quality of the elements at a node were it at `place`, into `quality`.

    Six times their volume.
    """
    keep = points[node].copy()
    points[node] = place
    volume = 0.0
    for k in range(links.length[node]):
        nodes = links.tets[links.data[links.start[node] + k]]
        a, b, c, d = points[nodes[0]], points[nodes[1]], points[nodes[2]], points[nodes[3]]
        quality[k] = radius_ratio(a, b, c, d)
        volume += six_volumes(a, b, c, d)
    points[node] = keep
    return volume


@njit(cache=True, nogil=True)
def _good_enough(before: Reals, after: Reals, count: int, floor: float) -> bool:
    worst = 0.0
    for k in range(count):
        worst = min(worst, after[k] - min(floor, before[k]))
    return worst >= 0.0


@njit(cache=True, nogil=True)
def _snap(
    links: Links,
    bodies: _Bodies,
    nodes: NDArray[np.int32],
    corners: Reals,
    floor: float,
    crease: float,
    budget: float,
    chosen: NDArray[np.int32],
    weights: Reals,
    reached: Reals,
) -> float:
    """Move the nodes; the element each moves in, weights of its other nodes at t = 1, t reached.

    Modifies `bodies.rest` and `bodies.shape` in place. Returns the change of rest volume [m^3].
    """
    most = 0
    for node in nodes:
        most = max(most, links.length[node])
    triangles = np.empty((3 * most, 3), dtype=np.int32)
    quality = np.empty((4, most))
    furthest = np.empty(nodes.shape[0])
    for i in range(nodes.shape[0]):
        number = _surface_at(links, nodes[i], triangles)
        if number:
            chosen[i] = _slide(
                links, bodies, nodes[i], triangles[:number], corners, crease, weights[i]
            )
        else:
            chosen[i] = _drop(links, bodies, nodes[i], corners, weights[i])
        others = np.sum(weights[i])
        if others < ON_SWEEP:
            chosen[i] = NOBODY
        furthest[i] = 1.0 if others <= 1.0 - OWN_WEIGHT else (1.0 - OWN_WEIGHT) / others
        reached[i] = 0.0
    used = 0.0
    for _ in range(PASSES):
        for i in range(nodes.shape[0]):
            if chosen[i] == NOBODY or reached[i] >= furthest[i]:
                continue
            node, count = nodes[i], links.length[nodes[i]]
            way_rest, way_shape = np.zeros(3), np.zeros(3)
            for corner in range(4):
                other = links.tets[chosen[i], corner]
                way_rest += weights[i, corner] * (bodies.rest_old[other] - bodies.rest_old[node])
                way_shape += weights[i, corner] * (bodies.shape_old[other] - bodies.shape_old[node])
            volume = _star_quality(links, bodies.rest, node, bodies.rest[node], quality[0])
            _star_quality(links, bodies.shape, node, bodies.shape[node], quality[1])
            low, high, t = reached[i], furthest[i], furthest[i]
            for _step in range(HALVINGS + 1):
                rest = bodies.rest_old[node] + t * way_rest
                shape = bodies.shape_old[node] + t * way_shape
                change = _star_quality(links, bodies.rest, node, rest, quality[2]) - volume
                _star_quality(links, bodies.shape, node, shape, quality[3])
                if (
                    abs(used + change / 6.0) <= budget
                    and _good_enough(quality[0], quality[2], count, floor)
                    and _good_enough(quality[1], quality[3], count, floor)
                ):
                    low = t
                    if t == furthest[i]:
                        break
                else:
                    high = t
                t = 0.5 * (low + high)
            if low > max(reached[i], SMALLEST_STEP):
                reached[i] = low
                rest = bodies.rest_old[node] + low * way_rest
                change = _star_quality(links, bodies.rest, node, rest, quality[2]) - volume
                used += change / 6.0
                bodies.rest[node] = rest
                bodies.shape[node] = bodies.shape_old[node] + low * way_shape
    return used


def snap(
    links: Links,
    rest: Reals,
    positions: Reals,
    nodes: NDArray[np.int32],
    sweep: Sweep,
    quality_floor: float,
    crease_cosine: float,
    volume_budget: float,
) -> tuple[Snapping, float]:
    """Move nodes of a cut surface towards the sweep.

    Args:
        links: The mesh before the cut.
        rest: Rest positions [m], shape (node_rows, 3).
        positions: Current positions [m], shape (node_rows, 3).
        nodes: Rows of the nodes that may move, shape (n,).
        sweep: What they move onto, in the current configuration.
        quality_floor: Smallest radius ratio a move may leave behind.
        crease_cosine: Two surface triangles whose normals' cosine is below this meet in a crease.
        volume_budget: Largest change of the organ's rest volume [m^3].

    Returns:
        The moves, and the change of rest volume [m^3].
    """
    bodies = _Bodies(rest, rest.copy(), positions, positions.copy())
    chosen = np.full(len(nodes), NOBODY, dtype=np.int32)
    weights, reached = np.zeros((len(nodes), 4)), np.zeros(len(nodes))
    change = _snap(
        links, bodies, nodes, sweep.measured, quality_floor, crease_cosine, volume_budget,
        chosen, weights, reached,
    )  # fmt: skip
    moved = reached > 0
    rows = nodes[moved]
    anchors = links.tets[chosen[moved]].copy()
    scaled = weights[moved] * reached[moved, None]
    own = anchors == rows[:, None]
    scaled[own] = 1.0 - scaled.sum(axis=1)
    return Snapping(rows, bodies.rest[rows], anchors, scaled, chosen[moved]), change
