"""Connected parts of a mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tissue_sim.geometry.mesh import Mesh


@njit(cache=True, nogil=True)
def _root(parent: NDArray[np.int32], node: int) -> int:
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@njit(cache=True, nogil=True)
def _label(
    items: NDArray[np.int32],
    alive: NDArray[np.bool_],
    parent: NDArray[np.int32],
    labels: NDArray[np.int32],
) -> int:
    """Join the nodes of every item, the lowest row becoming the root, and number the parts."""
    for node in range(len(parent)):
        parent[node] = node
        labels[node] = -1
    for item in range(len(items)):
        if not alive[item]:
            continue
        first = _root(parent, items[item, 0])
        labels[items[item, 0]] = 0
        for corner in range(1, items.shape[1]):
            labels[items[item, corner]] = 0
            other = _root(parent, items[item, corner])
            if other < first:
                parent[first] = other
                first = other
            elif first < other:
                parent[other] = first
    count = 0
    for node in range(len(parent)):
        if labels[node] < 0:
            continue
        root = _root(parent, node)
        if root == node:
            labels[node] = count
            count += 1
        else:
            labels[node] = labels[root]
    return count


@njit(cache=True, nogil=True)
def _join_at(nodes, items, start, count, data, parent):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Join the nodes of the items at some nodes; `parent` was -1 for each."""
    for node in nodes:
        for entry in range(start[node], start[node] + count[node]):
            for corner in range(items.shape[1]):
                parent[items[data[entry], corner]] = items[data[entry], corner]
    for node in nodes:
        first = _root(parent, node) if count[node] > 0 else node
        for entry in range(start[node], start[node] + count[node]):
            for corner in range(items.shape[1]):
                other = _root(parent, items[data[entry], corner])
                if other != first:
                    parent[max(first, other)] = min(first, other)
                    first = min(first, other)


@njit(cache=True, nogil=True)
def _still_joined(old, alive, parent):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Whether what old items joined is joined; those that vanished remember in `parent` by what."""
    for item in range(len(old)):
        root = np.int32(-1)
        for corner in range(old.shape[1]):
            node = old[item, corner]
            if node < 0 or not alive[node]:
                continue
            if root >= 0 and _root(parent, node) != root:
                return False
            root = _root(parent, node)
        for corner in range(old.shape[1]):
            node = old[item, corner]
            if node < 0 or alive[node]:
                continue
            if root < 0 or (parent[node] != -1 and parent[node] != -2 - root):
                return False
            parent[node] = -2 - root
    return True


@njit(cache=True, nogil=True)
def joined_as_before(
    nodes: NDArray[np.int32],
    label: NDArray[np.int32],
    old: NDArray[np.int32],
    alive: NDArray[np.bool_],
    items: NDArray[np.int32],
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    data: NDArray[np.int32],
    parent: NDArray[np.int32],
) -> bool:
    """Whether an edit leaves parts as they were, as far as can be seen around it.

    It does if what the items that it changed joined is joined by those at their nodes, and nodes
    that are joined have the same label.

    Args:
        nodes: Nodes that the edit touched and that are there, shape (n,).
        label: Part of each of them before it, for copies that of their parents, shape (n,).
        old: Nodes of the items it changed before it, -1 for none, shape (m, corners).
        alive: Nodes that are there.
        items: Node rows of each item.
        start: Where each node's list begins in `data`, as in `Incidence`.
        count: Length of each list.
        data: Items at each node.
        parent: -1 for each node, and -1 again afterwards.
    """
    _join_at(nodes, items, start, count, data, parent)
    same = _still_joined(old, alive, parent)
    roots, labels = np.empty(len(nodes), dtype=np.int32), np.empty(len(nodes), dtype=np.int32)
    parts = 0
    for k in range(len(nodes)):
        if not same or count[nodes[k]] == 0:
            continue
        root, known = _root(parent, nodes[k]), False
        for part in range(parts):
            if roots[part] == root:
                same, known = labels[part] == label[k], True
        if not known:
            roots[parts], labels[parts] = root, label[k]
            parts += 1
    for node in nodes:
        for entry in range(start[node], start[node] + count[node]):
            for corner in range(items.shape[1]):
                parent[items[data[entry], corner]] = -1
    for item in range(len(old)):
        for corner in range(old.shape[1]):
            if old[item, corner] >= 0:
                parent[old[item, corner]] = -1
    return same


def connected_components(
    items: NDArray[np.int32], alive: NDArray[np.bool_], node_count: int
) -> tuple[int, NDArray[np.int32]]:
    """Label nodes by the connected part they belong to.

    Args:
        items: Node rows of each item (tetrahedron, triangle, spring), shape (item_count, corners).
        alive: Items that connect, shape (item_count,).
        node_count: Number of node rows.

    Returns:
        The number of parts; and the part of each node, numbered by their lowest node row,
        -1 for nodes without an item, shape (node_count,).
    """
    parent = np.empty(node_count, dtype=np.int32)
    labels = np.empty(node_count, dtype=np.int32)
    count = _label(np.ascontiguousarray(items, dtype=np.int32), alive, parent, labels)
    return int(count), labels


def parts_of(mesh: Mesh) -> int:
    """Number of connected parts of a mesh: of its elements, or of a sheet's edges and springs."""
    if mesh.sheet is None:
        rows = mesh.element_rows
        items, alive = mesh.tets[:rows], mesh.element_alive[:rows]
    else:
        sides = mesh.sheet.triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
        items = np.concatenate([sides, mesh.sheet.springs])
        alive = np.ones(len(items), dtype=np.bool_)
    return connected_components(items, alive, mesh.node_rows)[0]
