"""What an edit does to sutures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import PROVISIONAL, EditError, TopologyEdit
from tissue_sim.geometry.incidence import among
from tissue_sim.geometry.sutures import FIRST_ID, Sutures


@dataclass(frozen=True)
class Stitching:
    """What an edit does to the sutures of a mesh.

    Attributes:
        added: The new ones, with permanent ids.
        removed: Those that are taken out.
        after: All of them after it; of these, those whose nodes vanish are released.
        old_lengths: Rest lengths [m] of those changed before it, shape (l,).
        nodes: Node rows at the ends of all of them, shape (t, 2).
    """

    added: Sutures
    removed: Sutures
    after: Sutures
    old_lengths: NDArray[np.float64]
    nodes: NDArray[np.int32]


def stitching_of(
    there: Sutures,
    edit: TopologyEdit,
    brings_back: bool,
    nodes_of: Callable[[NDArray[np.integer]], NDArray[np.int32]],
) -> Stitching:
    """Find out what an edit does to sutures.

    Args:
        there: The sutures before it.
        edit: The edit; `refuse_malformed` has let it pass.
        brings_back: Whether it names new sutures by ids they have had (an undo or a redo).
        nodes_of: Rows of node ids after the edit; refuses unknown ones.

    Raises:
        EditError: It names a suture that is not there, or both ends of one are at one node.
    """
    if not edit.sews:
        none = there.at(np.zeros(len(there), dtype=np.bool_))
        return Stitching(none, none, there, none.lengths, none.nodes)
    ids, groups = _permanent(there, edit, brings_back)
    added = Sutures(
        ids, nodes_of(edit.suture_nodes.reshape(-1, 2)), np.array(edit.suture_lengths, np.float64),
        np.array(edit.suture_stiffness, np.float64), groups, there.next_id,
    )  # fmt: skip
    if (added.nodes[:, 0] == added.nodes[:, 1]).any():
        raise EditError("both ends of a suture would be at one node")
    removed = _known(there, edit.removed_sutures, "removed")
    changed = _known(there, edit.changed_sutures, "changed")
    if among(removed, changed).any():
        raise EditError("a suture is removed and changed in one edit")
    kept = np.ones(len(there), dtype=np.bool_)
    kept[removed] = False
    after = there.with_lengths(changed, edit.changed_lengths).at(kept).joined(added)
    nodes = np.concatenate([there.nodes[removed], there.nodes[changed], added.nodes])
    return Stitching(added, there.at(removed), after, there.lengths[changed], nodes)


def _known(there: Sutures, ids: NDArray[np.uint32], what: str) -> NDArray[np.int64]:
    places = there.places_of(ids)
    if (places < 0).any():
        missing = np.asarray(ids)[places < 0][:5].tolist()
        raise EditError(f"the edit names a {what} suture that is not there: id {missing}")
    if len(np.unique(places)) != len(places):
        raise EditError(f"a suture is {what} twice in one edit")
    return places


def _permanent(
    there: Sutures, edit: TopologyEdit, brings_back: bool
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Permanent ids of the new sutures and of their groups."""
    ids, groups = edit.added_sutures.astype(np.int64), edit.suture_groups.astype(np.int64)
    first = there.next_id
    if brings_back:
        known = (ids >= FIRST_ID) & (ids < first) & (there.places_of(ids) < 0)
        if not known.all() or len(np.unique(ids)) != len(ids):
            raise EditError("the edit brings back a suture that has not been removed")
        return ids.astype(np.uint32), groups.astype(np.uint32)
    provisional = bool(len(ids)) and int(ids[0]) >= PROVISIONAL
    if not np.array_equal(ids, np.arange(len(ids)) + (PROVISIONAL if provisional else first)):
        raise EditError(
            f"new suture ids must count up from {PROVISIONAL} in a plan, or from {first}, the next "
            "free id, in an applied edit"
        )
    ids = np.arange(first, first + len(ids))
    groups = np.where(groups >= PROVISIONAL, groups - PROVISIONAL + first, groups)
    if ((groups < FIRST_ID) | (groups >= first + len(ids))).any():
        raise EditError("a suture's group is no suture's id; allowed: that of its first stitch")
    return ids.astype(np.uint32), groups.astype(np.uint32)
