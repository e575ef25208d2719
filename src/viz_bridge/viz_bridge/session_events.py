"""What happened in a session, in words, from its journal."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Literal

from tissue_sim import edit_messages
from tissue_sim.geometry.edit import PATCH
from tissue_sim.geometry.patch_figures import patch_area
from viz_bridge.cdr import Message

Level = Literal["INFO", "WARN", "ERROR"]


SEWING = ("suture", "tighten", "unsuture")
"""Kinds of edits that sew."""


@dataclass(frozen=True)
class SessionEvent:
    """One thing that happened.

    Attributes:
        stamp: When [ns since 1970].
        sim_time: When in the session [s].
        frame: In which frame.
        kind: press, release, cut, suture, patch, or the kind of a command.
        text: In words.
        tool: The tool it is about; empty for none.
        level: How much it matters.
    """

    stamp: int
    sim_time: float
    frame: int
    kind: str
    text: str
    tool: str = ""
    level: Level = "INFO"


def nanoseconds(stamp: Message) -> int:
    """A time message in nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def journal_events(entry: Message, tool_kinds: dict[str, str]) -> list[SessionEvent]:
    """What one frame of the journal says happened.

    Args:
        entry: A Journal message.
        tool_kinds: "grab", "cut", "burn" or "patch" by tool.
    """
    stamp, time, frame = nanoseconds(entry.header.stamp), float(entry.sim_time), int(entry.frame)
    events = [
        SessionEvent(stamp, time, frame, command.kind, _command_in_words(command))
        for command in entry.commands
    ]
    events += [
        SessionEvent(stamp, time, frame, _kind_of(edit), _edit_in_words(edit))
        for edit in entry.edits
    ]
    for tool in entry.tools:
        if tool.edge:
            kind = "press" if tool.edge > 0 else "release"
            text = _edge_in_words(tool.id, tool_kinds.get(tool.id, ""), tool.edge > 0)
            events.append(SessionEvent(stamp, time, frame, kind, text, tool.id))
    return events


def _edge_in_words(tool: str, kind: str, pressed: bool) -> str:
    if kind == "grab":
        return f"{tool} grabs" if pressed else f"{tool} lets go"
    if kind == "cut":
        return f"{tool} cuts" if pressed else f"{tool} is withdrawn"
    if kind == "burn":
        return f"{tool} burns" if pressed else f"{tool} burns no more"
    if kind == PATCH:
        return f"{tool} lays a patch" if pressed else f"{tool} lets go of its patch"
    return f"{tool} is pressed" if pressed else f"{tool} is released"


def _kind_of(edit: Message) -> str:
    if edit.kind in SEWING:
        return "suture"
    return PATCH if edit.kind == PATCH else "cut"


def _edit_in_words(edit: Message) -> str:
    if edit.kind == PATCH:
        return _patch_in_words(edit)
    if edit.kind in SEWING:
        stitches = edit.added_sutures, edit.removed_sutures, edit.changed_sutures
        count = sum(len(some) for some in stitches)
        return f"{edit.kind}: {count} stitches (version {edit.version})"
    return (
        f"{edit.kind}: {len(edit.copied_nodes)} nodes added, "
        f"{len(edit.rewritten_elements)} tetrahedra changed (version {edit.version})"
    )


def _patch_in_words(message: Message) -> str:
    edit = edit_messages.edit_from_msg(message)
    name = edit.added_patches[0].name if edit.added_patches else PATCH
    carried = f", carried by {edit.held_by}" if edit.held_by else ""
    return (
        f"{name}: {len(edit.born_nodes)} nodes, {1e4 * patch_area(edit):.3g} cm2{carried} "
        f"(version {edit.version})"
    )


def _command_in_words(command: Message) -> str:
    try:
        arguments: Any = json.loads(command.arguments or "{}")
    except json.JSONDecodeError:
        arguments = {}
    if not isinstance(arguments, dict):
        arguments = {}
    # A start carries a whole scene: only what fits on a line is told.
    short = {k: v for k, v in arguments.items() if isinstance(v, (str, int, float)) and v != ""}
    words = ", ".join(f"{key} {value}" for key, value in list(short.items())[:5])
    return f"{command.kind}: {words}" if words else str(command.kind)
