"""Single keys from a terminal."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator

ARROWS = {"\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left"}


@contextlib.contextmanager
def pressed_keys() -> Iterator[Callable[[], list[str]]]:
    """Gives what tells the keys pressed since it was asked last; none where stdin is no terminal.

    Arrows are "up", "down", "left" and "right", other keys the character they type. Ctrl-C works as
    always.
    """
    if not sys.stdin.isatty():
        yield list
        return
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)
    try:
        yield lambda: keys_in(_waiting(terminal))
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def keys_in(text: str) -> list[str]:
    """The keys that a terminal sends as this text."""
    keys = []
    while text:
        size = 3 if text[:3] in ARROWS else 1
        keys.append(ARROWS.get(text[:size], text[0]))
        text = text[size:]
    return keys


def _waiting(terminal: int) -> str:
    if not select.select([terminal], [], [], 0.0)[0]:
        return ""
    return os.read(terminal, 1024).decode(errors="replace")
