"""Cutting along faces of the mesh: no element is removed or added, nodes are copied and snapped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cut_service.degeneracy import Made, Relief, relieve
from cut_service.pieces import GOES_ON, glue_crumbs
from cut_service.selection import Selection, select
from cut_service.snapping import Snapping, snap
from cut_service.ungluing import Ungluing, unglue
from cut_service.work import Plan, Report, Work, distance_of, face_nodes, too_shallow
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.incidence import sorted_unique

SNAPPING = 0.6
"""Share of the volume budget that snapping may use; the rest is for taking some of it back."""


def split(work: Work) -> Plan:
    """Plan to split the mesh along the faces near the sweep.

    Raises:
        CutError: The sweep splits nothing.
    """
    around = work.surroundings
    selection = select(work.links, work.positions, work.sweep, around.crossed, around.masks)
    selection, glued = _without_crumbs(work, selection)
    ungluing = unglue(work.links, selection.cut, selection.faces, work.mesh.node_rows)
    if not len(ungluing.opened):
        raise too_shallow(len(selection.crossed))
    nodes = face_nodes(work.links, ungluing.opened)
    on_cut = sorted_unique(nodes.ravel())
    relief = _moved(work, on_cut)
    snapping = relief.snapping
    edit = _edit(work, selection, ungluing, snapping)
    moved = work.positions.copy()
    moved[snapping.nodes] = np.einsum(
        "ij,ijk->ik", snapping.weights, work.positions[snapping.anchors]
    )
    elements = ungluing.elements
    report = Report(
        faces_split=len(ungluing.opened),
        nodes_added=len(ungluing.parents),
        nodes_moved=len(snapping.nodes),
        components=around.parts_after(elements, work.links.tets[elements], ungluing.nodes),
        distance_before=distance_of(work.positions[nodes], work.sweep),
        distance_after=distance_of(moved[nodes], work.sweep),
        volume_change=relief.change,
        crumbs_glued=glued,
        degenerate=(relief.found, relief.left),
    )
    return Plan(edit, report, moved[nodes], _unfinished(work, selection, ungluing))


def _unfinished(work: Work, selection: Selection, ungluing: Ungluing) -> NDArray[np.uint32]:
    """Ids of the elements around chosen faces that stay whole, at the rim.

    Which of them chooses a face is another question after its nodes have been snapped.
    """
    chosen, opened = (4 * faces[:, 0] + faces[:, 1] for faces in (selection.faces, ungluing.opened))
    whole = selection.faces[~np.isin(chosen, opened)]
    nodes = sorted_unique(face_nodes(work.links, whole).ravel())
    return np.asarray(work.mesh.element_ids[work.mesh.incident.of_all(nodes)])


def _without_crumbs(work: Work, selection: Selection) -> tuple[Selection, int]:
    limit = work.settings.smallest_piece - 1
    faces, cut = selection.faces, selection.cut
    cut[work.surroundings.part.outer] |= GOES_ON
    glued = glue_crumbs(work.links, work.positions, faces, limit, cut) if limit > 0 else 0
    kept = (cut[faces[:, 0]] >> faces[:, 1]) & 1 > 0
    return Selection(selection.crossed, faces[kept], cut), int(glued)


def _moved(work: Work, nodes: NDArray[np.int32]) -> Relief:
    """Move the nodes of the cut onto the sweep, and mend what that made degenerate."""
    how, budget = work.settings, work.settings.volume_budget * work.volume
    movable = nodes[~work.still[nodes]] if how.snap else nodes[:0]
    snapping, change = snap(
        work.links, work.rest, work.positions, movable, work.sweep, how.quality_floor,
        float(np.cos(how.crease_angle)), SNAPPING * budget,
    )  # fmt: skip
    if not how.snap:
        return Relief(snapping, Made.none(), change)
    return relieve(work, work.links, nodes, snapping, change, budget)


def _edit(work: Work, selection: Selection, ungluing: Ungluing, snapping: Snapping) -> TopologyEdit:
    mesh, ids = work.mesh, work.mesh.node_ids
    copies = np.arange(len(ungluing.parents), dtype=np.uint32)
    is_copy = ungluing.nodes >= ungluing.first_copy
    rewritten = np.where(
        is_copy,
        (ungluing.nodes - ungluing.first_copy).astype(np.int64) + PROVISIONAL,
        ids[np.where(is_copy, 0, ungluing.nodes)],
    )
    read_nodes = np.union1d(face_nodes(work.links, selection.faces), snapping.nodes)
    return TopologyEdit(
        base_version=mesh.version,
        kind="split",
        read_nodes=ids[read_nodes],
        read_elements=mesh.element_ids[read_elements(work, selection.crossed, read_nodes)],
        moved_nodes=ids[snapping.nodes],
        moved_rest=snapping.rest,
        moved_anchors=ids[snapping.anchors],
        moved_weights=snapping.weights,
        copied_nodes=copies + np.uint32(PROVISIONAL),
        copy_parents=ids[ungluing.parents],
        rewritten_elements=mesh.element_ids[ungluing.elements],
        rewritten_nodes=rewritten.astype(np.uint32),
    )


def read_elements(
    work: Work, crossed: NDArray[np.int32], nodes: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Rows of the elements that are crossed or meet one of the nodes, ascending."""
    return np.union1d(crossed, work.mesh.incident.of_all(nodes))
