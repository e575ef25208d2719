"""How many parts an organ falls into by an edit, found out around the edit.

Joined are nodes of one element. All that an edit changes is which nodes its elements join. So the
nodes around it are grouped by what joins them before and after; where groups are left, each is
followed outwards, all at the same pace, until they have met or all but one have come to an end.
A partial cut is one group, joined around its rim; a cut right through costs as much as its smaller
side is large.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.geometry.incidence import among
from tissue_sim.geometry.mesh import Mesh

Rows = NDArray[np.int32]

CHANGED = -1
"""Mark of a node whose elements the edit changes."""


@njit(cache=True, nogil=True)
def _root(parent: Rows, k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@njit(cache=True, nogil=True)
def _join(parent: Rows, items: Rows) -> None:
    """Unite the nodes of every item."""
    for k in range(items.shape[0]):
        first = _root(parent, items[k, 0])
        for corner in range(1, 4):
            parent[_root(parent, items[k, corner])] = first


@njit(cache=True, nogil=True)
def _meet(
    tets: Rows,
    start: NDArray[np.int64],
    count: Rows,
    data: Rows,
    seeds: Rows,
    groups: Rows,
    number: int,
    mark: Rows,
    following: Rows,
    joined: Rows,
) -> None:
    """Follow groups of nodes outwards until they have met; into `joined` which have.

    `mark` is 0 for nodes not seen, `CHANGED`, or 1 + a group; `following` chains each group's nodes
    that are still to be looked at.
    """
    head, tail = np.full(number, -1, dtype=np.int32), np.full(number, -1, dtype=np.int32)
    for k in range(seeds.shape[0]):
        node, group = seeds[k], groups[k]
        mark[node], following[node] = 1 + group, -1
        if head[group] < 0:
            head[group] = node
        else:
            following[tail[group]] = node
        tail[group] = node
    active = number
    while active > 1:
        for turn in range(number):
            group = _root(joined, turn)
            if group != turn or head[group] < 0:
                continue
            node = head[group]
            head[group] = following[node]
            for k in range(start[node], start[node] + count[node]):
                for corner in range(4):
                    other = tets[data[k], corner]
                    if mark[other] == CHANGED:
                        continue
                    if mark[other] == 0:
                        mark[other], following[other] = 1 + group, -1
                        if head[group] < 0:
                            head[group] = other
                        else:
                            following[tail[group]] = other
                        tail[group] = other
                        continue
                    met = _root(joined, mark[other] - 1)
                    if met != group:
                        joined[met] = group
                        if head[met] >= 0:
                            if head[group] < 0:
                                head[group] = head[met]
                            else:
                                following[tail[group]] = head[met]
                            tail[group] = tail[met]
        active = 0
        for group in range(number):
            if _root(joined, group) == group and head[group] >= 0:
                active += 1


def change_of_parts(mesh: Mesh, elements: Rows, old: Rows, new: Rows) -> int:
    """By how many the number of parts grows with an edit.

    Args:
        mesh: The mesh, before the edit or after it.
        elements: Rows of the elements changed, taken out or added, shape (n,).
        old: Their nodes before, -1 where one is new, shape (n, 4).
        new: Their nodes after, -1 where one is taken out, shape (n, 4). Nodes that the mesh does
            not have are rows behind its own.
    """
    old, new = old[old[:, 0] >= 0], new[new[:, 0] >= 0]
    touched = np.unique(np.concatenate([old.ravel(), new.ravel()])).astype(np.int32)
    there = touched[touched < mesh.node_rows]
    around = mesh.incident.of_all(there)
    around = around[~among(around, elements)]
    items = mesh.tets[around]
    nodes = np.unique(np.concatenate([touched, items.ravel()]))
    items, old, new = (np.searchsorted(nodes, some).astype(np.int32) for some in (items, old, new))
    before, after = (np.arange(len(nodes), dtype=np.int32) for _ in range(2))
    _join(before, np.concatenate([items, old]))
    _join(after, np.concatenate([items, new]))
    first, second = _roots(before), _roots(after)
    outer = np.flatnonzero(~among(nodes, touched))
    pairs = first[outer].astype(np.int64) * len(nodes) + second[outer]
    keys, lowest, groups = np.unique(pairs, return_index=True, return_inverse=True)
    joined = np.arange(len(keys), dtype=np.int32)
    if len(keys) > 1:
        mark = np.zeros(mesh.node_rows, dtype=np.int32)
        mark[there] = CHANGED
        lists = mesh.incident
        _meet(
            mesh.tets, lists.start, lists.count, lists.data, nodes[outer].astype(np.int32),
            groups.ravel().astype(np.int32), len(keys), mark,
            np.empty(mesh.node_rows, dtype=np.int32), joined,
        )  # fmt: skip
    # One node stands for each group; what has met is one part, before and after.
    ends = outer[lowest].astype(np.int32)
    met = np.stack([ends, ends[_roots(joined)], ends, ends], axis=1)
    _join(before, met)
    _join(after, met)
    return _count(after, items, new) - _count(before, items, old)


def _roots(parent: Rows) -> Rows:
    roots = parent[parent]
    while not np.array_equal(roots, parent):
        parent, roots = roots, roots[roots]
    return roots


def _count(parent: Rows, *items: Rows) -> int:
    """Parts that have an item."""
    return len(np.unique(_roots(parent)[np.concatenate(items)[:, 0]]))
