"""Copying nodes so that the two sides of a cut surface come apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.neighbours import NOBODY, Links, across, corner_facing
from tissue_sim.geometry.faces import LOCAL_FACES


@dataclass(frozen=True)
class Ungluing:
    """What to copy and to rewire.

    Attributes:
        parents: Row of the node each copy is made of, shape (copies,).
        elements: Rows of elements whose nodes change, ascending, shape (n,).
        nodes: Their new nodes, shape (n, 4): a row of the mesh, or `first_copy` + k for copy k.
        first_copy: The number that stands for the first copy; all rows of the mesh are smaller.
        opened: Element row and opposite corner of each face that came apart, shape (m, 2).
    """

    parents: NDArray[np.int32]
    elements: NDArray[np.int32]
    nodes: NDArray[np.int32]
    first_copy: int
    opened: NDArray[np.int32]


@njit(cache=True, nogil=True)
def _leader(group: NDArray[np.int32], k: int) -> int:
    while group[k] != k:
        k = group[k]
    return k


@njit(cache=True, nogil=True)
def _groups_at(links: Links, cut: NDArray[np.uint8], node: int, group: NDArray[np.int32]) -> int:
    """Number the elements at a node by groups joined through uncut faces that contain it.

    Group 0 holds the lowest element row, and groups are numbered by their lowest row. Returns the
    number of groups.
    """
    begin, count = links.start[node], links.length[node]
    rows = links.data[begin : begin + count]
    for k in range(count):
        group[k] = k
    for k in range(count):
        element = rows[k]
        for corner in range(4):
            if links.tets[element, corner] == node or cut[element] & (1 << corner):
                continue
            other = across(links, element, corner)
            if other == NOBODY:
                continue
            for m in range(count):
                if rows[m] == other:
                    first, second = _leader(group, k), _leader(group, m)
                    group[max(first, second)] = min(first, second)
    for k in range(count):
        group[k] = _leader(group, k)
    number = 0
    lowest = np.full(count, NOBODY, dtype=np.int32)
    for k in range(count):
        g = group[k]
        if lowest[g] == NOBODY:
            lowest[g] = rows[k]
            number += 1
        lowest[g] = min(lowest[g], rows[k])
    for k in range(count):
        rank = 0
        for m in range(count):
            if lowest[m] != NOBODY and lowest[m] < lowest[group[k]]:
                rank += 1
        group[k] = -1 - rank
    for k in range(count):
        group[k] = -1 - group[k]
    return number


@njit(cache=True, nogil=True)
def _copy_nodes(
    links: Links,
    cut: NDArray[np.uint8],
    nodes: NDArray[np.int32],
    first_copy: int,
    parents: NDArray[np.int32],
    changes: NDArray[np.int32],
) -> tuple[int, int]:
    """Enter the parent of each copy in `parents` and (element, corner, copy) in `changes`.

    The lengths of both.
    """
    copies, changed = 0, 0
    most = 0
    for node in nodes:
        most = max(most, links.length[node])
    group = np.empty(most, dtype=np.int32)
    for node in nodes:
        number = _groups_at(links, cut, node, group)
        if number == 1:
            continue
        for k in range(links.length[node]):
            if group[k] == 0:
                continue
            element = links.data[links.start[node] + k]
            for corner in range(4):
                if links.tets[element, corner] == node:
                    changes[changed, 0], changes[changed, 1] = element, corner
                    changes[changed, 2] = first_copy + copies + group[k] - 1
                    changed += 1
        for _ in range(number - 1):
            parents[copies] = node
            copies += 1
    return copies, changed


@njit(cache=True, nogil=True)
def _open_faces(
    links: Links,
    faces: NDArray[np.int32],
    place: NDArray[np.int32],
    nodes: NDArray[np.int32],
    opened: NDArray[np.bool_],
) -> None:
    """Which faces have come apart: their two sides no longer share all three nodes."""
    for k in range(faces.shape[0]):
        element, corner = faces[k, 0], faces[k, 1]
        other = across(links, element, corner)
        facing = corner_facing(links, other, element)
        for i in range(3):
            c = LOCAL_FACES[corner, i]
            old = links.tets[element, c]
            new = nodes[place[element], c] if place[element] != NOBODY else old
            for j in range(3):
                d = LOCAL_FACES[facing, j]
                if links.tets[other, d] == old:
                    twin = nodes[place[other], d] if place[other] != NOBODY else old
                    if twin != new:
                        opened[k] = True


def unglue(
    links: Links, cut: NDArray[np.uint8], faces: NDArray[np.int32], first_copy: int
) -> Ungluing:
    """Copy the nodes of the cut surface: one copy for every group of elements beyond the first.

    Two elements are in one group when a chain of elements at the node joins them through faces
    outside the cut surface. The group with the lowest element row keeps the node. A node at the
    inner rim of a partial cut has one group
    only: the rim stays whole.

    Args:
        links: The mesh.
        cut: Faces in the cut surface, bits by corner, shape (element_rows,).
        faces: Element row and opposite corner of the same faces, each once, shape (n, 2).
        first_copy: Number that stands for the first copy.
    """
    corners = LOCAL_FACES[faces[:, 1]]
    nodes = np.unique(np.take_along_axis(links.tets[faces[:, 0]], corners, axis=1))
    whole = unglue_at(links, cut, nodes, first_copy)
    place = np.full(len(links.tets), NOBODY, dtype=np.int32)
    place[whole.elements] = np.arange(len(whole.elements))
    opened = np.zeros(len(faces), dtype=np.bool_)
    _open_faces(links, faces, place, whole.nodes, opened)
    return replace(whole, opened=faces[opened])


def unglue_at(
    links: Links, cut: NDArray[np.uint8], nodes: NDArray[np.int32], first_copy: int
) -> Ungluing:
    """Copy some nodes: as `unglue` does those of a cut surface, but for saying what opens.

    Args:
        links: The mesh.
        cut: Faces in the cut surface, bits by corner, shape (element_rows,).
        nodes: Rows of the nodes, ascending, shape (n,).
        first_copy: Number that stands for the first copy.
    """
    room = int(links.length[nodes].sum())
    parents = np.empty(room, dtype=np.int32)
    changes = np.empty((room, 3), dtype=np.int32)
    copies, changed = _copy_nodes(links, cut, nodes, first_copy, parents, changes)
    changes = changes[:changed]
    elements, position = np.unique(changes[:, 0], return_inverse=True)
    rewritten = links.tets[elements].copy()
    rewritten[position.ravel(), changes[:, 1]] = changes[:, 2]
    return Ungluing(
        parents[:copies].copy(), elements, rewritten, first_copy, np.empty((0, 2), dtype=np.int32)
    )
