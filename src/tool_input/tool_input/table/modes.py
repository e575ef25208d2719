"""What a drag on the tissue does in one window: the contract of grab, probe, cut and the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import viser
from numpy.typing import NDArray

from tool_input.table.page_scene import PageScene
from tool_input.table.person import Person

Vec3 = NDArray[np.float64]
"""A point [m] or a direction in the organ's frame, shape (3,)."""

START, MOVE, END = "start", "move", "end"


@dataclass(frozen=True)
class Drag:
    """One event of a drag on the tissue, in metres, in the organ's frame.

    A drag has one START, any number of MOVE and one END; but when another mode is chosen or the
    window goes away there is no END but `Mode.leave`: a lost connection must not cut.

    Attributes:
        phase: START, MOVE or END.
        start: Where on the tissue it began.
        point: Where it has been dragged to: the pointer in the plane through `start` that faces
            the eye, moved along the view by what was dragged with Shift.
        eye: Where the camera is.
        forward: Unit direction the camera looks in.
        hit: Where the pointer's ray meets the tissue now; None if it does not.
        normal: Outward unit normal of the tissue at `start`.
    """

    phase: str
    start: Vec3
    point: Vec3
    eye: Vec3
    forward: Vec3
    hit: Vec3 | None
    normal: Vec3


class Mode(Protocol):
    """What a drag on the tissue does in one window; one is made for every window.

    All of it is called in the node's thread, one call after the other. A ValueError is told to
    the person.

    Attributes:
        name: What the person reads, such as "grab".
        key: The letter that chooses it, upper case, such as "G".
        help: One sentence for the help panel.
    """

    name: str
    key: str
    help: str

    def drag(self, drag: Drag) -> None:
        """The person drags on the tissue."""

    def settings(self, gui: viser.GuiApi) -> None:
        """Add the mode's controls; called in their folder when the mode is chosen.

        The folder is removed when another mode is chosen. Callbacks of controls are wrapped with
        `Person.in_turn`.
        """

    def leave(self) -> None:
        """Another mode is chosen: let go, but for what the person wants to be kept.

        The window's end is not the mode's matter: a person's tools go with the window.
        """


ModeMaker = Callable[[Person, PageScene], Mode]
"""Makes a mode for one window: usually its class."""
