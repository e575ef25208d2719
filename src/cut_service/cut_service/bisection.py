"""Dividing elements at points on their edges so that neighbours agree on shared faces.

The edges that carry a point are bisected one after the other, in one order for the whole mesh: an
element with such an edge becomes two, which share the triangle from the point to the opposite edge.
How a face is divided then depends on the order of its own three edges only, so the two elements at
it agree, whichever of their edges carry points. No other node is needed, every child has a positive
share of its parent's volume, in every configuration, and nothing has to be looked up by cases: an
element parted 3-1 becomes a tip and three, one parted 2-2 becomes six.

Every child keeps an end of the last edge that was bisected for it, so no child consists of points
on the sweep alone, and no edge from one side of the sweep to the other is left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.crossings import EDGE_BETWEEN, PARTED
from cut_service.neighbours import NOBODY, Links, across, corner_facing, has_node

MOST_CHILDREN = 64
"""Six edges can double an element at most so often."""

NO_SIDE = -1


class Division(NamedTuple):
    """Elements and their children.

    Attributes:
        parents: Rows of the elements divided, ascending, shape (p,).
        children: Nodes of their children, shape (c, 4): rows of the mesh, or `first_new` + k for
            the point on edge k.
        parent_of: Row of each child's parent, shape (c,).
        side: Side of the sweep on which each child lies, 0 or 1 within one parent, -1 where the
            sweep does not pass right through the parent, shape (c,).
        holders: Row of an element at each edge, shape (e,).
    """

    parents: NDArray[np.int32]
    children: NDArray[np.int32]
    parent_of: NDArray[np.int32]
    side: NDArray[np.int32]
    holders: NDArray[np.int32]


@njit(cache=True, nogil=True)
def _edges_of(
    links: Links,
    edges: NDArray[np.int32],
    slot: NDArray[np.int32],
    rows: NDArray[np.int32],
    carried: NDArray[np.int32],
    holders: NDArray[np.int32],
) -> int:
    """List the elements at the edges, and for each the edges it has, ascending.

    `slot` is -1 for all elements before. Returns the number of elements.
    """
    found = 0
    for k in range(edges.shape[0]):
        a, b = edges[k, 0], edges[k, 1]
        for place in range(links.start[a], links.start[a] + links.length[a]):
            element = links.data[place]
            if not has_node(links, element, b):
                continue
            if slot[element] == NOBODY:
                slot[element] = found
                rows[found] = element
                carried[found, :] = NOBODY
                found += 1
            holders[k] = element
            for free in range(6):
                if carried[slot[element], free] == NOBODY:
                    carried[slot[element], free] = k
                    break
    return found


@njit(cache=True, nogil=True)
def _side_of(
    links: Links, row: int, mask: int, child: NDArray[np.int32], on: NDArray[np.bool_]
) -> int:
    for corner in range(4):
        node = links.tets[row, corner]
        if on[node]:
            continue
        for k in range(4):
            if child[k] == node:
                return (mask >> EDGE_BETWEEN[0, corner]) & 1 if corner else 0
    return NO_SIDE


@njit(cache=True, nogil=True)
def _divide(
    links: Links,
    rows: NDArray[np.int32],
    carried: NDArray[np.int32],
    edges: NDArray[np.int32],
    first_new: int,
    masks: NDArray[np.uint8],
    parted: NDArray[np.bool_],
    on: NDArray[np.bool_],
    children: NDArray[np.int32],
    parent_of: NDArray[np.int32],
    side: NDArray[np.int32],
) -> int:
    total = 0
    piece = np.empty((MOST_CHILDREN, 4), dtype=np.int32)
    for n in range(rows.shape[0]):
        row = rows[n]
        piece[0] = links.tets[row]
        count = 1
        for step in range(6):
            edge = carried[n, step]
            if edge == NOBODY:
                break
            a, b = edges[edge, 0], edges[edge, 1]
            for k in range(count):
                i, j = NOBODY, NOBODY
                for corner in range(4):
                    if piece[k, corner] == a:
                        i = corner
                    elif piece[k, corner] == b:
                        j = corner
                if i == NOBODY or j == NOBODY:
                    continue
                piece[count] = piece[k]
                piece[k, j] = first_new + edge
                piece[count, i] = first_new + edge
                count += 1
        for k in range(count):
            children[total] = piece[k]
            parent_of[total] = row
            side[total] = (
                _side_of(links, row, masks[row], piece[k], on) if parted[masks[row]] else NO_SIDE
            )
            total += 1
    return total


def divide(
    links: Links,
    edges: NDArray[np.int32],
    masks: NDArray[np.uint8],
    on: NDArray[np.bool_],
    first_new: int,
) -> Division:
    """Divide all elements at some edges.

    Args:
        links: The mesh.
        edges: Node rows of the edges in the order in which they are bisected, shape (e, 2).
        masks: Crossed edges of every element row, as in `Crossings`.
        on: Nodes on the sweep, shape (node_rows,).
        first_new: Number that stands for the point on the first edge.
    """
    room = int(np.minimum(links.length[edges[:, 0]], links.length[edges[:, 1]]).sum()) + 1
    slot = np.full(len(links.tets), NOBODY, dtype=np.int32)
    rows, carried = np.empty(room, dtype=np.int32), np.empty((room, 6), dtype=np.int32)
    holders = np.empty(len(edges), dtype=np.int32)
    found = _edges_of(links, edges, slot, rows, carried, holders)
    order = np.argsort(rows[:found])
    rows, carried = rows[:found][order], carried[:found][order]
    # An element with e such edges has at most 2^e children; what they have is far less.
    most = int((1 << (carried != NOBODY).sum(axis=1)).sum())
    children = np.empty((most, 4), dtype=np.int32)
    parent_of, side = np.empty(most, dtype=np.int32), np.empty(most, dtype=np.int32)
    total = _divide(
        links, rows, carried, edges, first_new, masks, PARTED, on, children, parent_of, side
    )
    return Division(
        rows, children[:total].copy(), parent_of[:total].copy(), side[:total].copy(), holders
    )


@njit(cache=True, nogil=True)
def _part_children(
    links: Links,
    parent_of: NDArray[np.int32],
    side: NDArray[np.int32],
    first: int,
    cut: NDArray[np.uint8],
    faces: NDArray[np.int32],
) -> int:
    """Cut the faces between children of one parent on different sides. Their number."""
    found = 0
    for k in range(parent_of.shape[0]):
        other = k + 1
        while other < parent_of.shape[0] and parent_of[other] == parent_of[k]:
            if side[k] >= 0 and side[other] >= 0 and side[k] != side[other]:
                shared = 0
                for corner in range(4):
                    shared += has_node(links, first + other, links.tets[first + k, corner])
                if shared == 3:
                    mine = corner_facing(links, first + k, first + other)
                    cut[first + k] |= 1 << mine
                    cut[first + other] |= 1 << corner_facing(links, first + other, first + k)
                    faces[found, 0], faces[found, 1] = first + k, mine
                    found += 1
            other += 1
    return found


@njit(cache=True, nogil=True)
def _crossed_to(links: Links, masks: NDArray[np.uint8], row: int, node: int, end: int) -> int:
    """Whether the edge of an element between two of its nodes is crossed; 0 if they are one."""
    if node == end:
        return 0
    i, j = 0, 0
    for corner in range(4):
        if links.tets[row, corner] == node:
            i = corner
        if links.tets[row, corner] == end:
            j = corner
    return (masks[row] >> EDGE_BETWEEN[i, j]) & 1


@njit(cache=True, nogil=True)
def _stands_for(
    links: Links,
    row: int,
    corner: int,
    on: NDArray[np.bool_],
    distance: NDArray[np.float64],
) -> int:
    """The node that says on which side an element with all of a face on the sweep is."""
    node = links.tets[row, corner]
    if not on[node]:
        return node
    for other in range(4):
        if distance[links.tets[row, other]] > distance[node]:
            node = links.tets[row, other]
    return node


@njit(cache=True, nogil=True)
def _part_whole(
    links: Links,
    rows: NDArray[np.int32],
    masks: NDArray[np.uint8],
    on: NDArray[np.bool_],
    distance: NDArray[np.float64],
    cut: NDArray[np.uint8],
    faces: NDArray[np.int32],
) -> int:
    """Cut the faces on the sweep between undivided elements on different sides. Their number."""
    found = 0
    for row in rows:
        for corner in range(4):
            lies_on = True
            for k in range(4):
                lies_on = lies_on and (k == corner or on[links.tets[row, k]])
            other = across(links, row, corner) if lies_on else NOBODY
            if other == NOBODY or other < row:
                continue
            facing = corner_facing(links, other, row)
            mine = _stands_for(links, row, corner, on, distance)
            theirs = _stands_for(links, other, facing, on, distance)
            apart = True
            for k in range(4):
                if k != corner:
                    x = links.tets[row, k]
                    passed = _crossed_to(links, masks, row, x, mine)
                    apart = apart and passed != _crossed_to(links, masks, other, x, theirs)
            if apart:
                cut[row] |= 1 << corner
                cut[other] |= 1 << facing
                faces[found, 0], faces[found, 1] = row, corner
                found += 1
    return found


def part(
    before: Links,
    after: Links,
    division: Division,
    near: NDArray[np.int32],
    masks: NDArray[np.uint8],
    on: NDArray[np.bool_],
    distance: NDArray[np.float64],
) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """Find the faces between the two sides of the sweep in a divided mesh.

    Args:
        before: The mesh.
        after: The mesh with the children behind its own rows.
        division: What was divided.
        near: Rows of undivided elements with three nodes or more on the sweep.
        masks: Crossed edges of every element row before.
        on: Nodes on the sweep, shape (node_rows,).
        distance: Distance of those nodes from it [m], shape (node_rows,).

    Returns:
        For every element row after the set of its faces in the cut surface, bit k for the face
        opposite corner k; and element row and opposite corner of those faces, each once.
    """
    cut = np.zeros(len(after.tets), dtype=np.uint8)
    first, own = len(before.tets), 4 * len(division.children)
    faces = np.empty((own + 4 * len(near), 2), dtype=np.int32)
    found = _part_children(after, division.parent_of, division.side, first, cut, faces)
    found += _part_whole(before, near, masks, on, distance, cut, faces[found:])
    return cut, faces[:found].copy()
