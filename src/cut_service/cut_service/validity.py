"""What a mesh of tetrahedra must be after every edit, found out without the code that edits it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import radius_ratios

_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


@dataclass(frozen=True)
class Validity:
    """A mesh looked at as a whole.

    Attributes:
        faults: What is wrong, in words; empty if nothing.
        parts: Parts whose elements are connected through faces.
        volume: Of the rest shape [m^3].
        ratio: Smallest radius ratio at rest.
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
    elements: NDArray[np.int64],
) -> None:
    """Unite elements that share a face, and their corners at the nodes of that face."""
    for k in range(first.shape[0]):
        one, other = first[k], second[k]
        elements[_root(elements, one)] = _root(elements, other)
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
    and the lists of what meets at each node say what the elements say.
    """
    rows = mesh.element_rows
    living = np.flatnonzero(mesh.element_alive[:rows])
    tets = mesh.tets[living].astype(np.int64)
    a, b, c, d = (mesh.rest[tets[:, k]] for k in range(4))
    volumes = np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0
    used = np.unique(tets)
    faults = []
    if not (volumes > 0.0).all():
        faults.append(f"{int((~(volumes > 0.0)).sum())} elements without positive rest volume")
    if not np.array_equal(used, np.flatnonzero(mesh.node_alive)):
        faults.append("nodes without elements, or elements of nodes that are no more")
    if not np.isfinite(mesh.rest[used]).all():
        faults.append("rest positions that are not finite")
    faces = np.sort(tets[:, _FACES].reshape(-1, 3), axis=1)
    keys = (faces[:, 0] * mesh.node_rows + faces[:, 1]) * mesh.node_rows + faces[:, 2]
    order = np.argsort(keys, kind="stable")
    same = keys[order][1:] == keys[order][:-1]
    if (same[1:] & same[:-1]).any():
        faults.append("faces in more than two elements")
    pairs = np.flatnonzero(same)
    corners, elements = np.arange(4 * len(tets)), np.arange(len(tets))
    _unite(tets, order[pairs] // 4, order[pairs + 1] // 4, corners, elements)
    if _groups(corners) != len(used):
        faults.append("elements at a node that are not connected through faces")
    if not _lists_agree(mesh, living, tets):
        faults.append("lists of elements at nodes that do not say what the elements say")
    ratio = float(radius_ratios(mesh.rest, tets).min()) if len(tets) else 0.0
    return Validity(tuple(faults), _groups(elements), float(volumes.sum()), ratio)


def lists_of(mesh: Mesh) -> NDArray[np.int32]:
    """Element rows at each node, one node after the other."""
    lists, rows = mesh.incident, mesh.node_rows
    count = lists.count[:rows].astype(np.int64)
    first = np.repeat(lists.start[:rows] - np.cumsum(count) + count, count)
    return np.asarray(lists.data[first + np.arange(int(count.sum()))])


def _lists_agree(mesh: Mesh, living: NDArray[np.int64], tets: NDArray[np.int64]) -> bool:
    order = np.argsort(tets.ravel(), kind="stable")
    count = np.bincount(tets.ravel(), minlength=mesh.node_rows)
    if not np.array_equal(count, mesh.incident.count[: mesh.node_rows]):
        return False
    return bool(np.array_equal(lists_of(mesh), living[order // 4]))
