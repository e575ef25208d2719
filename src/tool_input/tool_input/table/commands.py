"""What a person can do at once, by a button or a key."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import viser

from tool_input.table.person import Person


@dataclass(frozen=True)
class Command:
    """One of these.

    Attributes:
        name: Of the button.
        help: One sentence for the help panel.
        act: What it does, in the node's thread.
        key: That does it too, as viser names keys; empty: none.
        modifier: Held with the key, as viser names modifiers; empty: none.
    """

    name: str
    help: str
    act: Callable[[], None]
    key: str = ""
    modifier: str = ""

    @property
    def keys(self) -> str:
        """Key and modifier as people read them, such as "Ctrl+Z"; empty: none."""
        parts = [part for part in (*self.modifier.split("+"), self.key) if part]
        return "+".join("Ctrl" if part == "cmd/ctrl" else part.capitalize() for part in parts)


def add_command(gui: viser.GuiApi, person: Person, command: Command) -> viser.GuiButtonHandle:
    """Add a button, an entry of the command palette and its key to a window."""
    hint = f"{command.help} ({command.keys})" if command.key else command.help
    button = gui.add_button(command.name, hint=hint)
    button.on_click(person.in_turn(command.act))
    entry = gui.add_command(
        command.name, description=command.help, hotkey=command.key or None,
        modifier=command.modifier or None,
    )  # fmt: skip
    entry.on_trigger(person.in_turn(command.act))
    return button
