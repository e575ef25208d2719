"""What a person can do at once, by a button or a key."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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


def add_commands(
    gui: viser.GuiApi, person: Person, label: str, commands: Sequence[Command]
) -> None:
    """Add a row of buttons to a window, and each to its command palette, with its key."""
    by_name = {command.name: command for command in commands}
    buttons = gui.add_button_group(label, tuple(by_name))
    buttons.on_click(person.in_turn(lambda: by_name[buttons.value].act()))
    for command in commands:
        entry = gui.add_command(
            command.name, description=command.help, hotkey=command.key or None,
            modifier=command.modifier or None,
        )  # fmt: skip
        entry.on_trigger(person.in_turn(command.act))
