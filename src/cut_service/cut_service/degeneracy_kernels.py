"""Loops over the elements around a cut that move nodes out of degeneracies; see `degeneracy`.

No fastmath: comparisons with what was before must come out the same bit for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.neighbours import NOBODY, Links, across
from cut_service.quality import radius_ratio, six_volumes
from cut_service.sweep_kernels import closest_on_triangle

Reals = NDArray[np.float64]
Rows = NDArray[np.int32]

STUCK, FREE, ON_CUT, BACK_ONLY = 0, 1, 2, 3
"""How a node may move: not, in any direction, along the sweep, only back to where it came from."""

SHIFTS = 2
"""Passes over the degenerate elements."""
STEPS = (0.3, 0.15, 0.07)
"""Lengths of the moves tried, as shares of the element's longest edge."""
BACKS = 3
"""Passes that step back."""
LADDER = 8
"""Places tried on the way back."""
WORTH = 1e-3
"""A smaller gain is not worth a move."""
REACHED = 1e-3
"""A node this close to the sweep, as a share of the element's longest edge, is on it."""


class Stage(NamedTuple):
    """What nodes are moved in. Only `rest`, `shape`, `anchors` and `weights` change.

    Attributes:
        links: The elements that are judged.
        old: The mesh before the cut, whose elements places are given in; its rows come first in
            `links`.
        rest_old, shape_old: Node positions before anything moved [m], of the nodes of `old`.
        rest, shape: Where nodes are now [m].
        homes: Two nodes of `old` at whose elements each node's places are looked for; its own row,
            twice, for an old one, shape (node_rows, 2).
        anchors: Row in `old` of the element that each node's place is given in; `NOBODY` for one
            that has not moved, shape (node_rows,).
        weights: Weights of that element's nodes, shape (node_rows, 4).
        kinds: How each node may move, shape (node_rows,).
        corners: Triangles of the sweep [m], shape (n, 3, 3).
        allowed: Figures below which elements lack something, at rest and deformed, shape (2, m).
        least: Radius ratios below which no move takes an element, shape (2, m).
        goals: Radius ratio and length wanted.
    """

    links: Links
    old: Links
    rest_old: Reals
    shape_old: Reals
    rest: Reals
    shape: Reals
    homes: Rows
    anchors: Rows
    weights: Reals
    kinds: NDArray[np.uint8]
    corners: Reals
    allowed: Reals
    least: Reals
    goals: Reals


@njit(cache=True, nogil=True, error_model="numpy")
def _inverse_square(points: Reals, a: int, b: int) -> float:
    x, y, z = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
    return 1.0 / (x * x + y * y + z * z)


@njit(cache=True, nogil=True, error_model="numpy")
def element_length(points: Reals, nodes: Rows) -> float:
    """sqrt(3 / sum of 1 / l^2) at the corner of an element where that is least [m]."""
    ab, ac, ad = (
        _inverse_square(points, nodes[0], nodes[1]), _inverse_square(points, nodes[0], nodes[2]),
        _inverse_square(points, nodes[0], nodes[3]),
    )  # fmt: skip
    bc, bd, cd = (
        _inverse_square(points, nodes[1], nodes[2]), _inverse_square(points, nodes[1], nodes[3]),
        _inverse_square(points, nodes[2], nodes[3]),
    )  # fmt: skip
    most = max(max(ab + ac + ad, ab + bc + bd), max(ac + bc + cd, ad + bd + cd))
    return np.sqrt(3.0 / most)


@njit(cache=True, nogil=True, error_model="numpy")
def _ratio(points: Reals, nodes: Rows) -> float:
    return radius_ratio(points[nodes[0]], points[nodes[1]], points[nodes[2]], points[nodes[3]])


@njit(cache=True, nogil=True, error_model="numpy")
def _figures(rest: Reals, shape: Reals, nodes: Rows, goals: Reals) -> tuple[float, float]:
    """Figures of an element at rest and deformed; lengths count at rest."""
    at_rest = min(_ratio(rest, nodes) / goals[0], element_length(rest, nodes) / goals[1])
    return at_rest, _ratio(shape, nodes) / goals[0]


@njit(cache=True, nogil=True, error_model="numpy")
def _margin(stage: Stage, element: int) -> float:
    """How far an element is above what it is allowed; minus its lack."""
    at_rest, deformed = _figures(stage.rest, stage.shape, stage.links.tets[element], stage.goals)
    return min(at_rest - stage.allowed[0, element], deformed - stage.allowed[1, element])


@njit(cache=True, nogil=True, error_model="numpy")
def _worst_around(stage: Stage, node: int, least: float) -> float:
    """The smallest margin of the elements at a node; `least` if it is not more than that."""
    links, worst = stage.links, np.inf
    for k in range(links.start[node], links.start[node] + links.length[node]):
        element = links.data[k]
        nodes = links.tets[element]
        ratio = _ratio(stage.rest, nodes)
        if ratio < stage.least[0, element]:
            return least
        margin = ratio / stage.goals[0] - stage.allowed[0, element]
        length = element_length(stage.rest, nodes) / stage.goals[1]
        margin = min(margin, length - stage.allowed[0, element])
        ratio = _ratio(stage.shape, nodes)
        if ratio < stage.least[1, element]:
            return least
        margin = min(margin, ratio / stage.goals[0] - stage.allowed[1, element])
        if margin <= least:
            return least
        worst = min(worst, margin)
    return worst


@njit(cache=True, nogil=True, error_model="numpy")
def _locate(stage: Stage, node: int, place: Reals, weights: Reals) -> int:
    """The element of the old mesh at a node's homes that contains a place; `NOBODY`: none does."""
    x = stage.shape_old
    best, chosen = -1e-9, NOBODY
    trial = np.empty(4)
    for end in range(2):
        home = stage.homes[node, end]
        if end == 1 and home == stage.homes[node, 0]:
            break
        for k in range(stage.old.start[home], stage.old.start[home] + stage.old.length[home]):
            element = stage.old.data[k]
            nodes = stage.old.tets[element]
            p, q, r, s = x[nodes[0]], x[nodes[1]], x[nodes[2]], x[nodes[3]]
            whole = six_volumes(p, q, r, s)
            if not whole > 0.0:
                continue
            trial[0] = six_volumes(place, q, r, s) / whole
            trial[1] = six_volumes(p, place, r, s) / whole
            trial[2] = six_volumes(p, q, place, s) / whole
            trial[3] = 1.0 - trial[0] - trial[1] - trial[2]
            lowest = min(min(trial[0], trial[1]), min(trial[2], trial[3]))
            if lowest > best:
                best, chosen = lowest, element
                for corner in range(4):
                    weights[corner] = trial[corner]
    if chosen != NOBODY:
        total = 0.0
        for corner in range(4):
            weights[corner] = max(0.0, weights[corner])
            total += weights[corner]
        for corner in range(4):
            weights[corner] /= total
    return chosen


@njit(cache=True, nogil=True, error_model="numpy")
def _put(stage: Stage, node: int, element: int, weights: Reals) -> None:
    """Put a node where the weights in an element of the old mesh say."""
    nodes = stage.old.tets[element]
    for axis in range(3):
        rest, shape = 0.0, 0.0
        for corner in range(4):
            rest += weights[corner] * stage.rest_old[nodes[corner], axis]
            shape += weights[corner] * stage.shape_old[nodes[corner], axis]
        stage.rest[node, axis], stage.shape[node, axis] = rest, shape


@njit(cache=True, nogil=True, error_model="numpy")
def _away(place: Reals, corners: Reals, out: Reals) -> float:
    """Distance from the sweep, and the closest point of it."""
    best = np.inf
    point = np.empty(3)
    for t in range(corners.shape[0]):
        closest_on_triangle(place, corners[t, 0], corners[t, 1], corners[t, 2], point)
        square = 0.0
        for axis in range(3):
            square += (place[axis] - point[axis]) ** 2
        if square < best:
            best = square
            for axis in range(3):
                out[axis] = point[axis]
    return np.sqrt(best)


@njit(cache=True, nogil=True, error_model="numpy")
def _make_units(vectors: Reals) -> None:
    """The third is the sum of the first two."""
    for k in (0, 1, 3, 2):
        if k == 2:
            for axis in range(3):
                vectors[2, axis] = vectors[0, axis] + vectors[1, axis]
        size = np.sqrt(vectors[k, 0] ** 2 + vectors[k, 1] ** 2 + vectors[k, 2] ** 2)
        if size > 0.0:
            for axis in range(3):
                vectors[k, axis] /= size


@njit(cache=True, nogil=True, error_model="numpy")
def _square_between(x: Reals, a: int, b: int) -> float:
    square = 0.0
    for axis in range(3):
        square += (x[a, axis] - x[b, axis]) ** 2
    return square


@njit(cache=True, nogil=True, error_model="numpy")
def _directions(stage: Stage, element: int, corner: int, out: Reals) -> float:
    """Unit vectors in which moving a corner may help its element; the element's longest edge [m].

    Away from the opposite face, away from the closest corner, both, and to the middle of the
    nodes around.
    """
    links, x, nodes = stage.links, stage.shape, stage.links.tets[element]
    node = nodes[corner]
    a, b, c = nodes[(corner + 1) % 4], nodes[(corner + 2) % 4], nodes[(corner + 3) % 4]
    height, closest, longest, nearest = 0.0, np.inf, 0.0, a
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        out[0, axis] = (x[b, i] - x[a, i]) * (x[c, j] - x[a, j])
        out[0, axis] -= (x[b, j] - x[a, j]) * (x[c, i] - x[a, i])
        height += out[0, axis] * (x[node, axis] - x[a, axis])
    upright = six_volumes(x[nodes[0]], x[nodes[1]], x[nodes[2]], x[nodes[3]]) >= 0.0
    turn = 1.0 if (height >= 0.0) == upright else -1.0
    for k in range(4):
        for m in range(k):
            longest = max(longest, _square_between(x, nodes[k], nodes[m]))
        if k != corner and _square_between(x, node, nodes[k]) < closest:
            closest, nearest = _square_between(x, node, nodes[k]), nodes[k]
    number = 4 * links.length[node]
    for axis in range(3):
        out[0, axis] *= turn
        out[1, axis] = x[node, axis] - x[nearest, axis]
        middle = 0.0
        for k in range(links.start[node], links.start[node] + links.length[node]):
            for m in range(4):
                middle += x[links.tets[links.data[k], m], axis]
        # The node itself is a quarter of all.
        out[3, axis] = middle / number - x[node, axis]
    _make_units(out)
    return np.sqrt(longest)


@njit(cache=True, nogil=True, error_model="numpy")
def _try(
    stage: Stage,
    node: int,
    element: int,
    way: Reals,
    length: float,
    distance: float,
    near: float,
    best: float,
    weights: Reals,
) -> tuple[int, float]:
    """Put a node a length along a way from where it is, and on the sweep if it is to stay there.

    The element of the old mesh that contains its new place, and the worst of the elements around
    it there; `NOBODY` and `best` if that is not better.
    """
    target, on = np.empty(3), np.empty(3)
    for axis in range(3):
        target[axis] = stage.shape[node, axis] + length * way[axis]
    if stage.kinds[node] == ON_CUT:
        away = _away(target, stage.corners, on)
        if distance <= near:
            for axis in range(3):
                target[axis] = on[axis]
        elif away > distance:
            return NOBODY, best
    found = _locate(stage, node, target, weights)
    if found == NOBODY:
        return NOBODY, best
    x, y, z = stage.rest[node, 0], stage.rest[node, 1], stage.rest[node, 2]
    u, v, w = stage.shape[node, 0], stage.shape[node, 1], stage.shape[node, 2]
    _put(stage, node, found, weights)
    # The element itself first: most places do not help it.
    worst = best
    if _margin(stage, element) > best:
        worst = _worst_around(stage, node, best)
    stage.rest[node, 0], stage.rest[node, 1], stage.rest[node, 2] = x, y, z
    stage.shape[node, 0], stage.shape[node, 1], stage.shape[node, 2] = u, v, w
    if worst > best:
        return found, worst
    return NOBODY, best


@njit(cache=True, nogil=True, error_model="numpy")
def _shift(stage: Stage, element: int, corner: int) -> bool:
    """Move a corner of an element to the best of the places tried. Whether it has moved."""
    # Of one type everywhere: every function is then compiled once.
    node = np.int64(stage.links.tets[element, corner])
    ways, weights = np.empty((4, 3)), np.empty(4)
    longest = _directions(stage, element, corner, ways)
    distance = 0.0
    if stage.kinds[node] == ON_CUT:
        distance = _away(stage.shape[node], stage.corners, weights[:3])
    best = _worst_around(stage, node, -np.inf) + WORTH
    chosen, place = NOBODY, np.empty(4)
    for way in range(4):
        for step in STEPS:
            found, worst = _try(
                stage, node, element, ways[way], step * longest, distance, REACHED * longest, best,
                weights,
            )  # fmt: skip
            if found != NOBODY:
                best, chosen = worst, found
                for corner in range(4):
                    place[corner] = weights[corner]
    if chosen == NOBODY:
        return False
    _put(stage, node, chosen, place)
    stage.anchors[node] = chosen
    for corner in range(4):
        stage.weights[node, corner] = place[corner]
    return True


@njit(cache=True, nogil=True)
def shift_all(stage: Stage, elements: Rows) -> None:
    """Shift the nodes of degenerate elements, until none of them moves any more."""
    for _ in range(SHIFTS):
        moved = False
        for element in elements:
            for corner in range(4):
                if _margin(stage, element) >= 0.0:
                    break
                kind = stage.kinds[stage.links.tets[element, corner]]
                if kind in (FREE, ON_CUT):
                    moved = _shift(stage, element, corner) or moved
        if not moved:
            return


@njit(cache=True, nogil=True, error_model="numpy")
def _own_corner(stage: Stage, node: int) -> int:
    """Corner that a node is of the element its place is given in; `NOBODY`: it cannot go back."""
    if node >= stage.rest_old.shape[0] or stage.anchors[node] == NOBODY:
        return NOBODY
    for corner in range(4):
        if stage.old.tets[stage.anchors[node], corner] == node:
            return corner
    return NOBODY


@njit(cache=True, nogil=True, error_model="numpy")
def _volume_around(stage: Stage, node: int) -> float:
    links, volume, x = stage.links, 0.0, stage.rest
    for k in range(links.start[node], links.start[node] + links.length[node]):
        nodes = links.tets[links.data[k]]
        volume += six_volumes(x[nodes[0]], x[nodes[1]], x[nodes[2]], x[nodes[3]])
    return volume / 6.0


@njit(cache=True, nogil=True, error_model="numpy")
def _back(stage: Stage, node: int, own: int, share: float) -> None:
    """Put a node at a share of the way from where it came from to its place."""
    weights = np.empty(4)
    for corner in range(4):
        weights[corner] = share * stage.weights[node, corner]
    weights[own] += 1.0 - share
    _put(stage, node, np.int64(stage.anchors[node]), weights)


@njit(cache=True, nogil=True, error_model="numpy")
def _least_back(
    stage: Stage, node: int, own: int, used: float, budget: float
) -> tuple[float, float, float]:
    """The largest share of its way at which a node leaves no lack around it, or the least.

    Also the smallest margin around it there and the change of volume.
    """
    volume = _volume_around(stage, node)
    best, chosen, change = _worst_around(stage, node, -np.inf) + WORTH, 1.0, 0.0
    for rung in range(1, LADDER + 1):
        share = 1.0 - rung / LADDER
        _back(stage, node, own, share)
        worst = _worst_around(stage, node, best)
        grown = _volume_around(stage, node) - volume
        if worst > best and abs(used + grown) <= max(budget, abs(used)):
            best, chosen, change = worst, share, grown
            if worst >= 0.0:
                break
    _back(stage, node, own, 1.0)
    return chosen, best, change


@njit(cache=True, nogil=True, error_model="numpy")
def step_back(stage: Stage, elements: Rows, used: float, budget: float) -> tuple[float, bool]:
    """Take moves back where elements lack something.

    Returns the change of volume in all [m^3], and whether any node has moved.
    """
    any_moved = False
    for _ in range(BACKS):
        moved = False
        for element in elements:
            if _margin(stage, element) >= 0.0:
                continue
            node, at, change, enough, gain, cost = (
                np.int64(NOBODY),
                1.0,
                0.0,
                False,
                -np.inf,
                np.inf,
            )
            for corner in range(4):
                candidate = np.int64(stage.links.tets[element, corner])
                own = _own_corner(stage, candidate)
                if own == NOBODY:
                    continue
                share, worst, grown = _least_back(stage, candidate, own, used, budget)
                if share == 1.0:
                    continue
                way = 0.0
                for axis in range(3):
                    way += (stage.shape[candidate, axis] - stage.shape_old[candidate, axis]) ** 2
                lost = (1.0 - share) * np.sqrt(way)
                better = lost < cost if worst >= 0.0 and enough else worst >= 0.0
                if better or (not enough and worst > gain):
                    node, at, change, gain, cost = candidate, share, grown, worst, lost
                    enough = worst >= 0.0
            if node == NOBODY:
                continue
            own = _own_corner(stage, node)
            _back(stage, node, own, at)
            for corner in range(4):
                stage.weights[node, corner] *= at
            stage.weights[node, own] += 1.0 - at
            used += change
            moved = any_moved = True
        if not moved:
            break
    return used, any_moved


@njit(cache=True, nogil=True)
def find_kinds(
    links: Links, nodes: Rows, on_cut: NDArray[np.bool_], still: NDArray[np.bool_],
    kinds: NDArray[np.uint8],
) -> None:  # fmt: skip
    """How each of the nodes may move."""
    for node in nodes:
        if still[node]:
            continue
        bare = False
        for k in range(links.start[node], links.start[node] + links.length[node]):
            element = links.data[k]
            for corner in range(4):
                if links.tets[element, corner] != node and across(links, element, corner) == NOBODY:
                    bare = True
        if bare:
            kinds[node] = BACK_ONLY
        else:
            kinds[node] = ON_CUT if on_cut[node] else FREE


@njit(cache=True, nogil=True, error_model="numpy")
def set_limits(stage: Stage, elements: Rows, floor: float) -> None:
    """What elements are allowed, and the radius ratios that moves leave them."""
    for element in elements:
        nodes = stage.links.tets[element]
        first, second = 1.0, 1.0
        if element < stage.old.tets.shape[0]:
            first, second = _figures(
                stage.rest_old, stage.shape_old, stage.old.tets[element], stage.goals
            )
        stage.allowed[0, element] = min(1.0, first)
        stage.allowed[1, element] = min(1.0, second)
        stage.least[0, element] = min(floor, _ratio(stage.rest, nodes))
        stage.least[1, element] = min(floor, _ratio(stage.shape, nodes))


@njit(cache=True, nogil=True)
def find_lacking(stage: Stage, elements: Rows, out: Rows) -> int:
    """Degenerate elements, into `out`; their number."""
    found = 0
    for element in elements:
        if _margin(stage, element) < 0.0:
            out[found] = element
            found += 1
    return found
