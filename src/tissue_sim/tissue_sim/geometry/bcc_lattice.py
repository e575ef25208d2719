"""The body-centred cubic lattice: nodes, neighbours and tetrahedra of isosurface stuffing.

Lattice nodes have integer coordinates that are all even or all odd; one cube ("cell") is two units
wide. Every node has six neighbours along the axes (long edges, one cell) and eight along the cube
diagonals (short edges, sqrt(3)/2 cells). Each lattice tetrahedron has one long edge between even
nodes, one between odd nodes, and four short edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LONG_DIRECTIONS = 6
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
    """All lattice nodes in a box.

    Attributes:
        origin: Place of the node with coordinates (0, 0, 0) [m], shape (3,).
        cell: Edge length of the cubes, the length of a long edge [m].
        coordinates: Integer coordinates, ordered lexicographically, shape (node_count, 3).
        neighbours: Row of the neighbour in each direction, -1 outside the box,
            shape (node_count, 14).
    """

    origin: NDArray[np.float64]
    cell: float
    coordinates: NDArray[np.int64]
    neighbours: NDArray[np.int64]

    @property
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
        ValueError: The box is empty or the cell is not positive.
    """
    if not cell > 0.0:
        raise ValueError(f"cell is {cell}, it must be a positive length in metres")
    if not np.all(upper > lower):
        raise ValueError(f"the box from {lower} to {upper} is empty, upper must exceed lower")
    size = 2 * np.ceil((upper - lower) / cell).astype(np.int64) + 1
    axes = np.meshgrid(*(np.arange(s) for s in size), indexing="ij")
    grid = np.stack([axis.ravel() for axis in axes], axis=1)
    parity = grid & 1
    coordinates = grid[(parity[:, 0] == parity[:, 1]) & (parity[:, 1] == parity[:, 2])]
    row = np.full(tuple(size + 4), -1, dtype=np.int64)
    row[tuple((coordinates + 2).T)] = np.arange(len(coordinates))
    neighbours = np.empty((len(coordinates), 14), dtype=np.int64)
    for direction, step in enumerate(DIRECTIONS):
        neighbours[:, direction] = row[tuple((coordinates + 2 + step).T)]
    return BccLattice(np.asarray(lower, dtype=np.float64), float(cell), coordinates, neighbours)
