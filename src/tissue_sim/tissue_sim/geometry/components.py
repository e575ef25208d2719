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
