"""The wall of triangles that is shown between the two sheets where they were cut.

The edges that come apart form lines on the surface. A line that ends within the tissue is joined to
the one that ends across the tissue from it; then all of them are closed, and what lies inside an
odd number of them, seen along the normal of the cut, is cut tissue. It is filled with triangles
whose corners are nodes of the lips, once for each side, so that the wall follows the tissue. They
carry nothing. A line that has no opposite, as that of a scratch, gets no wall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cut_service.ear_clipping import fill_polygon, inside_polygon, signed_area

Reals = NDArray[np.float64]
Rows = NDArray[np.int32]


@dataclass(frozen=True)
class Lips:
    """The edges that come apart.

    Attributes:
        edges: Nodes before the cut, as one of the two triangles has them in turn, shape (n, 2).
        sides: The nodes that the two sides of the edge have afterwards, in the same order, the
            side of that triangle first, shape (n, 2, 2).
        above: Whether that triangle is above the sweep, shape (n,).
    """

    edges: Rows
    sides: Rows
    above: NDArray[np.bool_]


@dataclass(frozen=True)
class Walls:
    """Triangles to show.

    Attributes:
        triangles: Nodes after the cut, shape (w, 3).
        open_lines: Lines of the cut that have no wall.
    """

    triangles: Rows
    open_lines: int


def build_walls(lips: Lips, places: Reals, across: dict[int, set[int]], parts: Rows) -> Walls:
    """Fill what lies between the lips of a cut through a wall.

    Args:
        lips: The edges that come apart.
        places: Positions of the nodes before the cut, snapped [m], shape (node_rows, 3).
        across: For each end of a line the nodes across the tissue from it.
        parts: The part of the tissue that each node is in before the cut: a wall joins no two,
            such as an organ and a patch that lies in it, shape (node_rows,).
    """
    part_of = parts[lips.edges[:, 0]]
    built = [
        _walls_of(_those(lips, part_of == part), places, across) for part in np.unique(part_of)
    ]
    triangles = [walls.triangles for walls in built]
    return Walls(
        np.concatenate([np.empty((0, 3), dtype=np.int32), *triangles]),
        sum(walls.open_lines for walls in built),
    )


def _those(lips: Lips, chosen: NDArray[np.bool_]) -> Lips:
    return Lips(lips.edges[chosen], lips.sides[chosen], lips.above[chosen])


def _walls_of(lips: Lips, places: Reals, across: dict[int, set[int]]) -> Walls:
    """The walls of one part of the tissue."""
    lines = chains(lips.edges)
    loops, left = close(lines, places, across)
    none = np.empty((0, 3), dtype=np.int32)
    if not loops:
        return Walls(none, left)
    nodes = np.unique(np.concatenate(loops))
    flat = _flattened(places[nodes])
    rings = [np.searchsorted(nodes, loop) for loop in loops]
    filled: list[NDArray[np.int64]] = []
    for outer, holes in nested(flat, rings):
        triangles = fill_polygon(flat, outer, holes)
        if triangles is None:
            left += 1
        else:
            filled.append(nodes[triangles])
    if not filled:
        return Walls(none, left)
    return Walls(_on_both_sides(lips, np.concatenate(filled)), left)


def chains(edges: Rows) -> list[list[int]]:
    """Lines of nodes along edges; closed ones have the same node at both ends."""
    at: dict[int, list[int]] = {}
    for row, (a, b) in enumerate(edges.tolist()):
        at.setdefault(a, []).append(row)
        at.setdefault(b, []).append(row)
    free = set(range(len(edges)))
    found: list[list[int]] = []
    ends = [node for node, rows in sorted(at.items()) if len(rows) != 2]
    for start in [*ends, *sorted(at)]:
        while True:
            line = _walk(start, edges, at, free)
            if len(line) < 2:
                break
            found.append(line)
    return found


def _walk(start: int, edges: Rows, at: dict[int, list[int]], free: set[int]) -> list[int]:
    line = [start]
    while True:
        ways = [row for row in at[line[-1]] if row in free]
        # A node where lines meet ends them.
        if not ways or (len(line) > 1 and len(at[line[-1]]) != 2):
            return line
        free.discard(ways[0])
        a, b = (int(node) for node in edges[ways[0]])
        line.append(b if a == line[-1] else a)


def close(
    lines: list[list[int]], places: Reals, across: dict[int, set[int]]
) -> tuple[list[list[int]], int]:
    """Join lines at ends that lie across the tissue from each other.

    Returns:
        Closed loops, no node twice in succession; and how many lines could not be closed.
    """
    loops = [line[:-1] for line in lines if line[0] == line[-1]]
    open_lines = [line for line in lines if line[0] != line[-1]]
    ends = [(k, end) for k in range(len(open_lines)) for end in (0, -1)]
    pairs = []
    for i, (k, a) in enumerate(ends):
        for j in range(i + 1, len(ends)):
            m, b = ends[j]
            p, q = open_lines[k][a], open_lines[m][b]
            if q in across.get(p, ()) or p in across.get(q, ()):
                pairs.append((float(np.linalg.norm(places[p] - places[q])), i, j))
    partner: dict[int, int] = {}
    for _, i, j in sorted(pairs):
        if i not in partner and j not in partner:
            partner[i], partner[j] = j, i
    used: set[int] = set()
    left = 0
    for k in range(len(open_lines)):
        if k in used:
            continue
        loop, at, closed = [], 2 * k, False
        while True:
            line = ends[at][0]
            if line in used:
                closed = at == 2 * k
                break
            used.add(line)
            loop += open_lines[line] if at % 2 == 0 else open_lines[line][::-1]
            other = at ^ 1
            if other not in partner:
                break
            at = partner[other]
        if closed and len(loop) > 2:
            loops.append(loop)
        else:
            left += 1
    return loops, left


def _flattened(points: Reals) -> Reals:
    """Points in the plane that fits them best, shape (n, 2)."""
    middle = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(middle, full_matrices=False)
    return np.asarray(middle @ axes[:2].T)


def nested(
    flat: Reals, rings: list[NDArray[np.int64]]
) -> list[tuple[NDArray[np.int64], list[NDArray[np.int64]]]]:
    """Outlines and the holes in each: a ring inside an odd number of others is a hole."""
    areas = [abs(signed_area(flat[ring])) for ring in rings]
    order = sorted(range(len(rings)), key=lambda k: -areas[k])
    around: dict[int, list[int]] = {}
    for k in order:
        probe = flat[rings[k]]
        around[k] = [
            m for m in order
            if areas[m] > areas[k] and inside_polygon(probe, flat[rings[m]]).mean() > 0.5
        ]  # fmt: skip
    outer = {k: [] for k in order if len(around[k]) % 2 == 0}  # type: dict[int, list[int]]
    for k in order:
        if len(around[k]) % 2:
            owner = min((m for m in around[k] if m in outer), key=lambda m: areas[m])
            outer[owner].append(k)
    return [(rings[k], [rings[m] for m in holes]) for k, holes in outer.items()]


def _on_both_sides(lips: Lips, triangles: NDArray[np.int64]) -> Rows:
    """The same triangles with the nodes of each side, normals out of the tissue of that side."""
    versions: tuple[dict[int, int], dict[int, int]] = ({}, {})
    directed: set[tuple[int, int]] = set()
    for edge, sides, above in zip(
        lips.edges.tolist(), lips.sides.tolist(), lips.above.tolist(), strict=True
    ):
        for which, pair in enumerate(sides):
            side = which ^ (not above)
            for old, new in zip(edge, pair, strict=True):
                if new != old or old not in versions[side]:
                    versions[side][old] = new
        directed.add((edge[0], edge[1]) if above else (edge[1], edge[0]))
    # A wall runs along a lip against the triangle that it meets there.
    votes = 0
    for a, b, c in triangles.tolist():
        for pair in ((a, b), (b, c), (c, a)):
            votes += (pair[::-1] in directed) - (pair in directed)
    upper = triangles if votes >= 0 else triangles[:, ::-1]
    walls = [
        [versions[side].get(node, node) for node in corners]
        for side, some in ((0, upper), (1, upper[:, ::-1]))
        for corners in some.tolist()
    ]
    return np.array(walls, dtype=np.int32).reshape(-1, 3)
