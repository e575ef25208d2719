"""Versioned changes of topology.

Everything in an edit refers to permanent ids. A plan names the nodes and elements it makes by
provisional ids (`PROVISIONAL + k`); `Mesh.apply` gives them permanent ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry import patches
from tissue_sim.geometry.incidence import among
from tissue_sim.geometry.patches import Patch
from tissue_sim.geometry.sutures import Sutures, why_not

PROVISIONAL = 1 << 31
"""First provisional id."""

NO_PARENT = 0xFFFFFFFF
"""Parent of an element that an edit makes of nothing."""

PATCH = "patch"
"""Kind of edits that add a patch."""

UNDO, REDO = "undo", "redo"
"""Kinds of edits that take an edit back, and make it again."""

FARTHEST_ANCHOR = 100.0
"""Largest barycentric weight of a moved node that is believed."""


class EditError(ValueError):
    """An edit that would make a bad mesh; nothing was changed."""


class StaleEditError(EditError):
    """Something the edit's plan has read changed after its base version; plan again."""


def _ids(*shape: int) -> NDArray[np.uint32]:
    return np.empty((0, *shape), dtype=np.uint32)


def _reals(*shape: int) -> NDArray[np.float64]:
    return np.empty((0, *shape), dtype=np.float64)


@dataclass(frozen=True)
class TopologyEdit:
    """A change of topology, planned on `base_version`.

    Attributes:
        base_version: Version the edit was planned on.
        kind: What made it, such as "split".
        base_frame: State frame it was planned on.
        read_nodes: Ids of nodes the plan depends on, shape (n,).
        read_elements: Ids of elements the plan depends on, shape (n,).
        moved_nodes: Ids of nodes whose rest position moves, shape (m,). A node of `copied_nodes`
            may be among them: it is then put to the place given, on an edge of the tissue for
            example, and only the rest of it (whether it is fixed, say) comes from its parent.
        moved_rest: Their new rest positions [m], shape (m, 3).
        moved_anchors: Ids of the nodes of the element that contains each new place, shape (m, 4).
        moved_weights: Barycentric weights, shape (m, 4): the new current (and previous) position is
            the weighted sum of the anchors' positions as they were before the edit.
        copied_nodes: Ids of new nodes, shape (c,).
        copy_parents: Ids of the nodes they copy, after moving, shape (c,).
        rewritten_elements: Ids of elements whose nodes change, shape (r,).
        rewritten_nodes: Their new node ids, shape (r, 4).
        removed_elements: Ids, shape (d,).
        added_elements: Ids of new elements, shape (a,).
        added_nodes: Their node ids, shape (a, 4).
        added_parents: Ids of the elements they descend from, shape (a,); `NO_PARENT` for those of
            the patch that the edit adds, which have nodes of `born_nodes` only.
        merged_nodes: Ids of nodes that vanish into others, shape (v,). Only an undo has some.
        merged_into: Ids of the nodes they vanish into, shape (v,): each of these takes the mean of
            its own place and those of the nodes that vanish into it.
        returned_nodes: Ids of vanished nodes that come back, shape (b,). Only an undo has some.
        returned_like: Ids of the nodes they are displaced like, shape (b,); its own id: as it was.
        returned_elements: Ids of removed elements that come back as they were, shape (e,). Only an
            undo has some.
        added_sutures: Ids of new sutures, shape (s,).
        suture_nodes: Ids of the nodes at their ends, shape (s, 2).
        suture_lengths: Their rest lengths [m], shape (s,).
        suture_stiffness: Their stiffnesses [N/m], shape (s,).
        suture_groups: Id of the first suture of the thread that each belongs to, shape (s,).
        removed_sutures: Ids of sutures that are taken out, shape (o,).
        changed_sutures: Ids of sutures that get another rest length, shape (l,).
        changed_lengths: Those rest lengths [m], shape (l,).
        born_nodes: Ids of new nodes that copy none, shape (n,). In a plan they count on after those
            of `copied_nodes`. They start where they are at rest, at rest and not fixed.
        born_rest: Their rest positions [m], shape (n, 3).
        born_kinds: Of a sheet, what each added element without parent is, in the order of
            `added_elements`: `sheet.SURFACE` for a triangle, `sheet_rows.WALL` for one that is only
            shown, else the category of a spring, shape (k,). Empty for tetrahedra.
        born_tissue: Likewise the thickness of a triangle [m] or the volume of a spring's tissue
            [m^3], 0 for a wall, shape (k,).
        added_patches: The patch that those nodes and elements are, or none: at most one.
        removed_patches: Ids of patches that vanish. Only an undo has some.
        held_by: Tool that holds the nodes of `born_nodes` from the frame they appear in; "": none.
        reverts: Version of the edit that an undo takes back, or of the undo that a redo takes back.
        version: Version the edit made; 0 while it is only a plan.
        author: Client id of the request.
        request_id: Id of the request.
    """

    base_version: int
    kind: str = "split"
    base_frame: int = 0
    read_nodes: NDArray[np.uint32] = field(default_factory=_ids)
    read_elements: NDArray[np.uint32] = field(default_factory=_ids)
    moved_nodes: NDArray[np.uint32] = field(default_factory=_ids)
    moved_rest: NDArray[np.float64] = field(default_factory=lambda: _reals(3))
    moved_anchors: NDArray[np.uint32] = field(default_factory=lambda: _ids(4))
    moved_weights: NDArray[np.float64] = field(default_factory=lambda: _reals(4))
    copied_nodes: NDArray[np.uint32] = field(default_factory=_ids)
    copy_parents: NDArray[np.uint32] = field(default_factory=_ids)
    rewritten_elements: NDArray[np.uint32] = field(default_factory=_ids)
    rewritten_nodes: NDArray[np.uint32] = field(default_factory=lambda: _ids(4))
    removed_elements: NDArray[np.uint32] = field(default_factory=_ids)
    added_elements: NDArray[np.uint32] = field(default_factory=_ids)
    added_nodes: NDArray[np.uint32] = field(default_factory=lambda: _ids(4))
    added_parents: NDArray[np.uint32] = field(default_factory=_ids)
    merged_nodes: NDArray[np.uint32] = field(default_factory=_ids)
    merged_into: NDArray[np.uint32] = field(default_factory=_ids)
    returned_nodes: NDArray[np.uint32] = field(default_factory=_ids)
    returned_like: NDArray[np.uint32] = field(default_factory=_ids)
    returned_elements: NDArray[np.uint32] = field(default_factory=_ids)
    added_sutures: NDArray[np.uint32] = field(default_factory=_ids)
    suture_nodes: NDArray[np.uint32] = field(default_factory=lambda: _ids(2))
    suture_lengths: NDArray[np.float64] = field(default_factory=_reals)
    suture_stiffness: NDArray[np.float64] = field(default_factory=_reals)
    suture_groups: NDArray[np.uint32] = field(default_factory=_ids)
    removed_sutures: NDArray[np.uint32] = field(default_factory=_ids)
    changed_sutures: NDArray[np.uint32] = field(default_factory=_ids)
    changed_lengths: NDArray[np.float64] = field(default_factory=_reals)
    born_nodes: NDArray[np.uint32] = field(default_factory=_ids)
    born_rest: NDArray[np.float64] = field(default_factory=lambda: _reals(3))
    born_kinds: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, dtype=np.uint8))
    born_tissue: NDArray[np.float64] = field(default_factory=_reals)
    added_patches: tuple[Patch, ...] = ()
    removed_patches: NDArray[np.uint32] = field(default_factory=_ids)
    held_by: str = ""
    reverts: int = 0
    version: int = 0
    author: str = ""
    request_id: str = ""

    @property
    def from_history(self) -> bool:
        """Whether it brings things back, which only the history of a mesh can plan."""
        back = len(self.merged_nodes) + len(self.returned_nodes) + len(self.returned_elements)
        return self.kind in (UNDO, REDO) or back > 0 or len(self.removed_patches) > 0

    @property
    def sews(self) -> bool:
        """Whether it makes, removes or changes sutures."""
        changed = len(self.removed_sutures) + len(self.changed_sutures)
        return len(self.added_sutures) + changed > 0


_SHAPES = (
    ("moved_nodes", "moved_rest", 3),
    ("moved_nodes", "moved_anchors", 4),
    ("moved_nodes", "moved_weights", 4),
    ("copied_nodes", "copy_parents", 0),
    ("rewritten_elements", "rewritten_nodes", 4),
    ("added_elements", "added_nodes", 4),
    ("added_elements", "added_parents", 0),
    ("merged_nodes", "merged_into", 0),
    ("returned_nodes", "returned_like", 0),
    ("added_sutures", "suture_nodes", 2),
    ("added_sutures", "suture_lengths", 0),
    ("added_sutures", "suture_stiffness", 0),
    ("added_sutures", "suture_groups", 0),
    ("changed_sutures", "changed_lengths", 0),
    ("born_nodes", "born_rest", 3),
    ("born_kinds", "born_tissue", 0),
)


def refuse_malformed(edit: TopologyEdit) -> None:
    """Refuse an edit that no mesh could apply.

    Raises:
        EditError: Arrays do not fit together, a node is moved twice, or a number is not finite.
    """
    for counted, other, width in _SHAPES:
        wanted = (len(getattr(edit, counted)), width) if width else (len(getattr(edit, counted)),)
        shape = np.shape(getattr(edit, other))
        if shape != wanted:
            raise EditError(f"{other} has shape {shape}; {counted} calls for {wanted}")
    if not (np.isfinite(edit.moved_rest).all() and np.isfinite(edit.moved_weights).all()):
        raise EditError("a moved node's new place or weights are not finite")
    if len(edit.moved_weights) and np.abs(edit.moved_weights.sum(axis=1) - 1.0).max() > 1e-6:
        raise EditError("the weights of a moved node do not add up to 1")
    if np.abs(edit.moved_weights).max(initial=0.0) > FARTHEST_ANCHOR:
        raise EditError("a moved node lies far outside of its anchors")
    moved = np.sort(edit.moved_nodes)
    if (moved[1:] == moved[:-1]).any():
        raise EditError("a node is moved twice in one edit")
    lengths = np.concatenate([edit.suture_lengths, edit.changed_lengths])
    if why := why_not(lengths, edit.suture_stiffness):
        raise EditError(why)
    _refuse_malformed_patch(edit)


def _refuse_malformed_patch(edit: TopologyEdit) -> None:
    born = int((np.asarray(edit.added_parents) == NO_PARENT).sum())
    if len(edit.added_patches) > 1:
        raise EditError(f"the edit adds {len(edit.added_patches)} patches; allowed: one at most")
    if not edit.added_patches and (born or len(edit.born_nodes) or len(edit.born_kinds)):
        raise EditError("nodes and elements without parent need a patch that they are of")
    if not edit.added_patches and edit.held_by:
        raise EditError(f"there is no patch that {edit.held_by!r} could hold")
    if not edit.added_patches:
        return
    if not born or not len(edit.born_nodes):
        raise EditError("a patch needs nodes and elements without parent")
    if not np.isfinite(edit.born_rest).all():
        raise EditError("the place of a node without parent is not finite")
    if len(edit.born_kinds) not in (0, born):
        raise EditError(f"born_kinds has {len(edit.born_kinds)} items; allowed: 0, or {born}")
    if why := patches.why_not(edit.added_patches[0]):
        raise EditError(why)


@dataclass(frozen=True)
class EditChange:
    """What an applied edit touched, in rows: all that derived data needs to follow.

    Attributes:
        edit: The edit with permanent ids and its version.
        moved_nodes: Rows of nodes whose rest position moved, new nodes that do not start where
            their parents are included, shape (m,).
        moved_anchors: Rows of the anchors of each moved node, shape (m, 4).
        moved_weights: Barycentric weights, shape (m, 4).
        old_moved_rest: Rest positions before the edit [m], those of the parents for new nodes,
            shape (m, 3).
        copied_nodes: Rows of the new nodes, and of those that a redo makes again, shape (c,).
        copy_parents: Rows of their parents, shape (c,).
        elements: Rows of elements rewritten, removed, added or brought back, shape (e,).
        old_elements: Node rows of those elements before, shape (e, 4); -1 where the element is new.
        new_elements: Node rows after, shape (e, 4); -1 where it was removed.
        neighbours: Sorted rows of the elements that met a moved node or one that others vanish
            into, those rewritten or removed included, shape (n,).
        nodes: Sorted rows of every node whose incident elements, rest position or sutures changed,
            the nodes of all `neighbours` included, shape (k,).
        vanished_nodes: Sorted rows of the nodes that are no more, shape (v,).
        merged_nodes: Rows of those that vanished into others, shape (m,).
        merged_into: Rows of the nodes they vanished into, shape (m,).
        returned_nodes: Rows of nodes that are back, but for copies; and of nodes without parent,
            which come as if they were back, shape (b,).
        returned_like: Rows of the nodes they are displaced like, shape (b,).
        returned_offsets: Their rest positions minus those of the nodes they are displaced like,
            both before the edit [m], shape (b, 3).
        lost_sutures: Sutures that were there before, those removed and those whose nodes vanished.
        released: Ids of the latter, shape (r,).
        old_lengths: Rest lengths [m] of the sutures changed before the edit, shape (l,).
        born_nodes: Rows of the nodes without parent, those that a redo makes again included: they
            are where they are at rest, shape (n,).
    """

    edit: TopologyEdit
    moved_nodes: NDArray[np.int32]
    moved_anchors: NDArray[np.int32]
    moved_weights: NDArray[np.float64]
    old_moved_rest: NDArray[np.float64]
    copied_nodes: NDArray[np.int32]
    copy_parents: NDArray[np.int32]
    elements: NDArray[np.int32]
    old_elements: NDArray[np.int32]
    new_elements: NDArray[np.int32]
    neighbours: NDArray[np.int32]
    nodes: NDArray[np.int32]
    vanished_nodes: NDArray[np.int32]
    merged_nodes: NDArray[np.int32]
    merged_into: NDArray[np.int32]
    returned_nodes: NDArray[np.int32]
    returned_like: NDArray[np.int32]
    returned_offsets: NDArray[np.float64]
    lost_sutures: Sutures = field(default_factory=Sutures)
    released: NDArray[np.uint32] = field(default_factory=_ids)
    old_lengths: NDArray[np.float64] = field(default_factory=_reals)
    born_nodes: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, dtype=np.int32))

    @property
    def stays(self) -> NDArray[np.bool_]:
        """Copies that start where their parents are; others are among the moved, shape (c,)."""
        return ~among(self.copied_nodes, self.moved_nodes)
