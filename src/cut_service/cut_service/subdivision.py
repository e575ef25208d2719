"""Cutting along the sweep itself: the elements that it crosses are divided there.

1. Where the sweep passes an edge of an element that it passes right through, there is a new node.
   One that would lie close to an end of the edge is not made: the end lies on the cut instead.
2. The elements at the edges with new nodes are divided so that neighbours agree (`bisection`).
   Elements in which the sweep ends are divided only as far as their neighbours need it and are not
   cut: they are the rim.
3. Faces between the two sides are the cut surface; along it nodes are copied, as for a split.
4. Old nodes that lie on the cut move onto the sweep as far as the quality of the elements and the
   rest volume allow.

Shares of edges are the same at rest and deformed: a new node's rest position lies on the same edge,
and every child has the same share of its parent's volume in both.

Limitations: the surface within an element is flat between its crossed edges, so a sweep that bends
within an element is cut off there. Two sheets of one sweep that cross each other stay joined along
the line where they do, by one element.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cut_service.bisection import Division, divide, part
from cut_service.crossings import Crossings, find_crossings
from cut_service.degeneracy import Made, Relief, relieve
from cut_service.errors import CutCode, CutError
from cut_service.neighbours import Links
from cut_service.pieces import GOES_ON, glue_crumbs
from cut_service.rebuilding import NewNodes, Rebuilt, components_after, edit_to
from cut_service.snapping import Snapping, snap
from cut_service.splitting import read_elements
from cut_service.ungluing import unglue
from cut_service.work import Plan, Report, Work, distance_of, face_nodes, too_shallow
from tissue_sim.geometry.incidence import sorted_unique

VOLUME_KEPT = 1e-10
"""Rest volume may change by this share of the organ's."""


@dataclass(frozen=True)
class _Places:
    """Where the sweep passes through the mesh.

    Attributes:
        edges: Node rows of edges with a new node, in the order in which they are bisected, shape
            (e, 2).
        shares: Weight of each edge's second end, shape (e,).
        on: Old nodes that lie on the cut, shape (node_rows,).
    """

    edges: NDArray[np.int32]
    shares: NDArray[np.float64]
    on: NDArray[np.bool_]


def subdivide(work: Work) -> Plan:
    """Plan to divide the elements that the sweep passes.

    Raises:
        CutError: The sweep parts nothing.
    """
    around = work.surroundings
    crossings = find_crossings(work.links, work.positions, work.sweep, around.crossed, around.masks)
    places = _places(work, crossings)
    division = divide(work.links, places.edges, crossings.masks, places.on, work.mesh.node_rows)
    new = _new_nodes(work, places, division)
    rebuilt = Rebuilt.of(work, division.parents, division.children, division.parent_of, new)
    cut, faces, read = _surface(work, rebuilt.links, crossings, places, division)
    cut[np.flatnonzero(around.part.outer)] |= GOES_ON
    positions = np.concatenate([work.positions, new.positions])
    limit = work.settings.smallest_piece - 1
    glued = glue_crumbs(rebuilt.links, positions, faces, limit, cut) if limit > 0 else 0
    faces = faces[(cut[faces[:, 0]] >> faces[:, 1]) & 1 > 0]
    if not len(faces):
        raise too_shallow(len(crossings.elements))
    ungluing = unglue(rebuilt.links, cut, faces, len(positions))
    if not len(ungluing.opened):
        raise too_shallow(len(crossings.elements))
    nodes = face_nodes(rebuilt.links, ungluing.opened)
    relief = _moved(work, rebuilt.links, nodes, Made(
        division.holders, places.edges, new.weights, new.rest, new.positions
    ))  # fmt: skip
    rebuilt = replace(rebuilt, new=_put(work, new, relief.made))
    snapping = relief.snapping
    _refuse_flat(rebuilt, np.concatenate([work.rest, rebuilt.new.rest]), snapping)
    read = np.union1d(np.union1d(np.unique(places.edges), read), snapping.nodes)
    edit = edit_to(
        work, rebuilt, ungluing, "subdivide", read,
        read_elements(work, np.union1d(crossings.elements, division.parents), read),
    )  # fmt: skip
    moved = np.concatenate([work.positions, rebuilt.new.positions])
    moved[snapping.nodes] = np.einsum(
        "ij,ijk->ik", snapping.weights, work.positions[snapping.anchors]
    )
    ids = work.mesh.node_ids
    edit = replace(
        edit,
        moved_nodes=np.concatenate([ids[snapping.nodes], edit.moved_nodes]),
        moved_rest=np.concatenate([snapping.rest, edit.moved_rest]),
        moved_anchors=np.concatenate([ids[snapping.anchors], edit.moved_anchors]),
        moved_weights=np.concatenate([snapping.weights, edit.moved_weights]),
    )
    report = Report(
        faces_split=len(ungluing.opened),
        nodes_added=len(edit.copied_nodes),
        nodes_moved=len(snapping.nodes),
        components=components_after(work, rebuilt, ungluing),
        distance_before=distance_of(positions[nodes], work.sweep),
        distance_after=distance_of(moved[nodes], work.sweep),
        volume_change=relief.change,
        crumbs_glued=int(glued),
        degenerate=(relief.found, relief.left),
        method="subdivide",
        elements_removed=len(rebuilt.removed),
        elements_added=len(rebuilt.added),
    )
    return Plan(edit, report, moved[nodes])


def _places(work: Work, crossings: Crossings) -> _Places:
    """Decide which passages become new nodes and which old nodes stand for them."""
    edges, shares = crossings.edges[crossings.active], crossings.shares[crossings.active]
    rest = np.linalg.norm(work.rest[edges[:, 1]] - work.rest[edges[:, 0]], axis=1)
    seen = np.linalg.norm(work.positions[edges[:, 1]] - work.positions[edges[:, 0]], axis=1)
    shorter = np.maximum(np.minimum(rest, seen), np.finfo(np.float64).tiny)
    near = np.maximum(
        work.settings.vertex_share, work.settings.vertex_reach * work.mean_edge / shorter
    )
    close = np.minimum(shares, 1.0 - shares) <= near
    on = np.zeros(work.mesh.node_rows, dtype=np.bool_)
    on[np.where(shares < 0.5, edges[:, 0], edges[:, 1])[close]] = True
    free = ~(on[edges[:, 0]] | on[edges[:, 1]])
    edges, shares = edges[free], shares[free]
    # The longest first: halving long edges leaves the better elements. Edges are in order already,
    # so that equal ones stay in the order of their nodes.
    order = np.argsort(-rest[free], kind="stable")
    return _Places(np.ascontiguousarray(edges[order]), shares[order], on)


def _new_nodes(work: Work, places: _Places, division: Division) -> NewNodes:
    first, second = places.edges[:, 0], places.edges[:, 1]
    anchors = work.links.tets[division.holders]
    share = places.shares[:, None]
    weights = np.where(anchors == first[:, None], 1.0 - share, 0.0)
    weights += np.where(anchors == second[:, None], share, 0.0)
    # Between a fixed node and a free one a new node is free.
    fixed = work.mesh.fixed
    take_second = fixed[first] & ~fixed[second]
    nearer = (places.shares >= 0.5) & (fixed[first] == fixed[second])
    return NewNodes(
        np.where(take_second | nearer, second, first).astype(np.int32),
        (1.0 - share) * work.rest[first] + share * work.rest[second],
        (1.0 - share) * work.positions[first] + share * work.positions[second],
        anchors,
        weights,
    )


def _surface(
    work: Work, after: Links, crossings: Crossings, places: _Places, division: Division
) -> tuple[NDArray[np.uint8], NDArray[np.int32], NDArray[np.int32]]:
    """The cut surface as bits and as faces, and the old nodes on it."""
    nodes = np.flatnonzero(places.on).astype(np.int32)
    around = work.mesh.incident.of_all(nodes)
    near = around[places.on[work.links.tets[around]].sum(axis=1) >= 3]
    distance = np.zeros(work.mesh.node_rows)
    distance[nodes] = work.sweep.distance(work.positions[nodes])
    cut, faces = part(
        work.links, after, division, near, crossings.masks, places.on, distance
    )  # fmt: skip
    return cut, faces, nodes


def _moved(work: Work, links: Links, faces: NDArray[np.int32], made: Made) -> Relief:
    """Move old nodes of the cut onto the sweep, and mend what is degenerate beside it."""
    how, budget = work.settings, VOLUME_KEPT * work.volume
    nodes = sorted_unique(faces.ravel())
    old = nodes[nodes < work.mesh.node_rows]
    movable = old[~work.still[old]] if how.snap else old[:0]
    snapping, change = snap(
        work.links, work.rest, work.positions, movable, work.sweep, how.quality_floor,
        float(np.cos(how.crease_angle)), budget,
    )  # fmt: skip
    if not how.snap:
        return Relief(snapping, made, change)
    return relieve(work, links, nodes, snapping, change, budget, made)


def _put(work: Work, new: NewNodes, made: Made) -> NewNodes:
    """New nodes where they are after degeneracies have been removed."""
    anchors = work.links.tets[made.holders]
    return NewNodes(new.parents, made.rest, made.positions, anchors, made.weights)


def _refuse_flat(rebuilt: Rebuilt, rest: NDArray[np.float64], snapping: Snapping) -> None:
    rest[snapping.nodes] = snapping.rest
    a, b, c, d = (rest[rebuilt.added[:, k]] for k in range(4))
    volumes = np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a))
    if (volumes <= 0.0).any():
        raise CutError(
            CutCode.REFUSED,
            f"{int((volumes <= 0.0).sum())} elements would be too small for their volume to be "
            "told from nothing; cut elsewhere, or by another method",
        )
