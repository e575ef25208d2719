"""Who lies across a face: local questions to a mesh that stores only what meets at each node."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.geometry.faces import LOCAL_FACES
from tissue_sim.geometry.mesh import Mesh

NOBODY = -1


class Links(NamedTuple):
    """The arrays of a mesh that say which elements meet where; views, not copies.

    Attributes:
        tets: Node rows of each element, shape (element_rows, 4).
        start: Where each node's list of elements begins in `data`, shape (node_capacity,).
        length: Length of each list, shape (node_capacity,).
        data: Element rows.
    """

    tets: NDArray[np.int32]
    start: NDArray[np.int64]
    length: NDArray[np.int32]
    data: NDArray[np.int32]


def links_of(mesh: Mesh) -> Links:
    """The links of a mesh as it is now."""
    lists = mesh.incident
    return Links(mesh.tets[: mesh.element_rows], lists.start, lists.count, lists.data)


@njit(cache=True, nogil=True)
def has_node(links: Links, element: int, node: int) -> bool:
    """Whether a node is a corner of an element."""
    nodes = links.tets[element]
    return nodes[0] == node or nodes[1] == node or nodes[2] == node or nodes[3] == node


@njit(cache=True, nogil=True)
def across(links: Links, element: int, corner: int) -> int:
    """The element on the other side of the face opposite a corner; `NOBODY` on the surface."""
    a = links.tets[element, LOCAL_FACES[corner, 0]]
    b = links.tets[element, LOCAL_FACES[corner, 1]]
    c = links.tets[element, LOCAL_FACES[corner, 2]]
    if links.length[b] < links.length[a]:
        a, b = b, a
    if links.length[c] < links.length[a]:
        a, c = c, a
    for k in range(links.start[a], links.start[a] + links.length[a]):
        other = links.data[k]
        if other != element and has_node(links, other, b) and has_node(links, other, c):
            return other
    return NOBODY


@njit(cache=True, nogil=True)
def corner_facing(links: Links, element: int, other: int) -> int:
    """The corner of `element` opposite the face it shares with `other`."""
    for corner in range(4):
        if not has_node(links, other, links.tets[element, corner]):
            return corner
    return NOBODY
