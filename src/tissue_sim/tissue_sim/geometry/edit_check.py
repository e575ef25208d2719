"""Whether an edit can be applied to a mesh, and what it would do to which rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import (
    NO_PARENT,
    PROVISIONAL,
    REDO,
    UNDO,
    EditError,
    StaleEditError,
    TopologyEdit,
    refuse_malformed,
)
from tissue_sim.geometry.incidence import among, sorted_unique
from tissue_sim.geometry.look_up import any_changed
from tissue_sim.geometry.patch_edit import Patching, patching_of, refuse_bad_patch
from tissue_sim.geometry.quality import count_flat
from tissue_sim.geometry.sheet_edit import (
    count_without_size,
    item_nodes,
    refuse_bad_items,
    refuse_bad_sheet,
)
from tissue_sim.geometry.suture_edit import Stitching, stitching_of

if TYPE_CHECKING:
    from tissue_sim.geometry.mesh import Mesh

NO_ROW = -1

Rows = NDArray[np.int32]


@dataclass(frozen=True)
class CheckedEdit:
    """An edit that a mesh can apply as long as it stays at `version`.

    Attributes:
        edit: The edit.
        version: Version of the mesh it was checked on.
        applied: The edit with permanent ids and the version it will make.
        moved_nodes, moved_anchors, copied_nodes, copy_parents, removed, added, added_parents,
            merged_nodes, merged_into, returned_nodes, returned_like, returned_elements, born_nodes:
            Rows of what the edit names; -1 among the parents for elements of a new patch.
        elements, old_elements, new_elements, neighbours, nodes: As in `EditChange`.
        stitching: What it does to the sutures.
        patching: What it does to the patches.
    """

    edit: TopologyEdit
    version: int
    applied: TopologyEdit
    moved_nodes: Rows
    moved_anchors: Rows
    copied_nodes: Rows
    copy_parents: Rows
    removed: Rows
    added: Rows
    added_parents: Rows
    elements: Rows
    old_elements: Rows
    new_elements: Rows
    neighbours: Rows
    nodes: Rows
    merged_nodes: Rows
    merged_into: Rows
    returned_nodes: Rows
    returned_like: Rows
    returned_elements: Rows
    stitching: Stitching
    born_nodes: Rows
    patching: Patching


def check_edit(mesh: Mesh, edit: TopologyEdit) -> CheckedEdit:
    """Check an edit; see `Mesh.check`."""
    refuse_malformed(edit)
    _refuse_stale(mesh, edit)
    again = edit.kind == REDO
    made = np.concatenate([edit.copied_nodes, edit.born_nodes])
    nodes = _Names(made, mesh.node_rows, mesh.node_alive, "node", again)
    copies, born = nodes.rows[: len(edit.copied_nodes)], nodes.rows[len(edit.copied_nodes) :]
    added = _Names(edit.added_elements, mesh.element_rows, mesh.element_alive, "element", again)
    back = _returning(edit.returned_nodes, mesh.node_rows, mesh.node_alive, "node")
    elements_back = _returning(
        edit.returned_elements, mesh.element_rows, mesh.element_alive, "element"
    )

    def living_rows(ids: NDArray[np.integer], *new: Rows) -> Rows:
        """Rows of nodes that live, are new or come back; -1 where there is none."""
        comes = np.zeros(np.shape(ids), dtype=np.bool_)
        for rows in new:
            if len(rows):
                comes |= among(ids, rows)
        found = np.where(comes, ids, mesh.node_rows_of(np.where(comes, 0, ids)))
        return found.astype(np.int32)

    def old_or_back(ids: NDArray[np.integer]) -> Rows:
        return living_rows(ids, back) if len(back) else mesh.node_rows_of(ids)

    def old_or_new(ids: NDArray[np.integer]) -> Rows:
        return living_rows(ids, nodes.rows, back)

    moved = _known(nodes.permanent(edit.moved_nodes), old_or_new, "moved node")
    anchors = _known(edit.moved_anchors, old_or_back, "anchor node")
    parents = _known(edit.copy_parents, mesh.node_rows_of, "parent node")
    rewritten = _known(edit.rewritten_elements, mesh.element_rows_of, "rewritten element")
    removed = _known(edit.removed_elements, mesh.element_rows_of, "removed element")
    born_of = _parents(mesh, edit.added_parents)
    merged = _known(edit.merged_nodes, mesh.node_rows_of, "merged node")
    into = _known(edit.merged_into, old_or_back, "node to merge into")
    like = _known(edit.returned_like, old_or_back, "node to be displaced like")

    def nodes_of(ids: NDArray[np.integer]) -> Rows:
        return _known(nodes.permanent(ids), old_or_new, "node")

    rewritten_to = _corners(mesh, edit.rewritten_nodes, nodes_of)
    added_to = _corners(mesh, edit.added_nodes, nodes_of)
    back_to = _corners(mesh, mesh.tets[elements_back], lambda ids: _known(ids, old_or_back, "node"))
    refuse_bad_patch(edit, born, added_to)
    if among(moved, born).any():
        raise EditError("a node without parent is moved by the edit that makes it")
    # A new node with a place of its own belongs to no element yet, and may be fixed.
    shifted = moved[~among(moved, nodes.rows)]
    _refuse_fixed(mesh, shifted)
    elements = np.concatenate([rewritten, removed, added.rows, elements_back]).astype(np.int32)
    if len(sorted_unique(elements)) != len(elements):
        raise EditError("an element is rewritten or removed twice in one edit")
    old = np.concatenate(
        [mesh.tets[rewritten], mesh.tets[removed], _nobody(added.rows), _nobody(elements_back)]
    )
    new = np.concatenate([rewritten_to, _nobody(removed), added_to, back_to])
    named = new[new[:, 0] != NO_ROW]
    _refuse_loose(np.concatenate([nodes.rows, back]), named)
    if mesh.sheet_rows is not None:
        refuse_bad_items(mesh, (rewritten, rewritten_to), (born_of, added_to), removed, copies)
        refuse_bad_sheet(edit, added_to[born_of == NO_ROW])
    elif len(edit.born_kinds):
        raise EditError("born_kinds is for sheets, and the tissue is made of tetrahedra")
    _refuse_half_merged(mesh, merged, into, elements, named)
    neighbours = mesh.incident.of_all(np.concatenate([shifted, into]))
    around = mesh.tets[neighbours[~among(neighbours, elements)]]
    places = (np.concatenate([moved, born]), np.concatenate([edit.moved_rest, edit.born_rest]))
    _refuse_flat(mesh, *places, copies, parents, np.concatenate([around, named]))
    patching = patching_of(mesh, edit, again)
    stitching = stitching_of(mesh.sutures, edit, again or edit.kind == UNDO, nodes_of)
    touched = np.concatenate(
        [old.ravel(), new.ravel(), around.ravel(), moved, stitching.nodes.ravel()]
    )
    applied = replace(
        edit,
        version=mesh.version + 1,
        moved_nodes=moved.astype(np.uint32),
        copied_nodes=copies.astype(np.uint32),
        born_nodes=born.astype(np.uint32),
        rewritten_nodes=rewritten_to.astype(np.uint32),
        added_elements=added.rows.astype(np.uint32),
        added_nodes=added_to.astype(np.uint32),
        added_sutures=stitching.added.ids,
        suture_nodes=stitching.added.nodes.astype(np.uint32),
        suture_groups=stitching.added.groups,
        added_patches=() if patching.added is None else (patching.added,),
    )
    return CheckedEdit(
        edit, mesh.version, applied, moved, anchors, copies, parents, removed, added.rows,
        born_of, elements, old, new, neighbours, sorted_unique(touched[touched != NO_ROW]),
        merged, into, back, like, elements_back, stitching, born, patching,
    )  # fmt: skip


def _parents(mesh: Mesh, ids: NDArray[np.uint32]) -> Rows:
    """Rows of the elements that new ones descend from; -1 for those of a new patch."""
    rows = np.full(len(ids), NO_ROW, dtype=np.int32)
    descends = np.asarray(ids) != NO_PARENT
    rows[descends] = _known(ids[descends], mesh.element_rows_of, "parent element")
    return rows


def _corners(
    mesh: Mesh, ids: NDArray[np.integer], known: Callable[[NDArray[np.integer]], Rows]
) -> Rows:
    """Node rows of elements; triangles and springs have none in some places."""
    if mesh.sheet_rows is None:
        return known(ids)
    return item_nodes(ids.astype(np.uint32), known)


def _nobody(elements: Rows) -> Rows:
    """Nodes of elements that are not there."""
    return np.full((len(elements), 4), NO_ROW, dtype=np.int32)


def _returning(ids: NDArray[np.uint32], rows: int, alive: NDArray[np.bool_], what: str) -> Rows:
    """Rows of what comes back: each was there once, and is not there now."""
    wide = np.asarray(ids, dtype=np.int64)
    there = wide < rows
    there[there] = ~alive[wide[there]]
    if not there.all():
        bad = wide[~there][:5].tolist()
        raise EditError(f"the edit brings back a {what} that has not vanished: id {bad}")
    found = wide.astype(np.int32)
    if len(sorted_unique(found)) != len(found):
        raise EditError(f"the edit brings back a {what} twice")
    return found


class _Names:
    """Permanent rows for ids of new things, provisional in a plan, permanent in a replica."""

    def __init__(
        self,
        ids: NDArray[np.uint32],
        first: int,
        alive: NDArray[np.bool_],
        what: str,
        again: bool,
    ) -> None:
        self.first = first
        if again:
            # A redo names what it makes by the ids that the edit gave it.
            self.rows = _returning(ids, first, alive, what)
            return
        offset = np.asarray(ids, dtype=np.int64)
        provisional = bool(len(offset)) and int(offset[0]) >= PROVISIONAL
        expected = np.arange(len(offset)) + (PROVISIONAL if provisional else first)
        if not np.array_equal(offset, expected):
            raise EditError(
                f"new {what} ids must count up from {PROVISIONAL} in a plan, "
                f"or from {first}, the next free row, in an applied edit"
            )
        self.rows = np.arange(first, first + len(offset), dtype=np.int32)

    def permanent(self, ids: NDArray[np.integer]) -> NDArray[np.int64]:
        wide = np.asarray(ids, dtype=np.int64)
        return np.where(wide >= PROVISIONAL, wide - PROVISIONAL + self.first, wide)


def _known(ids: NDArray[np.integer], rows_of: Callable[..., Rows], what: str) -> Rows:
    rows = rows_of(ids)
    if (rows == NO_ROW).any():
        missing = np.unique(np.asarray(ids)[rows == NO_ROW])[:5]
        raise EditError(f"the edit names a {what} that is not there: id {missing.tolist()}")
    return rows


def _refuse_stale(mesh: Mesh, edit: TopologyEdit) -> None:
    if not 0 < edit.base_version <= mesh.version:
        raise StaleEditError(
            f"planned on version {edit.base_version}; the tissue is at {mesh.version}"
        )
    for ids, rows_of, versions, what in (
        (edit.read_nodes, mesh.node_rows_of, mesh.node_versions, "node"),
        (edit.read_elements, mesh.element_rows_of, mesh.element_versions, "element"),
    ):
        rows = rows_of(ids)
        if not any_changed(rows, versions, edit.base_version):
            continue
        changed = (rows == NO_ROW) | (versions[rows] > edit.base_version)
        raise StaleEditError(
            f"{int(changed.sum())} {what}s that the plan has read, {what} "
            f"{int(ids[changed][0])} among them, changed after version {edit.base_version}"
        )


def _refuse_fixed(mesh: Mesh, moved: Rows) -> None:
    if mesh.fixed[moved].any():
        ids = mesh.node_ids[moved[mesh.fixed[moved]]][:5]
        raise EditError(f"fixed nodes cannot be moved: id {ids.tolist()}")


def _refuse_loose(new: Rows, named: Rows) -> None:
    """Refuse new nodes that no element has."""
    loose = ~among(new, named.ravel())
    if loose.any():
        raise EditError(f"{int(loose.sum())} new nodes would belong to no element")


def _refuse_half_merged(mesh: Mesh, merged: Rows, into: Rows, elements: Rows, named: Rows) -> None:
    """Refuse nodes that vanish into others and are still there, or that vanish twice."""
    if not len(merged):
        return
    if len(sorted_unique(merged)) != len(merged) or among(into, merged).any():
        raise EditError("a node vanishes into two others, or into one that vanishes")
    kept = ~among(mesh.incident.of_all(merged), elements)
    if kept.any() or among(merged, named.ravel()).any():
        raise EditError("a node that vanishes into another would still belong to an element")
    if not np.array_equal(mesh.rest[merged], mesh.rest[into]):
        raise EditError("a node would vanish into one that lies elsewhere at rest")


def _refuse_flat(
    mesh: Mesh,
    moved: Rows,
    moved_rest: NDArray[np.float64],
    copies: Rows,
    parents: Rows,
    tets: Rows,
) -> None:
    """Refuse elements without volume, the nodes being where the edit puts them.

    `moved` are those without parent as well.
    """
    place_of = np.full(mesh.node_rows + len(copies) + len(moved), NO_ROW, dtype=np.int32)
    place_of[moved] = np.arange(len(moved))
    place_of[copies] = np.arange(len(moved), len(moved) + len(copies))
    places = np.concatenate([moved_rest, mesh.rest[parents]])
    of_parent = place_of[parents]
    was_moved = of_parent != NO_ROW
    places[len(moved) :][was_moved] = moved_rest[of_parent[was_moved]]
    place_of[moved] = np.arange(len(moved))
    if mesh.sheet_rows is not None:
        if flat := count_without_size(mesh.rest, place_of, places, tets):
            raise EditError(f"{flat} triangles or springs would have no size at rest")
        return
    flat = count_flat(mesh.rest, place_of, places, tets)
    if flat:
        raise EditError(f"{flat} elements would have no positive rest volume")
