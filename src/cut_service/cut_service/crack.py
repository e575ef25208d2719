"""Where a crack opens: fans of faces through nodes on the surface.

A face inside the tissue opens nothing by itself: all of its nodes still hold together around its
rim. The least that opens is a node on the surface, or on the front of a crack, which is surface
too. Seen from such a node, the elements that meet at it cover a disc (its link): their corners
beside the node are its vertices, the faces at the node its lines. A path of lines across the disc,
from rim to rim, parts the elements in two groups, and the node gets a copy: it has split, and the
faces of the path, a fan, are open.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.neighbours import NOBODY, Links, across
from cut_service.work import Work
from tissue_sim.elastic.stress import ElementMaterial, stresses_of

Rows = NDArray[np.int32]
Reals = NDArray[np.float64]
Line = tuple[int, int]
Face = tuple[int, int, int]

RESOLVED = 1e-9
"""Values of one kind closer to each other than this share of the largest count as equal."""

ASKEW = 0.02
"""What a face costs that is perpendicular to the pull, beside 1 for one along it, per area."""


@njit(cache=True, nogil=True)
def on_surface(links: Links, nodes: Rows, out: NDArray[np.bool_]) -> None:
    """Which nodes are on the surface, into `out`, shape (len(nodes),).

    The F elements at a node inside cover a sphere about it, which has 2 + F / 2 vertices (Euler);
    a disc has more.
    """
    seen = np.empty(1024, dtype=np.int32)
    for n in range(nodes.shape[0]):
        node = nodes[n]
        begin, count = links.start[node], links.length[node]
        vertices = 0
        for k in range(begin, begin + count):
            for corner in range(4):
                other = links.tets[links.data[k], corner]
                known = other == node
                for m in range(vertices):
                    known = known or seen[m] == other
                if not known and vertices < 1024:
                    seen[vertices] = other
                    vertices += 1
        out[n] = 2 * vertices != 4 + count


@njit(cache=True, nogil=True)
def inner_faces(links: Links, elements: Rows, out: NDArray[np.bool_]) -> None:
    """Which faces of elements have another element behind them, into `out`, shape (n, 4)."""
    for k in range(elements.shape[0]):
        for corner in range(4):
            out[k, corner] = across(links, elements[k], corner) != NOBODY


@dataclass
class Cut:
    """The faces chosen so far.

    Attributes:
        bits: Faces by element row, bit k for the one opposite corner k, shape (element_rows,).
        faces: Element row and opposite corner of each face, one of its two sides.
        keys: Their nodes, ascending.
    """

    bits: NDArray[np.uint8]
    faces: list[tuple[int, int]] = field(default_factory=list)
    keys: set[Face] = field(default_factory=set)

    @property
    def rows(self) -> Rows:
        """`faces` as an array, shape (n, 2)."""
        return np.array(self.faces, dtype=np.int32).reshape(-1, 2)


@dataclass(frozen=True)
class Fan:
    """A node that can split, and along which faces.

    Attributes:
        node: Row of the node.
        path: Vertices of the path across its link, in order.
        sides: Elements on either side of each face of the path, one less than vertices.
        pull: Mean normal traction on the faces [Pa]; positive pulls them apart.
    """

    node: int
    path: list[int]
    sides: list[tuple[int, int]]
    pull: float


def best_fan(
    work: Work, material: ElementMaterial, cut: Cut, face: Face, direction: Reals, nodes: list[int]
) -> Fan | None:
    """The fan through one of the nodes of a face that is pulled apart hardest.

    Args:
        work: The plan's.
        material: What elements are made of.
        cut: What is cut already.
        face: Nodes of the face, which the fan contains.
        direction: Unit vector that faces of the fan should be perpendicular to, shape (3,).
        nodes: Those of its nodes that may split.

    Returns:
        None if no node can split along the face.
    """
    fans = [_fan(work, material, cut, node, face, direction) for node in nodes]
    return max((fan for fan in fans if fan is not None), key=lambda fan: fan.pull, default=None)


def add(work: Work, cut: Cut, fan: Fan) -> None:
    """Cut the faces of a fan. Modifies `cut` in place."""
    for line, sides in zip(_lines(fan.path), fan.sides, strict=True):
        key = _key(fan.node, *line)
        cut.keys.add(key)
        for element in sides:
            corner = _corner_off(work, element, key)
            cut.bits[element] |= np.uint8(1 << corner)
        cut.faces.append((sides[0], _corner_off(work, sides[0], key)))


def taken_back(work: Work, cut: Cut, fan: Fan) -> None:
    """Take a fan out again that was added last. Modifies `cut` in place."""
    for line, sides in zip(_lines(fan.path), fan.sides, strict=True):
        key = _key(fan.node, *line)
        cut.keys.discard(key)
        for element in sides:
            cut.bits[element] &= np.uint8(255 ^ (1 << _corner_off(work, element, key)))
        cut.faces.pop()


def _fan(
    work: Work, material: ElementMaterial, cut: Cut, node: int, face: Face, direction: Reals
) -> Fan | None:
    elements = work.mesh.incident.of(node)
    lines: dict[Line, list[int]] = {}
    for element, corners in zip(elements.tolist(), work.links.tets[elements].tolist(), strict=True):
        a, b, c = sorted(corner for corner in corners if corner != node)
        for line in ((a, b), (a, c), (b, c)):
            lines.setdefault(line, []).append(element)
    inner = {
        line: sides for line, sides in lines.items()
        if len(sides) == 2 and _key(node, *line) not in cut.keys
    }  # fmt: skip
    rim = {vertex for line in lines if line not in inner for vertex in line}
    first, second = sorted(vertex for vertex in face if vertex != node)
    if (first, second) not in inner or not rim:
        return None
    cost = _costs(work, node, list(inner), direction)
    graph: dict[int, list[tuple[int, float]]] = {}
    for (a, b), price in zip(inner, cost, strict=True):
        graph.setdefault(a, []).append((b, price))
        graph.setdefault(b, []).append((a, price))
    head = _way_to(rim, graph, first, {second})
    if head is None:
        return None
    tail = _way_to(rim, graph, second, set(head))
    if tail is None:
        return None
    path = [*reversed(head), *tail]
    sides = [(inner[line][0], inner[line][1]) for line in _lines(path)]
    return Fan(node, path, sides, _pull(work, material, node, path, sides))


def _way_to(
    rim: set[int], graph: dict[int, list[tuple[int, float]]], start: int, banned: set[int]
) -> list[int] | None:
    """The cheapest path from a vertex to the rim, the vertex first; None if there is none."""
    before = {start: start}
    reached = {start: 0.0}
    ahead = [(0.0, start)]
    done: set[int] = set()
    while ahead:
        price, vertex = heapq.heappop(ahead)
        if vertex in done:
            continue
        done.add(vertex)
        if vertex in rim:
            path = [vertex]
            while path[-1] != start:
                path.append(before[path[-1]])
            return path[::-1]
        for other, more in graph.get(vertex, []):
            if other in banned or other in done:
                continue
            if price + more < reached.get(other, np.inf):
                reached[other], before[other] = price + more, vertex
                heapq.heappush(ahead, (price + more, other))
    return None


def _costs(work: Work, node: int, lines: list[Line], direction: Reals) -> list[float]:
    ends = work.positions[np.array(lines)] - work.positions[node]
    normals = np.cross(ends[:, 0], ends[:, 1])
    area = np.linalg.norm(normals, axis=1)
    along = np.divide(normals @ direction, area, out=np.zeros(len(area)), where=area > 0.0)
    costs: list[float] = settled(area * (1.0 + ASKEW - along**2)).tolist()
    return costs


def settled(values: Reals) -> Reals:
    """Values to compare: whole numbers of the smallest difference that counts.

    Uniformly pulled tissue has nothing but ties, and processors round differently: which of them
    comes first must not be left to the last digits.
    """
    scale = float(np.abs(values).max(initial=0.0)) * RESOLVED
    return np.round(values / scale) if scale > 0.0 else values


def _pull(
    work: Work, material: ElementMaterial, node: int, path: list[int], sides: list[tuple[int, int]]
) -> float:
    """Mean normal traction on the faces of a path, weighted by their area [Pa]."""
    ends = work.positions[np.array(_lines(path))] - work.positions[node]
    normals = np.cross(ends[:, 0], ends[:, 1])
    area = np.linalg.norm(normals, axis=1)
    if not area.sum() > 0.0:
        return 0.0
    unit = normals / np.maximum(area, 1e-300)[:, None]
    rows = np.array(sides, dtype=np.int32)
    stress = stresses_of(
        work.rest, work.positions, work.links.tets[rows.ravel()], material.of(rows.ravel())
    ).tensors.reshape(-1, 2, 3, 3)
    traction = np.einsum("ni,nij,nj->n", unit, stress.mean(axis=1), unit)
    return float(traction @ area / area.sum())


def _lines(path: list[int]) -> list[Line]:
    return [(min(a, b), max(a, b)) for a, b in pairwise(path)]


def _key(a: int, b: int, c: int) -> Face:
    low, middle, high = sorted((a, b, c))
    return low, middle, high


def _corner_off(work: Work, element: int, key: Face) -> int:
    """The corner of an element that is not on one of its faces."""
    corners: list[int] = work.links.tets[element].tolist()
    return next(k for k, node in enumerate(corners) if node not in key)
