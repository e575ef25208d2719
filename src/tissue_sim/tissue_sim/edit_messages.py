"""Edits of the topology as messages, both ways."""

from __future__ import annotations

from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from tissue_interfaces.msg import TopologyEdit as EditMsg

from tissue_sim.conversions import (
    array_of,
    epoch_field,
    fill,
    header,
    patch_from_msg,
    patch_to_msg,
)
from tissue_sim.geometry.edit import TopologyEdit

_EDIT_IDS = (
    "read_nodes", "read_elements", "moved_nodes", "moved_anchors", "copied_nodes", "copy_parents",
    "rewritten_elements", "rewritten_nodes", "removed_elements", "added_elements", "added_nodes",
    "added_parents", "merged_nodes", "merged_into", "returned_nodes", "returned_like",
    "returned_elements", "added_sutures", "suture_nodes", "suture_groups", "removed_sutures",
    "changed_sutures", "born_nodes", "removed_patches",
)  # fmt: skip
_EDIT_REALS = (
    "moved_rest", "moved_weights", "suture_lengths", "suture_stiffness", "changed_lengths",
    "born_rest", "born_tissue",
)  # fmt: skip
_OF_SUTURES = ("suture_nodes", "suture_lengths", "suture_stiffness", "suture_groups")
_EDIT_ITEMS = {"moved_anchors": 4, "rewritten_nodes": 4, "added_nodes": 4, "moved_weights": 4}
_EDIT_ITEMS |= {"moved_rest": 3, "suture_nodes": 2, "born_rest": 3}
_EDIT_KINDS = ("born_kinds",)


def edit_to_msg(edit: TopologyEdit, epoch: bytes, frame_id: str, stamp: Time) -> EditMsg:
    """An edit as a message."""
    message = EditMsg(
        header=header(frame_id, stamp),
        base_version=edit.base_version,
        version=edit.version,
        reverts=edit.reverts,
        base_frame=edit.base_frame,
        kind=edit.kind,
        author=edit.author,
        request_id=edit.request_id,
    )
    message.epoch = epoch_field(epoch)
    for name in (*_EDIT_IDS, *_EDIT_REALS, *_EDIT_KINDS):
        fill(getattr(message, name), getattr(edit, name))
    message.added_patches = [patch_to_msg(patch) for patch in edit.added_patches]
    message.held_by = edit.held_by
    return message


def edit_from_msg(message: EditMsg) -> TopologyEdit:
    """An edit from a message.

    Raises:
        ValueError: The length of a list does not fit the others.
    """
    arrays: dict[str, Any] = {}
    dtypes: dict[str, type[np.generic]] = dict.fromkeys(_EDIT_IDS, np.uint32)
    dtypes |= dict.fromkeys(_EDIT_REALS, np.float64) | dict.fromkeys(_EDIT_KINDS, np.uint8)
    for name, dtype in dtypes.items():
        # Bags from before there were undo, sutures or patches lack some.
        values = array_of(getattr(message, name, ()), dtype)
        items = _EDIT_ITEMS.get(name)
        if items and values.size % items:
            raise ValueError(f"{name} has {values.size} numbers; allowed: a multiple of {items}")
        arrays[name] = values.reshape(-1, items) if items else values
    for name, others in (
        ("moved_nodes", ("moved_rest", "moved_anchors", "moved_weights")),
        ("copied_nodes", ("copy_parents",)),
        ("rewritten_elements", ("rewritten_nodes",)),
        ("added_elements", ("added_nodes", "added_parents")),
        ("merged_nodes", ("merged_into",)),
        ("returned_nodes", ("returned_like",)),
        ("added_sutures", _OF_SUTURES),
        ("changed_sutures", ("changed_lengths",)),
        ("born_nodes", ("born_rest",)),
        ("born_kinds", ("born_tissue",)),
    ):
        for other in others:
            if len(arrays[name]) != len(arrays[other]):
                raise ValueError(
                    f"{other} has {len(arrays[other])} items, {name} {len(arrays[name])}"
                )
    return TopologyEdit(
        base_version=int(message.base_version),
        version=int(message.version),
        reverts=int(getattr(message, "reverts", 0)),
        base_frame=int(message.base_frame),
        kind=message.kind,
        author=message.author,
        request_id=message.request_id,
        held_by=str(getattr(message, "held_by", "")),
        added_patches=tuple(map(patch_from_msg, getattr(message, "added_patches", ()))),
        **arrays,
    )
