"""What can be done and by which keys, from the modes, views and commands themselves."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import viser

from tissue_sim.readings.fields import in_words
from tool_input.table.commands import Command

MOUSE = (
    "**Drag on the tissue** to act; **drag beside it** to turn the view, right drag to move it, "
    "wheel to zoom. **Shift** while dragging moves in depth. **Ctrl+K** lists every command."
)


class Named(Protocol):
    """What can be chosen by a key: a mode or a view."""

    @property
    def name(self) -> str:
        """What the person reads."""

    @property
    def key(self) -> str:
        """What chooses it; empty: nothing does."""

    @property
    def help(self) -> str:
        """One sentence."""


def help_text(modes: Iterable[Named], views: Iterable[Named], commands: Iterable[Command]) -> str:
    """The help in Markdown: a line for each, with its key."""
    parts = [
        [MOUSE],
        [_line(mode.name, mode.key, mode.help) for mode in modes],
        [_line(command.name, command.keys, command.help) for command in commands],
        [_line(in_words(view.name), view.key, view.help) for view in views],
    ]
    titles = ("", "**What a drag does**", "**Commands**", "**Views**")
    return "\n\n".join(
        "\n".join([title, "", *lines]) if title else lines[0]
        for title, lines in zip(titles, parts, strict=True)
        if lines
    )


def add_help(gui: viser.GuiApi, text: str) -> None:
    """Add the help to a window, folded."""
    with gui.add_folder("Help and keys", expand_by_default=False):
        gui.add_markdown(text)


def _line(name: str, key: str, text: str) -> str:
    return f"- `{key}` *{name}*: {text}" if key else f"- *{name}*: {text}"
