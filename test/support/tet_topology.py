"""Independent checks of a tetrahedral mesh: dihedral angles, boundary, connectivity."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


def dihedral_angles(points: NDArray[np.float64], tets: NDArray[np.integer]) -> NDArray[np.float64]:
    """All dihedral angles [degrees], shape (6, element_count)."""
    normals = []
    for a, b, c in _FACES:
        origin = points[tets[:, a]]
        normal = np.cross(points[tets[:, b]] - origin, points[tets[:, c]] - origin)
        normals.append(normal / np.linalg.norm(normal, axis=1, keepdims=True))
    cosines = [-np.sum(m * n, axis=1) for m, n in combinations(normals, 2)]
    return np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))


def _count_groups(pairs: NDArray[np.integer], size: int) -> tuple[int, NDArray[np.int32]]:
    graph = sp.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    count, labels = connected_components(graph, directed=False)
    return int(count), labels


def component_count(tets: NDArray[np.integer]) -> int:
    """Number of parts that share no node."""
    used, rows = np.unique(tets, return_inverse=True)
    rows = rows.reshape(tets.shape)
    pairs = np.concatenate([rows[:, [0, k]] for k in (1, 2, 3)])
    return _count_groups(pairs, len(used))[0]


def boundary(tets: NDArray[np.integer]) -> NDArray[np.integer]:
    """Faces that belong to one tetrahedron only, outward, shape (n, 3)."""
    faces = np.concatenate([tets[:, face] for face in _FACES])
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    assert count.max() <= 2
    return faces[first[count == 1]]


def _edges(triangles: NDArray[np.integer]) -> NDArray[np.integer]:
    sides = [triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]
    return np.sort(np.concatenate(sides), axis=1)


def euler_characteristic(triangles: NDArray[np.integer]) -> int:
    """Nodes minus edges plus triangles of a surface."""
    edges = np.unique(_edges(triangles), axis=0)
    return len(np.unique(triangles)) - len(edges) + len(triangles)


def most_triangles_at_an_edge(triangles: NDArray[np.integer]) -> int:
    """Two for a closed surface that touches itself nowhere along an edge."""
    counts = np.unique(_edges(triangles), axis=0, return_counts=True)[1]
    assert counts.min() == 2
    return int(counts.max())


def _fans(cells: NDArray[np.integer], shared: int) -> int:
    """Number of (node, group) pairs: groups of cells at a node joined by `shared` common nodes.

    Equals the number of nodes if at every node all cells hang together.
    """
    corners = cells.shape[1]
    slots: list[NDArray[np.integer]] = []
    keys: list[NDArray[np.integer]] = []
    for subset in combinations(range(corners), shared):
        key = np.sort(cells[:, subset], axis=1)
        for corner in subset:
            # One row per (node, side through that node), and the cell's slot at the node.
            keys.append(np.column_stack([cells[:, corner], key]))
            slots.append(np.arange(len(cells)) * corners + corner)
    _, group = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    slot = np.concatenate(slots)
    size = cells.size
    pairs = np.column_stack([slot, size + group.ravel()])
    count, _ = _count_groups(pairs, size + int(group.max()) + 1)
    return count


def is_cut_regular(tets: NDArray[np.integer]) -> bool:
    """Whether at every node all tetrahedra are connected through faces that contain the node."""
    return _fans(tets, 3) == len(np.unique(tets))


def is_manifold(triangles: NDArray[np.integer]) -> bool:
    """Whether at every node the triangles form one fan."""
    return most_triangles_at_an_edge(triangles) == 2 and _fans(triangles, 2) == len(
        np.unique(triangles)
    )
