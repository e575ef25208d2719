"""Which edits a mesh has gone through, and the edits that take them back or make them again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import REDO, UNDO, EditChange, EditError, TopologyEdit
from tissue_sim.geometry.incidence import among
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.pull_back import find_anchors
from tissue_sim.geometry.sutures import Sutures

Rows = NDArray[np.int32]


class NoEditError(EditError):
    """There is nothing to undo, or nothing to redo."""


@dataclass(frozen=True)
class Step:
    """An edit that can be undone or made again.

    Attributes:
        edit: With permanent ids; of its kind, author and request when it was first made.
        made: Version that it made when it was made last.
        undone: Version that its last undo made; 0 if it was never undone.
        old_rest: Rest positions of the moved nodes before it [m], shape (m, 3).
        old_nodes: Node rows of the rewritten elements before it, shape (r, 4).
        vanished: Rows of the nodes that vanished with it, shape (v,).
        lost_sutures: Sutures that it took out or released.
        old_lengths: Rest lengths of the sutures it changed before it [m], shape (l,).
    """

    edit: TopologyEdit
    made: int
    undone: int
    old_rest: NDArray[np.float64]
    old_nodes: Rows
    vanished: Rows
    lost_sutures: Sutures = field(default_factory=Sutures)
    old_lengths: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))


class EditHistory:
    """One stack of edits, whoever made them; undone ones wait until another edit is made.

    It plans the edits that take the last one back or make it again; `Mesh.apply` applies them as it
    does any other, and `record` is told of every edit applied.
    """

    def __init__(self) -> None:
        self.done: list[Step] = []
        self.undone: list[Step] = []
        # Compile or load now rather than in the frame of the first undo.
        _anchors_of(np.zeros((1, 3)), _none(4), _none(), np.empty((0, 3)))

    def record(self, change: EditChange) -> None:
        """Take note of an edit that the mesh has applied.

        Raises:
            ValueError: An undo or redo that is not of the newest edit.
        """
        edit = change.edit
        if edit.kind == UNDO:
            step = self._last(self.done, edit, lambda step: step.made)
            self.undone.append(replace(step, undone=edit.version))
        elif edit.kind == REDO:
            step = self._last(self.undone, edit, lambda step: step.undone)
            self.done.append(replace(step, made=edit.version))
        else:
            nobody = np.empty(0, dtype=np.uint32)
            kept = replace(edit, read_nodes=nobody, read_elements=nobody)
            old_nodes = change.old_elements[: len(edit.rewritten_elements)]
            step = Step(
                kept, edit.version, 0, change.old_moved_rest, old_nodes, change.vanished_nodes,
                change.lost_sutures, change.old_lengths,
            )  # fmt: skip
            self.done.append(step)
            self.undone.clear()

    @staticmethod
    def _last(steps: list[Step], edit: TopologyEdit, version: Callable[[Step], int]) -> Step:
        if not steps or version(steps[-1]) != edit.reverts:
            raise ValueError(f"version {edit.reverts} is not the newest to {edit.kind}")
        return steps.pop()

    def undo(self, mesh: Mesh, author: str = "", request_id: str = "") -> TopologyEdit:
        """The edit that takes back the newest edit there is.

        Args:
            mesh: The mesh that went through the edits recorded, and no others.
            author: Client id of the request.
            request_id: Id of the request.

        Raises:
            NoEditError: There is none.
        """
        if not self.done:
            undone = f"; {len(self.undone)} undone edits can be redone" if self.undone else ""
            raise NoEditError(f"there is no edit to undo{undone}")
        step = self.done[-1]
        edit, back = step.edit, step.vanished
        # New nodes with a place of their own vanish; other copies leave their parents a share.
        moved = ~among(edit.moved_nodes, edit.copied_nodes)
        merged = ~among(edit.copied_nodes, edit.moved_nodes)
        before = np.concatenate([step.old_nodes, mesh.tets[edit.removed_elements]])
        anchors, weights = _pull_back(mesh, step, moved, before)
        lost = step.lost_sutures
        return TopologyEdit(
            base_version=mesh.version,
            kind=UNDO,
            moved_nodes=edit.moved_nodes[moved],
            moved_rest=step.old_rest[moved],
            moved_anchors=_ids(anchors),
            moved_weights=weights,
            rewritten_elements=edit.rewritten_elements,
            rewritten_nodes=_ids(step.old_nodes),
            removed_elements=edit.added_elements,
            merged_nodes=edit.copied_nodes[merged],
            merged_into=edit.copy_parents[merged],
            returned_nodes=_ids(back),
            returned_like=_ids(_closest_living(mesh, back, before)),
            returned_elements=edit.removed_elements,
            added_sutures=lost.ids,
            suture_nodes=_ids(lost.nodes),
            suture_lengths=lost.lengths,
            suture_stiffness=lost.stiffness,
            suture_groups=lost.groups,
            removed_sutures=edit.added_sutures,
            changed_sutures=edit.changed_sutures,
            changed_lengths=step.old_lengths,
            removed_patches=np.array([patch.id for patch in edit.added_patches], dtype=np.uint32),
            reverts=step.made,
            author=author,
            request_id=request_id,
        )

    def redo(self, mesh: Mesh, author: str = "", request_id: str = "") -> TopologyEdit:
        """The edit that makes the edit again that was undone last, with the same ids.

        Args:
            mesh: The mesh that went through the edits recorded, and no others.
            author: Client id of the request.
            request_id: Id of the request.

        Raises:
            NoEditError: There is none.
        """
        if not self.undone:
            raise NoEditError(
                "there is no undone edit to redo; a new edit makes an end of those that were undone"
            )
        step = self.undone[-1]
        return replace(
            step.edit, base_version=mesh.version, base_frame=0, kind=REDO, reverts=step.undone,
            version=0, author=author, request_id=request_id, held_by="",
        )  # fmt: skip


def _none(width: int = 0) -> Rows:
    return np.empty((0, width) if width else 0, dtype=np.int32)


def _ids(rows: Rows) -> NDArray[np.uint32]:
    """Ids of rows, which are the rows; `NO_NODE` of a sheet for none."""
    return rows.astype(np.uint32)


def _pull_back(
    mesh: Mesh, step: Step, which: NDArray[np.bool_], before: Rows
) -> tuple[Rows, NDArray[np.float64]]:
    """Anchors and weights of the old places of moved nodes in the elements as they were before.

    All nodes of those are there after the undo. The rest positions are those after the edit: that
    is where the current shape, once its nodes are merged, has them.

    Args:
        mesh: The mesh after the edit.
        step: The edit.
        which: Which of its moved nodes.
        before: Nodes of the elements it rewrote or removed before it, shape (n, 4).
    """
    edit = step.edit
    moved = edit.moved_nodes[which].astype(np.int32)
    changed = np.concatenate([edit.rewritten_elements, edit.added_elements]).astype(np.int32)
    around = mesh.incident.of_all(moved)
    around = around[~among(around, changed)]
    return _anchors_of(
        mesh.rest, np.concatenate([before, mesh.tets[around]]), moved, step.old_rest[which]
    )


def _anchors_of(
    rest: NDArray[np.float64], tets: Rows, moved: Rows, targets: NDArray[np.float64]
) -> tuple[Rows, NDArray[np.float64]]:
    place_of = np.full(len(rest), -1, dtype=np.int32)
    place_of[moved] = np.arange(len(moved), dtype=np.int32)
    # Without an element the node keeps its current place.
    anchors, weights = (
        np.repeat(moved[:, None], 4, axis=1),
        np.tile([1.0, 0, 0, 0], (len(moved), 1)),
    )
    find_anchors(rest, tets, place_of, targets, anchors, weights)
    return anchors, weights


def _closest_living(mesh: Mesh, vanished: Rows, tets: Rows) -> Rows:
    """For vanished nodes a living one that few of the elements before lie between; else itself."""
    like = vanished.copy()
    if not len(vanished):
        return like
    # Triangles and springs of a sheet have fewer nodes.
    nodes, corners = np.unique(np.where(tets < 0, tets[:, :1], tets), return_inverse=True)
    corners = corners.reshape(tets.shape)
    nobody = np.iinfo(np.int32).max
    found = np.where(mesh.node_alive[nodes], nodes, nobody).astype(np.int32)
    place = np.searchsorted(nodes, vanished)
    while True:
        nearer = found.copy()
        # The lowest row of several: the outcome does not depend on the order of elements.
        np.minimum.at(nearer, corners, found[corners].min(axis=1, keepdims=True))
        nearer[found != nobody] = found[found != nobody]
        if np.array_equal(nearer, found):
            break
        found = nearer
    known = found[place] != nobody
    like[known] = found[place[known]]
    return like
