"""The body-centred cubic lattice: nodes, neighbours and tetrahedra of isosurface stuffing.

Lattice nodes have integer coordinates that are all even or all odd; one cube ("cell") is two units
wide. Every node has six neighbours along the axes (long edges, one cell) and eight along the cube
diagonals (short edges, sqrt(3)/2 cells). Each lattice tetrahedron has one long edge between even
nodes, one between odd nodes, and four short edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

LONG_DIRECTIONS = 6

MOST_NODES = 50_000_000
"""Lattice nodes in a box, at most; a node takes some 150 bytes."""
_SHORT = ((1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1))


def _directions() -> NDArray[np.int64]:
    """List the 14 steps to a neighbour; direction `d ^ 1` is opposite to `d`."""
    steps: list[tuple[int, ...]] = []
    for axis in range(3):
        step = [0, 0, 0]
        step[axis] = 2
        steps += [tuple(step), tuple(-s for s in step)]
    for diagonal in _SHORT:
        steps += [diagonal, tuple(-s for s in diagonal)]
    return np.array(steps, dtype=np.int64)


DIRECTIONS = _directions()
"""Integer steps to the neighbours, shape (14, 3); the first six are the long ones."""

_DIRECTION_OF = {tuple(step): d for d, step in enumerate(DIRECTIONS.tolist())}


def _tetrahedra_of_an_even_node() -> NDArray[np.int64]:
    """Corners of the 12 tetrahedra on a node's three forward long edges, relative to the node.

    Around the long edge from `p` to `q` lie four nodes of the other parity; each tetrahedron is
    (p, q, ring[i], ring[i + 1]), positively oriented. Shape (12, 4, 3).
    """
    corners = []
    for axis in range(3):
        along, b, c = np.roll(np.eye(3, dtype=np.int64), -axis, axis=0)
        ring = [along + b + c, along - b + c, along - b - c, along + b - c]
        corners += [[0 * along, 2 * along, ring[i], ring[(i + 1) % 4]] for i in range(4)]
    return np.array(corners)


TETRAHEDRON_CORNERS = _tetrahedra_of_an_even_node()
TETRAHEDRON_DIRECTIONS = np.array(
    [
        [[_DIRECTION_OF.get(tuple((b - a).tolist()), -1) for b in corners] for a in corners]
        for corners in TETRAHEDRON_CORNERS
    ]
)
"""Direction from local corner a to local corner b of each of the 12, shape (12, 4, 4)."""


def _link() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangulated sphere of the 14 neighbours of a node: triangles and pairs that share an edge.

    Returns:
        Triangles as direction triples, shape (24, 3), and rows
        (triangle, triangle, direction, direction) of neighbouring triangles with the two
        directions that span their common edge, shape (36, 4).
    """
    triangles = [
        (a, b, c)
        for a in range(LONG_DIRECTIONS, 14)
        for b in range(14)
        for c in range(14)
        if (b < LONG_DIRECTIONS or b > a)
        and c > b
        and c != a
        and _is_link_triangle(DIRECTIONS[[a, b, c]])
    ]
    unique = sorted({tuple(sorted(triangle)) for triangle in triangles})
    pairs = []
    for i, first in enumerate(unique):
        for j in range(i):
            common = sorted(set(first) & set(unique[j]))
            if len(common) == 2:
                pairs.append((j, i, *common))
    return np.array(unique, dtype=np.int64), np.array(pairs, dtype=np.int64)


def _is_link_triangle(steps: NDArray[np.int64]) -> bool:
    """Whether three neighbours of the origin form a lattice tetrahedron with it."""
    edges = [tuple((steps[i] - steps[j]).tolist()) for i, j in ((0, 1), (1, 2), (2, 0))]
    lengths = sorted(sum(c * c for c in edge) for edge in edges)
    long_count = int(np.sum(np.abs(steps).max(axis=1) == 2))
    return all(edge in _DIRECTION_OF for edge in edges) and lengths == [3, 3, 4] and long_count == 1


LINK_TRIANGLES, LINK_EDGES = _link()


@dataclass(frozen=True)
class BccLattice:
    """Lattice nodes in a box.

    Attributes:
        origin: Place of the node with coordinates (0, 0, 0) [m], shape (3,).
        cell: Edge length of the cubes, the length of a long edge [m].
        coordinates: Integer coordinates, ordered lexicographically, shape (node_count, 3).
        neighbours: Row of the neighbour in each direction, -1 where there is none,
            shape (node_count, 14).
    """

    origin: NDArray[np.float64]
    cell: float
    coordinates: NDArray[np.int32]
    neighbours: NDArray[np.int32]

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Node positions [m], shape (node_count, 3)."""
        return np.asarray(self.origin + self.coordinates * (0.5 * self.cell))


def bcc_lattice(lower: NDArray[np.float64], upper: NDArray[np.float64], cell: float) -> BccLattice:
    """Make the lattice that covers a box.

    Args:
        lower: Lower corner of the box [m], shape (3,); becomes a lattice node.
        upper: Upper corner of the box [m], shape (3,).
        cell: Length of a long edge [m].

    Raises:
        ValueError: The box is empty, the cell is not positive, or there are too many nodes.
    """
    if not cell > 0.0:
        raise ValueError(f"cell is {cell}, it must be a positive length in metres")
    if not np.all(upper > lower):
        raise ValueError(f"the box from {lower} to {upper} is empty, upper must exceed lower")
    cells = np.ceil((upper - lower) / cell).astype(np.int64)
    count = int(np.prod(cells + 1) + np.prod(cells))
    if count > MOST_NODES:
        raise ValueError(
            f"a lattice of {count:,} nodes is too large, at most {MOST_NODES:,} are allowed: use a "
            f"larger cell than {cell} m"
        )
    coordinates = np.empty((count, 3), dtype=np.int32)
    neighbours = np.empty((count, 14), dtype=np.int32)
    _number(cells, DIRECTIONS, coordinates, neighbours)
    return BccLattice(np.asarray(lower, dtype=np.float64), float(cell), coordinates, neighbours)


@njit(cache=True)
def _row(x: int, y: int, z: int, cells: NDArray[np.int64]) -> int:
    """Place of a node in lexicographic order, of odd nodes between the even ones; -1 outside."""
    odd = x & 1
    if min(x, y, z) < 0 or x > 2 * cells[0] or y > 2 * cells[1] or z > 2 * cells[2]:
        return -1
    even_plane, odd_plane = (cells[1] + 1) * (cells[2] + 1), cells[1] * cells[2]
    before = (x + odd) // 2 * even_plane + x // 2 * odd_plane
    return int(before + y // 2 * (cells[2] + 1 - odd) + z // 2)


@njit(cache=True)
def _number(
    cells: NDArray[np.int64],
    directions: NDArray[np.int64],
    coordinates: NDArray[np.int32],
    neighbours: NDArray[np.int32],
) -> None:
    """Write coordinates and neighbours of a box's nodes, in lexicographic order."""
    node = 0
    for x in range(2 * cells[0] + 1):
        for y in range(x & 1, 2 * cells[1] + 1, 2):
            for z in range(x & 1, 2 * cells[2] + 1, 2):
                coordinates[node, 0], coordinates[node, 1], coordinates[node, 2] = x, y, z
                for d in range(len(directions)):
                    dx, dy, dz = directions[d, 0], directions[d, 1], directions[d, 2]
                    neighbours[node, d] = _row(x + dx, y + dy, z + dz, cells)
                node += 1


@njit(cache=True)
def _spread(neighbours: NDArray[np.int32], marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Nodes that are marked or next to one that is."""
    wider = marked.copy()
    for node in range(len(marked)):
        if marked[node]:
            for other in neighbours[node]:
                if other >= 0:
                    wider[other] = True
    return wider


def near_nodes(lattice: BccLattice, inside: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Rows of the nodes that stuffing looks at: inside, or up to two edges from there.

    A node next to the inside may become part of the tissue; those beyond are then its outside.
    """
    near = _spread(lattice.neighbours, _spread(lattice.neighbours, inside))
    return np.flatnonzero(near)


def part_of(lattice: BccLattice, rows: NDArray[np.int64]) -> BccLattice:
    """The lattice with some of its nodes only, in the same order; `rows` ascending."""
    new_row = np.full(len(lattice.coordinates) + 1, -1, dtype=np.int32)
    new_row[rows] = np.arange(len(rows), dtype=np.int32)
    return BccLattice(
        lattice.origin, lattice.cell, lattice.coordinates[rows], new_row[lattice.neighbours[rows]]
    )
