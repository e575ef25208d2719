"""Which faces of the mesh a sweep cuts: the method of Nienhuys and van der Stappen.

Every edge that the sweep crosses gives up its end node closer to the sweep. Within one element the
node farthest from the sweep is never chosen, so at most three are, and three make a face of the cut
surface.

Why that separates: take a sweep that passes right through. In each element the nodes not chosen lie
on one side, or the edge between two of them would be crossed and one of them chosen; call that the
element's side. Let two elements of different sides share a face, and let its farthest node lie
above. Every node of the face is then chosen in the element
below: those below because the edge to the farthest is crossed, those above because a node not
    chosen there would be
below. So every face between the two sides is in the cut surface, whatever the mesh looks like.

References:
    H.-W. Nienhuys and A. F. van der Stappen, A surgery simulation supporting cuts and finite
    element deformation, MICCAI 2001, doi 10.1007/3-540-45468-3_18.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.neighbours import NOBODY, Links, across, corner_facing
from cut_service.sweep import Sweep
from cut_service.sweep_kernels import EDGES

TIE = 1e-5
"""Distances nearer to each other than this share of an edge tie; ties go to the lower id."""


@dataclass(frozen=True)
class Selection:
    """The cut surface as faces of elements.

    Attributes:
        crossed: Rows of elements with a crossed edge, shape (n,), ascending.
        faces: Element row and opposite corner of every face, one of its two sides, shape
            (face_count, 2).
        cut: For every element row the set of its faces in the cut surface, bit k for the face
            opposite corner k, shape (element_rows,).
    """

    crossed: NDArray[np.int32]
    faces: NDArray[np.int32]
    cut: NDArray[np.uint8]


@njit(cache=True, nogil=True)
def _choose(
    tets: NDArray[np.int32],
    crossed: NDArray[np.int32],
    masks: NDArray[np.uint8],
    distance: NDArray[np.int64],
    spared: NDArray[np.int32],
) -> None:
    """For each crossed element the corner left over when the other three are chosen, else `NOBODY`.

    Into `spared`.
    """
    for k in range(crossed.shape[0]):
        nodes = tets[crossed[k]]
        chosen = 0
        for edge in range(6):
            if masks[k] & (1 << edge):
                i, j = EDGES[edge, 0], EDGES[edge, 1]
                a, b = distance[nodes[i]], distance[nodes[j]]
                first = a < b or (a == b and nodes[i] < nodes[j])
                chosen |= 1 << (i if first else j)
        spared[k] = NOBODY
        for corner in range(4):
            if chosen == 15 - (1 << corner):
                spared[k] = corner


@njit(cache=True, nogil=True)
def _mark(
    links: Links,
    crossed: NDArray[np.int32],
    spared: NDArray[np.int32],
    cut: NDArray[np.uint8],
    faces: NDArray[np.int32],
) -> int:
    """Enter both sides of every chosen face that two elements share in `cut`, one side in `faces`.

    Their number.
    """
    found = 0
    for k in range(crossed.shape[0]):
        corner = spared[k]
        if corner == NOBODY or cut[crossed[k]] & (1 << corner):
            continue
        other = across(links, crossed[k], corner)
        if other == NOBODY:
            continue
        cut[crossed[k]] |= 1 << corner
        cut[other] |= 1 << corner_facing(links, other, crossed[k])
        faces[found, 0], faces[found, 1] = crossed[k], corner
        found += 1
    return found


def select(
    links: Links,
    positions: NDArray[np.float64],
    sweep: Sweep,
    crossed: NDArray[np.int32],
    masks: NDArray[np.uint8],
) -> Selection:
    """Select the faces to cut, in the configuration given.

    Args:
        links: The mesh.
        positions: Node positions [m], shape (node_rows, 3).
        sweep: What the cut follows.
        crossed: Rows of the elements with an edge that it crosses, ascending, shape (n,).
        masks: Those edges, bits in the order of `EDGES`, shape (n,).
    """
    cut = np.zeros(len(links.tets), dtype=np.uint8)
    faces = np.empty((len(crossed), 2), dtype=np.int32)
    if len(crossed):
        distance = _ranked_distance(links.tets[crossed], positions, sweep)
        spared = np.empty(len(crossed), dtype=np.int32)
        _choose(links.tets, crossed, masks, distance, spared)
        faces = faces[: _mark(links, crossed, spared, cut, faces)]
    return Selection(crossed, faces, cut)


def _ranked_distance(
    tets: NDArray[np.int32], positions: NDArray[np.float64], sweep: Sweep
) -> NDArray[np.int64]:
    # Whole multiples of a small length: rounding noise then leaves ties equal, and the order stays
    # a total one.
    nodes = np.unique(tets)
    edge = np.linalg.norm(positions[tets[:, 1]] - positions[tets[:, 0]], axis=1).mean()
    ranks = np.zeros(len(positions), dtype=np.int64)
    ranks[nodes] = np.rint(sweep.distance(positions[nodes]) / (TIE * edge))
    return ranks
