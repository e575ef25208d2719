"""What a mesh must be after every edit, checked without the code that made it so."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tissue_sim.geometry.mesh import Mesh

_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


class Shape(NamedTuple):
    """Figures of a valid mesh.

    Attributes:
        components: Parts whose elements are connected through faces.
        volume: Of the rest shape [m^3].
        surface_triangles: Faces of one element only.
    """

    components: int
    volume: float
    surface_triangles: int


def _parts(first: NDArray[np.int64], second: NDArray[np.int64], count: int) -> int:
    graph = coo_matrix((np.ones(len(first)), (first, second)), shape=(count, count))
    return int(connected_components(graph, directed=False)[0])


def check_valid(mesh: Mesh) -> Shape:
    """Assert everything a mesh must be.

    No element is inverted or flat at rest, every face is in at most two elements, no node is
    without elements, and all elements at a node are connected through faces that contain it.
    """
    rows = mesh.element_rows
    tets = mesh.tets[:rows][mesh.element_alive[:rows]].astype(np.int64)
    a, b, c, d = (mesh.rest[tets[:, k]] for k in range(4))
    volumes = np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0
    assert (volumes > 0).all()
    used = np.unique(tets)
    assert np.array_equal(used, np.flatnonzero(mesh.node_alive)), "orphan nodes"

    faces = np.sort(tets[:, _FACES].reshape(-1, 3), axis=1)
    _, key, size = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    assert size.max() <= 2
    order = np.argsort(key.ravel(), kind="stable")
    same = np.flatnonzero(key.ravel()[order][1:] == key.ravel()[order][:-1])
    first, second = order[same] // 4, order[same + 1] // 4

    # One vertex per corner of an element; corners at the same node joined across shared faces.
    one, other = [], []
    for i in range(4):
        for j in range(4):
            meet = tets[first, i] == tets[second, j]
            one.append(4 * first[meet] + i)
            other.append(4 * second[meet] + j)
    corners = _parts(np.concatenate(one), np.concatenate(other), 4 * len(tets))
    assert corners == len(used), "a node's elements are not connected through faces"
    components = _parts(first, second, len(tets))
    return Shape(components, float(volumes.sum()), int((size == 1).sum()))
