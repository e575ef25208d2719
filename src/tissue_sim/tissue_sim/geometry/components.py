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
def joined_as_labelled(
    nodes: NDArray[np.int32],
    label: NDArray[np.int32],
    items: NDArray[np.int32],
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    data: NDArray[np.int32],
    parent: NDArray[np.int32],
) -> bool:
    """Whether nodes are joined by the items at them exactly if they have the same label.

    Args:
        nodes: Some nodes, shape (n,).
        label: Their labels, shape (n,).
        items: Node rows of each item.
        start: Where each node's list begins in `data`, as in `Incidence`.
        count: Length of each list.
        data: Items at each node.
        parent: -1 for each node, and -1 again afterwards.
    """
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
    roots, labels = np.empty(len(nodes), dtype=np.int32), np.empty(len(nodes), dtype=np.int32)
    parts, same = 0, True
    for k in range(len(nodes)):
        if count[nodes[k]] == 0:
            continue
        root, known = _root(parent, nodes[k]), False
        for part in range(parts):
            same = same and (roots[part] == root) == (labels[part] == label[k])
            known = known or roots[part] == root
        if not same:
            break
        if not known:
            roots[parts], labels[parts] = root, label[k]
            parts += 1
    for node in nodes:
        for entry in range(start[node], start[node] + count[node]):
            for corner in range(items.shape[1]):
                parent[items[data[entry], corner]] = -1
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
