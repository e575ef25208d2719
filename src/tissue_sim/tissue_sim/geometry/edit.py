"""Versioned changes of topology.

Everything in an edit refers to permanent ids. A plan names the nodes and elements it makes by
provisional ids (`PROVISIONAL + k`); `Mesh.apply` gives them permanent ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

PROVISIONAL = 1 << 31
"""First provisional id."""


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
        moved_nodes: Ids of nodes whose rest position moves, shape (m,). A node of `copied_nodes` may
            be among them: it is then put to the place given, on an edge of the tissue for example,
            and only the rest of it (whether it is fixed, say) comes from its parent.
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
        added_parents: Ids of the elements they descend from, shape (a,).
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
    version: int = 0
    author: str = ""
    request_id: str = ""


_SHAPES = (
    ("moved_nodes", "moved_rest", 3),
    ("moved_nodes", "moved_anchors", 4),
    ("moved_nodes", "moved_weights", 4),
    ("copied_nodes", "copy_parents", 0),
    ("rewritten_elements", "rewritten_nodes", 4),
    ("added_elements", "added_nodes", 4),
    ("added_elements", "added_parents", 0),
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


@dataclass(frozen=True)
class EditChange:
    """What an applied edit touched, in rows: all that derived data needs to follow.

    Attributes:
        edit: The edit with permanent ids and its version.
        moved_nodes: Rows of nodes whose rest position moved, new nodes that do not start where their
            parents are included, shape (m,).
        moved_anchors: Rows of the anchors of each moved node, shape (m, 4).
        moved_weights: Barycentric weights, shape (m, 4).
        old_moved_rest: Rest positions before the edit [m], those of the parents for new nodes,
            shape (m, 3).
        copied_nodes: Rows of the new nodes, shape (c,).
        copy_parents: Rows of their parents, shape (c,).
        elements: Rows of elements rewritten, removed or added, shape (e,).
        old_elements: Node rows of those elements before, shape (e, 4); -1 where the element is new.
        new_elements: Node rows after, shape (e, 4); -1 where it was removed.
        neighbours: Sorted rows of the elements that met a moved node, those rewritten or removed
            included, shape (n,).
        nodes: Sorted rows of every node whose incident elements or rest position changed, the nodes
            of all elements incident to a moved node included, shape (k,).
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

    @property
    def stays(self) -> NDArray[np.bool_]:
        """Copies that start where their parents are; others are among the moved, shape (c,)."""
        return np.isin(self.copied_nodes, self.moved_nodes, invert=True)
