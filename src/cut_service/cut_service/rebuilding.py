"""A mesh as it would be with elements removed and others in their place, and the edit to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cut_service.neighbours import Links
from cut_service.ungluing import Ungluing
from cut_service.work import Work
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.incidence import Incidence


@dataclass(frozen=True)
class NewNodes:
    """Nodes with places of their own, within elements of the mesh before.

    Attributes:
        parents: Row of the node that each takes after, shape (n,).
        rest: Rest positions [m], shape (n, 3).
        positions: Current positions [m], shape (n, 3).
        anchors: Node rows of an element that contains each, shape (n, 4).
        weights: Barycentric weights in it, shape (n, 4).
    """

    parents: NDArray[np.int32]
    rest: NDArray[np.float64]
    positions: NDArray[np.float64]
    anchors: NDArray[np.int32]
    weights: NDArray[np.float64]

    @classmethod
    def none(cls) -> NewNodes:
        """No nodes."""
        rows, places = np.empty((0, 4), dtype=np.int32), np.empty((0, 3))
        return cls(rows[:, 0], places, places, rows, np.empty((0, 4)))


@dataclass(frozen=True)
class Rebuilt:
    """The mesh as it would be.

    New elements have the rows behind the mesh's own, and so do new nodes.

    Attributes:
        links: What meets where.
        alive: Elements that there are, shape (element_rows + added,).
        removed: Rows of elements taken out, shape (r,).
        added: Nodes of new elements, shape (a, 4).
        added_parents: Row of the element each descends from, shape (a,).
        new: New nodes.
    """

    links: Links
    alive: NDArray[np.bool_]
    removed: NDArray[np.int32]
    added: NDArray[np.int32]
    added_parents: NDArray[np.int32]
    new: NewNodes

    @classmethod
    def of(
        cls,
        work: Work,
        removed: NDArray[np.int32],
        added: NDArray[np.int32],
        added_parents: NDArray[np.int32],
        new: NewNodes,
    ) -> Rebuilt:
        """Exchange elements. The mesh itself is not changed."""
        rows = len(work.links.tets)
        tets = np.concatenate([work.links.tets, added])
        alive = np.concatenate([work.alive, np.ones(len(added), dtype=np.bool_)])
        alive[removed] = False
        lists = _copied(work.mesh.incident, work.mesh.node_rows + len(new.parents))
        nobody = np.full((len(removed), 4), -1, dtype=np.int32)
        not_yet = np.full((len(added), 4), -1, dtype=np.int32)
        items = np.concatenate([removed, np.arange(rows, rows + len(added), dtype=np.int32)])
        lists.rewire(
            items,
            np.concatenate([tets[removed], not_yet]),
            np.concatenate([nobody, added]),
        )
        links = Links(tets, lists.start, lists.count, lists.data)
        return cls(links, alive, removed, added, added_parents, new)


def _copied(lists: Incidence, node_rows: int) -> Incidence:
    copy = Incidence(0)
    copy.start, copy.count = lists.start.copy(), lists.count.copy()
    copy.room, copy.data = lists.room.copy(), lists.data.copy()
    copy.used = lists.used
    copy.grow(node_rows)
    return copy


def components_after(work: Work, rebuilt: Rebuilt, ungluing: Ungluing) -> int:
    """Number of parts of the organ once the nodes have been copied."""
    own = len(work.links.tets)
    rows = np.union1d(
        np.concatenate([rebuilt.removed, np.arange(own, len(rebuilt.links.tets))]),
        ungluing.elements,
    ).astype(np.int32)  # fmt: skip
    new = rebuilt.links.tets[rows]
    new[np.searchsorted(rows, ungluing.elements)] = ungluing.nodes
    new[~rebuilt.alive[rows]] = -1
    old = np.where((rows < own)[:, None], rebuilt.links.tets[rows], -1)
    return work.surroundings.parts_after(rows, old, new)


def edit_to(
    work: Work,
    rebuilt: Rebuilt,
    ungluing: Ungluing,
    kind: str,
    read_nodes: NDArray[np.int32],
    read_elements: NDArray[np.int32],
) -> TopologyEdit:
    """The edit that makes the mesh so; nodes are not snapped.

    Args:
        work: The plan's.
        rebuilt: Elements and nodes exchanged.
        ungluing: Nodes copied in what was rebuilt.
        kind: What made the edit.
        read_nodes: Rows of nodes the plan depends on.
        read_elements: Rows of elements it depends on.
    """
    mesh, new = work.mesh, rebuilt.new
    rows, elements = mesh.node_rows, mesh.element_rows
    own = ungluing.elements < elements
    added = rebuilt.added.copy()
    added[ungluing.elements[~own] - elements] = ungluing.nodes[~own]
    # Copies of new nodes stand where these do: the same place, the same parent.
    of_new = ungluing.parents - rows
    is_new = of_new >= 0
    places = np.concatenate([np.arange(len(new.parents)), of_new[is_new]])
    placed = np.concatenate(
        [np.arange(len(new.parents)), len(new.parents) + np.flatnonzero(is_new)]
    )
    parents = ungluing.parents.copy()
    parents[is_new] = new.parents[of_new[is_new]]
    return TopologyEdit(
        base_version=mesh.version,
        kind=kind,
        read_nodes=mesh.node_ids[read_nodes],
        read_elements=mesh.element_ids[read_elements],
        moved_nodes=(placed + PROVISIONAL).astype(np.uint32),
        moved_rest=new.rest[places],
        moved_anchors=mesh.node_ids[new.anchors[places]],
        moved_weights=new.weights[places],
        copied_nodes=_provisional(len(new.parents) + len(parents)),
        copy_parents=mesh.node_ids[np.concatenate([new.parents, parents])],
        rewritten_elements=mesh.element_ids[ungluing.elements[own]],
        rewritten_nodes=_ids(work, ungluing.nodes[own]),
        removed_elements=mesh.element_ids[rebuilt.removed],
        added_elements=_provisional(len(added)),
        added_nodes=_ids(work, added),
        added_parents=mesh.element_ids[rebuilt.added_parents],
    )


def _provisional(count: int) -> NDArray[np.uint32]:
    return (np.arange(count) + PROVISIONAL).astype(np.uint32)


def _ids(work: Work, nodes: NDArray[np.int32]) -> NDArray[np.uint32]:
    rows = work.mesh.node_rows
    old = nodes < rows
    ids = nodes.astype(np.int64) - rows + PROVISIONAL
    ids[old] = work.mesh.node_ids[nodes[old]]
    return ids.astype(np.uint32)
