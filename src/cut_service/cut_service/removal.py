"""Cutting by taking out the elements that the sweep crosses.

What is left is as good as it was, but the cut is jagged and as wide as an element, and its volume
is lost. Parts of a few elements that would come loose go too.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.errors import CutCode, CutError
from cut_service.neighbours import NOBODY, Links, across
from cut_service.pieces import GOES_ON, piece_of
from cut_service.quality import total_volume
from cut_service.rebuilding import NewNodes, Rebuilt, components_after, edit_to
from cut_service.ungluing import Ungluing, unglue_at
from cut_service.work import Plan, Report, Work, distance_of, face_nodes
from tissue_sim.geometry.edit import TopologyEdit


@njit(cache=True, nogil=True)
def _small_pieces(
    links: Links,
    seeds: NDArray[np.int32],
    limit: int,
    cut: NDArray[np.uint8],
    alive: NDArray[np.bool_],
    out: NDArray[np.int32],
) -> int:
    """Take pieces of at most `limit` elements out of `alive`, into `out`; their number."""
    found = np.empty(limit + 1, dtype=np.int32)
    number = 0
    for seed in seeds:
        if not alive[seed]:
            continue
        size = piece_of(links, cut, seed, limit, found)
        if size <= limit:
            for k in range(size):
                alive[found[k]] = False
                out[number] = found[k]
                number += 1
    return number


@njit(cache=True, nogil=True)
def _bare(
    links: Links,
    removed: NDArray[np.int32],
    alive: NDArray[np.bool_],
    faces: NDArray[np.int32],
) -> int:
    """Faces of removed elements to those that stay; their number."""
    number = 0
    for row in removed:
        for corner in range(4):
            other = across(links, row, corner)
            if other != NOBODY and alive[other]:
                faces[number, 0], faces[number, 1] = row, corner
                number += 1
    return number


def remove(work: Work) -> Plan:
    """Plan to remove the elements that the sweep crosses.

    Raises:
        CutError: The sweep crosses everything.
    """
    crossed = work.surroundings.crossed
    removed, rebuilt, ungluing, edit = take_out(work, crossed, "remove")
    faces = np.empty((4 * len(removed), 2), dtype=np.int32)
    faces = faces[: _bare(work.links, removed, rebuilt.alive, faces)]
    corners = work.positions[face_nodes(work.links, faces)]
    distance = distance_of(corners, work.sweep)
    lost = np.zeros(len(work.alive), dtype=np.bool_)
    lost[removed] = True
    report = Report(
        faces_split=len(faces),
        nodes_added=len(edit.copied_nodes),
        nodes_moved=0,
        components=components_after(work, rebuilt, ungluing),
        distance_before=distance,
        distance_after=distance,
        volume_change=-total_volume(work.rest, work.links.tets, lost),
        crumbs_glued=0,
        method="remove",
        elements_removed=len(removed),
    )
    return Plan(edit, report, corners)


def take_out(
    work: Work, elements: NDArray[np.int32], kind: str
) -> tuple[NDArray[np.int32], Rebuilt, Ungluing, TopologyEdit]:
    """Plan to remove elements, and the small pieces that would come loose without them.

    Args:
        work: The plan's.
        elements: Rows of the elements, ascending, shape (n,).
        kind: What makes the edit.

    Returns:
        Rows of all that go; the mesh without them; the nodes copied where what stays hangs together
        by a node or an edge only; the edit.

    Raises:
        CutError: Nothing would be left.
    """
    removed = _with_crumbs(work, elements)
    rebuilt = _without(work, removed)
    if not rebuilt.alive.any() and (work.around is None or work.around.is_all):
        raise CutError(
            CutCode.REFUSED,
            f"all {len(removed)} elements would go; removing them would leave no tissue",
        )
    nodes = np.unique(work.links.tets[removed])
    none = np.zeros(len(rebuilt.links.tets), dtype=np.uint8)
    ungluing = unglue_at(rebuilt.links, none, nodes, work.mesh.node_rows)
    read = work.mesh.incident.of_all(nodes)
    return removed, rebuilt, ungluing, edit_to(work, rebuilt, ungluing, kind, nodes, read)


def _without(work: Work, removed: NDArray[np.int32]) -> Rebuilt:
    none = np.empty((0, 4), dtype=np.int32)
    return Rebuilt.of(work, removed, none, none[:, 0], NewNodes.none())


def _with_crumbs(work: Work, crossed: NDArray[np.int32]) -> NDArray[np.int32]:
    """The elements to remove, and the small pieces that would come loose without them."""
    limit = work.settings.smallest_piece - 1
    if limit < 1:
        return crossed
    rest = _without(work, crossed)
    around = work.mesh.incident.of_all(np.unique(work.links.tets[crossed]))
    out = np.empty(len(around) * limit, dtype=np.int32)
    cut = np.zeros(len(rest.links.tets), dtype=np.uint8)
    if work.around is not None:
        cut[np.flatnonzero(work.around.part.outer)] = GOES_ON
    number = _small_pieces(rest.links, around, limit, cut, rest.alive, out)
    return np.union1d(crossed, out[:number]).astype(np.int32)
