"""What a mesh must be after every edit, found out without the code that edits it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.joined_parts import count_parts
from cut_service.sheet_validity import sheet_faults, sheet_joints, sheet_quality
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import radius_ratios

_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


@dataclass(frozen=True)
class Validity:
    """A mesh looked at as a whole.

    Attributes:
        faults: What is wrong, in words; empty if nothing.
        parts: Parts whose elements are connected through faces; of a sheet those whose triangles
            are connected through edges, or by springs.
        volume: Of the rest shape [m^3]; of a sheet that of what its triangles stand for.
        ratio: Smallest radius ratio at rest; of a sheet 2 r / R of its triangles.
    """

    faults: tuple[str, ...]
    parts: int
    volume: float
    ratio: float


@njit(cache=True, nogil=True)
def _root(parent: NDArray[np.int64], k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@njit(cache=True, nogil=True)
def _unite(
    tets: NDArray[np.int64],
    first: NDArray[np.int64],
    second: NDArray[np.int64],
    corners: NDArray[np.int64],
) -> None:
    """Unite the corners of elements that share a face, at the nodes of that face."""
    for k in range(first.shape[0]):
        one, other = first[k], second[k]
        for i in range(4):
            for j in range(4):
                if tets[one, i] == tets[other, j]:
                    corners[_root(corners, 4 * one + i)] = _root(corners, 4 * other + j)


@njit(cache=True, nogil=True)
def _groups(parent: NDArray[np.int64]) -> int:
    number = 0
    for k in range(parent.shape[0]):
        number += parent[k] == k
    return number


def look_at(mesh: Mesh) -> Validity:
    """Find out whether a mesh is valid.

    Elements have a positive rest volume; a face is in one or two elements; nodes are alive if and
    only if an element has them; all elements at a node are connected through faces that contain it;
    the lists of what meets at each node say what the elements say; stitches join two nodes that are
    there; and a patch shares no node with the organ. Of a sheet the same holds of triangles and
    their edges, and springs join two nodes that are there, each pair once.
    """
    rows = mesh.element_rows
    living = np.flatnonzero(mesh.element_alive[:rows])
    items = mesh.tets[living].astype(np.int64)
    faults = _node_faults(mesh, items)
    if not _lists_agree(mesh, living, items):
        faults.append("lists of elements at nodes that do not say what the elements say")
    faults += _stitch_faults(mesh) + _patch_faults(mesh, living, items)
    if mesh.sheet_rows is not None:
        faults += sheet_faults(mesh)
        first, second, number = sheet_joints(mesh)
        return Validity(tuple(faults), count_parts(first, second, number), *sheet_quality(mesh))
    a, b, c, d = (mesh.rest[items[:, k]] for k in range(4))
    volumes = np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0
    if not (volumes > 0.0).all():
        faults.append(f"{int((~(volumes > 0.0)).sum())} elements without positive rest volume")
    faces = np.sort(items[:, _FACES].reshape(-1, 3), axis=1)
    keys = (faces[:, 0] * mesh.node_rows + faces[:, 1]) * mesh.node_rows + faces[:, 2]
    order = np.argsort(keys, kind="stable")
    same = keys[order][1:] == keys[order][:-1]
    if (same[1:] & same[:-1]).any():
        faults.append("faces in more than two elements")
    pairs = np.flatnonzero(same)
    first, second = order[pairs] // 4, order[pairs + 1] // 4
    corners = np.arange(4 * len(items))
    _unite(items, first, second, corners)
    if _groups(corners) != len(np.unique(items)):
        faults.append("elements at a node that are not connected through faces")
    ratio = float(radius_ratios(mesh.rest, items).min()) if len(items) else 0.0
    parts = count_parts(first, second, len(items))
    return Validity(tuple(faults), parts, float(volumes.sum()), ratio)


def _node_faults(mesh: Mesh, items: NDArray[np.int64]) -> list[str]:
    faults = []
    used = np.unique(items[items >= 0])
    if not np.array_equal(used, np.flatnonzero(mesh.node_alive)):
        faults.append("nodes without elements, or elements of nodes that are no more")
    if not np.isfinite(mesh.rest[used]).all():
        faults.append("rest positions that are not finite")
    return faults


def _patch_faults(mesh: Mesh, living: NDArray[np.int64], items: NDArray[np.int64]) -> list[str]:
    """Whether a patch has nodes of the organ or of another patch, or no name."""
    labels = mesh.patches.labels
    if not set(labels.tolist()) <= set(mesh.region_names):
        return ["a patch whose region has no name"]
    if not len(labels):
        return []
    region = mesh.regions[living]
    of = np.where(np.isin(region, labels), region, -1)
    there = items >= 0
    ends, whose = items[there], np.broadcast_to(of[:, None], items.shape)[there]
    low, high = np.full(mesh.node_rows, 1 << 30), np.full(mesh.node_rows, -2)
    np.minimum.at(low, ends, whose)
    np.maximum.at(high, ends, whose)
    used = np.unique(ends)
    if (low[used] != high[used]).any():
        return ["nodes of a patch and of the organ at once"]
    return []


def _stitch_faults(mesh: Mesh) -> list[str]:
    table = mesh.sutures
    ids, ends = table.ids.astype(np.int64), table.nodes
    faults = []
    if not mesh.node_alive[ends].all():
        faults.append("a stitch at a node that is no more")
    if (ends[:, 0] == ends[:, 1]).any():
        faults.append("a stitch with both ends at one node")
    if (np.diff(ids) <= 0).any() or (len(ids) and ids[-1] >= table.next_id):
        faults.append("ids of stitches that are not ascending, or will be given again")
    return faults


def lists_of(mesh: Mesh) -> NDArray[np.int32]:
    """Element rows at each node, one node after the other."""
    lists, rows = mesh.incident, mesh.node_rows
    count = lists.count[:rows].astype(np.int64)
    first = np.repeat(lists.start[:rows] - np.cumsum(count) + count, count)
    return np.asarray(lists.data[first + np.arange(int(count.sum()))])


def _lists_agree(mesh: Mesh, living: NDArray[np.int64], items: NDArray[np.int64]) -> bool:
    ends = items.ravel()
    rows = np.repeat(living, 4)[ends >= 0]
    ends = ends[ends >= 0]
    order = np.argsort(ends, kind="stable")
    count = np.bincount(ends, minlength=mesh.node_rows)
    if not np.array_equal(count, mesh.incident.count[: mesh.node_rows]):
        return False
    return bool(np.array_equal(lists_of(mesh), rows[order]))
