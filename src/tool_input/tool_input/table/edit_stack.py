"""Whose edit an undo or a redo would take next, from the edits that were heard."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from tissue_sim.geometry.edit import REDO, UNDO, TopologyEdit


class Next(NamedTuple):
    """The edits that come next.

    Attributes:
        to_undo: The one that an undo takes back; None: none was heard.
        to_redo: The one that a redo makes again; None: none was heard.
    """

    to_undo: TopologyEdit | None
    to_redo: TopologyEdit | None


def next_edits(heard: Iterable[TopologyEdit]) -> Next:
    """What undo and redo would take, see srv/Undo: one stack for everybody.

    Args:
        heard: Edits as they were applied, the newest last; those before them are not known.
    """
    done: list[TopologyEdit | None] = []
    undone: list[TopologyEdit | None] = []
    for edit in heard:
        if edit.kind == UNDO:
            undone.append(done.pop() if done else None)
        elif edit.kind == REDO:
            done.append(undone.pop() if undone else None)
        else:
            done.append(edit)
            undone.clear()
    return Next(done[-1] if done else None, undone[-1] if undone else None)


def made_by(author: str, request_id: str, person: str, tool_prefix: str) -> bool:
    """Whether an edit is a person's: asked for by them, or made by one of their tools.

    Args:
        author: Of the edit.
        request_id: Of the edit.
        person: Their name, with which their request ids begin.
        tool_prefix: What the names of their tools begin with.
    """
    return (
        author == person
        or request_id.startswith(f"{person}-")
        or author.startswith(f"{tool_prefix}_")
    )
