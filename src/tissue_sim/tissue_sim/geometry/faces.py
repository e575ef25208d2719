"""Faces of tetrahedra and which element lies on their other side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

LOCAL_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Corners of the face opposite each corner, outward for a positive tetrahedron, shape (4, 3)."""

_MANY = 64
"""Triples of one first node beyond which they are merged rather than inserted one by one."""


class FacePairs(NamedTuple):
    """Which faces of which elements coincide; face `4 * element + k` lies opposite corner k.

    Attributes:
        first: Faces with a partner, shape (pair_count,); the element with the lower row.
        second: Their partners, shape (pair_count,).
        border: Faces of one element only, ascending, shape (border_count,).
        crowded: Faces that more than two elements have, shape (crowded_count,).
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    border: NDArray[np.int64]
    crowded: NDArray[np.int64]


def face_nodes(tets: NDArray[np.integer], faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Nodes of faces, outward for positive tetrahedra, shape (face_count, 3)."""
    return tets[faces[:, None] // 4, LOCAL_FACES[faces % 4]].astype(np.int64)


def pair_faces(tets: NDArray[np.integer]) -> FacePairs:
    """Find coinciding faces.

    Args:
        tets: Node rows, shape (element_count, 4).
    """
    nodes = np.empty((4 * len(tets), 3), dtype=np.int64)
    _sorted_faces(tets, LOCAL_FACES, nodes)
    order = order_of_triples(nodes)
    start = np.flatnonzero(_begins(nodes, order))
    size = np.diff(np.append(start, len(order)))
    pairs = start[size == 2]
    crowded = np.concatenate(
        [np.empty(0, dtype=np.int64)]
        + [order[s : s + n] for s, n in zip(start[size > 2], size[size > 2], strict=True)]
    )
    return FacePairs(order[pairs], order[pairs + 1], np.sort(order[start[size == 1]]), crowded)


@njit(cache=True, nogil=True)
def _sorted_faces(
    tets: NDArray[np.integer], corners: NDArray[np.int64], nodes: NDArray[np.int64]
) -> None:
    """Write the nodes of every face, ascending."""
    for element in range(len(tets)):
        for face in range(4):
            a, b, c = (
                tets[element, corners[face, 0]],
                tets[element, corners[face, 1]],
                tets[element, corners[face, 2]],
            )
            low, high = min(a, b, c), max(a, b, c)
            row = 4 * element + face
            nodes[row, 0], nodes[row, 1], nodes[row, 2] = low, a + b + c - low - high, high


@njit(cache=True, nogil=True)
def _begins(nodes: NDArray[np.int64], order: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Where in an order of triples one differs from the one before."""
    begins = np.ones(len(order), dtype=np.bool_)
    for place in range(1, len(order)):
        a, b = order[place - 1], order[place]
        begins[place] = (
            nodes[a, 0] != nodes[b, 0] or nodes[a, 1] != nodes[b, 1] or nodes[a, 2] != nodes[b, 2]
        )
    return begins


def order_of_triples(nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Stable lexicographic order of node triples, shape (n, 3) -> (n,)."""
    span = int(nodes.max(initial=0)) + 1
    if span < 1 << 31 and span < 4 * len(nodes) + 1024 and nodes.min(initial=0) >= 0:
        return np.asarray(_order_of_triples(np.ascontiguousarray(nodes), span))
    return np.lexsort((nodes[:, 2], nodes[:, 1], nodes[:, 0]))


@njit(cache=True, nogil=True)
def _order_of_triples(nodes: NDArray[np.int64], span: int) -> NDArray[np.int64]:
    """Count the triples at each first node, then sort the few that share it."""
    begin = np.zeros(span + 1, dtype=np.int64)
    for item in range(len(nodes)):
        begin[nodes[item, 0] + 1] += 1
    begin = np.cumsum(begin)
    order, place = np.empty(len(nodes), dtype=np.int64), begin.copy()
    keys = np.empty(len(nodes), dtype=np.int64)
    for item in range(len(nodes)):
        at = place[nodes[item, 0]]
        order[at], keys[at] = item, nodes[item, 1] * span + nodes[item, 2]
        place[nodes[item, 0]] += 1
    for node in range(span):
        first, last = begin[node], begin[node + 1]
        if last - first > _MANY:
            order[first:last] = order[first:last][np.argsort(keys[first:last], kind="mergesort")]
            continue
        for at in range(first + 1, last):
            key, item = keys[at], order[at]
            while at > first and keys[at - 1] > key:
                keys[at], order[at] = keys[at - 1], order[at - 1]
                at -= 1
            keys[at], order[at] = key, item
    return order


def turns_alike(
    tets: NDArray[np.integer], first: NDArray[np.int64], second: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Pairs whose elements lie on the same side of their common face, shape (pair_count,).

    Two positive elements that share a face see its nodes in opposite order; if not, they overlap.
    """
    return _is_odd(face_nodes(tets, first)) == _is_odd(face_nodes(tets, second))


def _is_odd(faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    a, b, c = faces.T
    return ((a > b) ^ (b > c) ^ (a > c)).astype(np.bool_)
