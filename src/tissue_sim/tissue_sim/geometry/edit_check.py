"""Whether an edit can be applied to a mesh, and what it would do to which rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import (
    PROVISIONAL,
    EditError,
    StaleEditError,
    TopologyEdit,
    refuse_malformed,
)
from tissue_sim.geometry.incidence import among, sorted_unique
from tissue_sim.geometry.look_up import any_changed
from tissue_sim.geometry.quality import count_flat

if TYPE_CHECKING:
    from tissue_sim.geometry.mesh import Mesh

NO_ROW = -1

SHEETS_STAY_WHOLE = (
    "tissue made of surfaces cannot be cut; allowed: geometry_kind volume, which is of tetrahedra"
)
Rows = NDArray[np.int32]


@dataclass(frozen=True)
class CheckedEdit:
    """An edit that a mesh can apply as long as it stays at `version`.

    Attributes:
        edit: The edit.
        version: Version of the mesh it was checked on.
        applied: The edit with permanent ids and the version it will make.
        moved_nodes, moved_anchors, copied_nodes, copy_parents, removed, added, added_parents: Rows
            of what the edit names.
        elements, old_elements, new_elements, neighbours, nodes: As in `EditChange`.
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


def check_edit(mesh: Mesh, edit: TopologyEdit) -> CheckedEdit:
    """Check an edit; see `Mesh.check`."""
    refuse_malformed(edit)
    if mesh.sheet is not None:
        raise EditError(SHEETS_STAY_WHOLE)
    _refuse_stale(mesh, edit)
    nodes = _Names(edit.copied_nodes, mesh.node_rows, "node")
    added = _Names(edit.added_elements, mesh.element_rows, "element")
    anchors = _known(edit.moved_anchors, mesh.node_rows_of, "anchor node")
    parents = _known(edit.copy_parents, mesh.node_rows_of, "parent node")
    rewritten = _known(edit.rewritten_elements, mesh.element_rows_of, "rewritten element")
    removed = _known(edit.removed_elements, mesh.element_rows_of, "removed element")
    born_of = _known(edit.added_parents, mesh.element_rows_of, "parent element")

    def old_or_new(ids: NDArray[np.int64]) -> Rows:
        is_new = (ids >= nodes.first) & (ids < nodes.first + len(nodes.rows))
        found = np.where(is_new, ids, mesh.node_rows_of(np.where(is_new, 0, ids)))
        return found.astype(np.int32)

    moved = _known(nodes.permanent(edit.moved_nodes), old_or_new, "moved node")
    placed = moved >= nodes.first
    rewritten_to = _known(nodes.permanent(edit.rewritten_nodes), old_or_new, "node")
    added_to = _known(nodes.permanent(edit.added_nodes), old_or_new, "node")
    _refuse_fixed(mesh, moved[~placed])
    _refuse_loose_copies(nodes.rows, rewritten_to, added_to)
    elements = np.concatenate([rewritten, removed, added.rows]).astype(np.int32)
    if len(sorted_unique(elements)) != len(elements):
        raise EditError("an element is rewritten or removed twice in one edit")
    gone = np.full((len(removed), 4), NO_ROW, dtype=np.int32)
    not_yet = np.full((len(added.rows), 4), NO_ROW, dtype=np.int32)
    old = np.concatenate([mesh.tets[rewritten], mesh.tets[removed], not_yet])
    new = np.concatenate([rewritten_to, gone, added_to])
    neighbours = mesh.incident.of_all(moved[~placed])
    around = mesh.tets[neighbours[~among(neighbours, elements)]]
    remaining = np.concatenate([around, new[new[:, 0] != NO_ROW]])
    _refuse_flat(mesh, moved, edit.moved_rest, nodes.rows, parents, remaining)
    touched = np.concatenate([old.ravel(), new.ravel(), around.ravel(), moved])
    applied = replace(
        edit,
        version=mesh.version + 1,
        moved_nodes=moved.astype(np.uint32),
        copied_nodes=nodes.rows.astype(np.uint32),
        rewritten_nodes=rewritten_to.astype(np.uint32),
        added_elements=added.rows.astype(np.uint32),
        added_nodes=added_to.astype(np.uint32),
    )
    return CheckedEdit(
        edit, mesh.version, applied, moved, anchors, nodes.rows, parents, removed, added.rows,
        born_of, elements, old, new, neighbours, sorted_unique(touched[touched != NO_ROW]),
    )  # fmt: skip


class _Names:
    """Permanent rows for ids of new things, provisional in a plan, permanent in a replica."""

    def __init__(self, ids: NDArray[np.uint32], first: int, what: str) -> None:
        self.first = first
        offset = np.asarray(ids, dtype=np.int64)
        provisional = bool(len(offset)) and int(offset[0]) >= PROVISIONAL
        expected = np.arange(len(offset)) + (PROVISIONAL if provisional else first)
        if not np.array_equal(offset, expected):
            raise EditError(
                f"new {what} ids must count up from {PROVISIONAL} in a plan, "
                f"or from {first}, the next free row, in an applied edit"
            )
        self.rows = np.arange(first, first + len(offset), dtype=np.int32)

    def permanent(self, ids: NDArray[np.uint32]) -> NDArray[np.int64]:
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


def _refuse_loose_copies(copies: Rows, rewritten: Rows, added: Rows) -> None:
    if not len(copies):
        return
    named = np.concatenate([rewritten.ravel(), added.ravel()])
    uses = np.bincount(named[named >= copies[0]] - copies[0], minlength=len(copies))
    if not uses.all():
        raise EditError(f"{int((uses == 0).sum())} copied nodes would belong to no element")


def _refuse_flat(
    mesh: Mesh,
    moved: Rows,
    moved_rest: NDArray[np.float64],
    copies: Rows,
    parents: Rows,
    tets: Rows,
) -> None:
    """Refuse elements without volume, the nodes being where the edit puts them."""
    place_of = np.full(mesh.node_rows + len(copies), NO_ROW, dtype=np.int32)
    place_of[moved] = np.arange(len(moved))
    place_of[copies] = np.arange(len(moved), len(moved) + len(copies))
    places = np.concatenate([moved_rest, mesh.rest[parents]])
    of_parent = place_of[parents]
    was_moved = of_parent != NO_ROW
    places[len(moved) :][was_moved] = moved_rest[of_parent[was_moved]]
    place_of[moved] = np.arange(len(moved))
    flat = count_flat(mesh.rest, place_of, places, tets)
    if flat:
        raise EditError(f"{flat} elements would have no positive rest volume")
