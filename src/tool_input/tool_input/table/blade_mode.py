"""Cutting with a blade: a triangle or a rectangle that a drag places, turns and presses."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tissue_interfaces.msg import Tool

from tool_input.table.modes import END, START, Drag, Vec3
from tool_input.table.page_scene import PageScene
from tool_input.table.person import Person
from tool_input.table.tool_mode import ToolMode
from tool_input.table.tool_size import MM, in_mm

UPRIGHT, ALONG_VIEW = "upright on the tissue", "along the view"
WHILE_DRAGGED, WHERE_RELEASED = "while dragged", "where released"
TURNS = {"J": -15.0, "K": 15.0}
"""Keys that turn the blade, and by how many degrees."""

FIRST_WAY = 0.25
"""A drag of this share of the blade's width says which way the blade goes."""

STEEPEST = 2.0
"""Depth that the pointer may gain on the tissue per distance moved across the view.

Where the wound gapes the pointer meets the tissue far behind, where the blade must not jump.
"""


class BladeMode(ToolMode):
    """Cuts with a blade all that it passes while it is dragged, or once where it is released."""

    name = "blade"
    key = "V"
    help = (
        "Drag on the tissue: the blade turns the way you drag and cuts what it passes, or cuts "
        "once where you release it. J, K turn it; Shift: deeper."
    )
    kind = Tool.CUT
    shapes = ("triangle", "rectangle")

    def __init__(self, person: Person, scene: PageScene) -> None:
        """Begin without a tool."""
        super().__init__(person, scene)
        self._depth = 0.6 * self.size.blade[1]
        self._turn = 0.0
        self._stands = UPRIGHT
        self._cuts = WHILE_DRAGGED
        self._along: Vec3 | None = None
        self._seen: Vec3 | None = None
        self._commands: list[viser.CommandHandle] = []

    def more(self) -> dict[str, Any]:
        """How it cuts."""
        return {"cutting": Tool.PROGRESSIVE if self._cuts == WHILE_DRAGGED else Tool.AT_USE}

    def tip_from_start(self, drag: Drag, axis: Vec3) -> Vec3:
        """The lower end is as deep below the surface as is set; a rectangle's tip is its middle."""
        up = 0.5 * self.size.blade[1] if self.size.shape == "rectangle" else 0.0
        return np.asarray((up - self._depth) * axis)

    def orientation(self, drag: Drag) -> NDArray[np.float64]:
        """The blade's plane holds the direction of the drag, turned by what is set."""
        up = drag.normal if self._stands == UPRIGHT else -drag.forward
        along = np.eye(3)[np.argmin(np.abs(up))] if self._along is None else self._along
        return standing(up, along, np.deg2rad(self._turn))

    def drag(self, drag: Drag) -> None:
        """Place the blade, turn it the way it goes, press it, and let go at the end."""
        if drag.phase == START:
            self._use(False)
            self._seen, self._along = drag.start, None
            self._place(drag, drag.start)
            return
        if self._seen is None:
            return
        place = on_tissue(self._seen, drag)
        way = place - self._seen
        wide = self.size.blade[0]
        if np.linalg.norm(way) > FIRST_WAY * wide:
            first = self._along is None
            self._along = steered(self._along, way, wide)
            if first and self._cuts == WHILE_DRAGGED:
                # It is pressed where the drag began, now that it is known which way it goes.
                self._place(drag, self._seen)
                self._use(True)
            self._seen = place
        self._place(drag, place)
        if drag.phase == END:
            if self._cuts == WHERE_RELEASED:
                self._use(True)
            self._use(False)
            self._seen = None
        self._show_gizmo()

    def settings(self, gui: viser.GuiApi) -> None:
        """Shape, size, depth, turn and the way of cutting."""
        high = self.size.organ / 2 / MM
        cuts = gui.add_dropdown("Cuts", (WHILE_DRAGGED, WHERE_RELEASED), initial_value=self._cuts)
        stands = gui.add_dropdown("Stands", (UPRIGHT, ALONG_VIEW), initial_value=self._stands)
        depth = gui.add_slider(
            "Depth [mm]", 0.0, high, high / 200, in_mm(self._depth), hint="Of its lower end"
        )
        turn = gui.add_slider(
            "Turn [deg]", -90.0, 90.0, 1.0, self._turn, hint="Against the way you drag"
        )
        self._add_controls(gui)

        def take() -> None:
            self._depth, self._turn = depth.value * MM, turn.value
            self._stands = stands.value
            if cuts.value != self._cuts:
                self._cuts = cuts.value
                self._resize()

        def turn_by(degrees: float) -> None:
            turn.value = (turn.value + degrees + 90.0) % 180.0 - 90.0
            take()

        for control in (cuts, stands, depth, turn):
            control.on_update(self.person.in_turn(take))
        for key, degrees in TURNS.items():
            command = gui.add_command(f"turn the blade by {degrees:+g} degrees", hotkey=key)
            command.on_trigger(self.person.in_turn(lambda by=degrees: turn_by(by)))
            self._commands.append(command)

    def leave(self) -> None:
        """Take the blade away."""
        for command in self._commands:
            command.remove()
        self._commands.clear()
        self._seen = None
        super().leave()

    def _place(self, drag: Drag, place: Vec3) -> None:
        """Put the blade at a place of the surface [m], shape (3,)."""
        turned = self.orientation(drag) if self._turned is None else self._turned
        axis = Rotation.from_quat(turned).as_matrix()[:, 2]
        deeper = float((drag.point - drag.start) @ drag.forward) * drag.forward
        self._ready().move(place + deeper + self.tip_from_start(drag, axis), turned)


def standing(up: Vec3, along: Vec3, turn: float) -> NDArray[np.float64]:
    """The orientation of a blade that stands on tissue.

    Args:
        up: Unit direction of its z, shape (3,).
        along: Direction that its plane holds, not along z, shape (3,).
        turn: Angle about z by which it is turned from there [rad].

    Returns:
        Quaternion x y z w, shape (4,).
    """
    x = along - (along @ up) * up
    length = float(np.linalg.norm(x))
    if length < 1e-9 * float(np.linalg.norm(along)):
        x = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
        length = float(np.linalg.norm(x))
    x = x / length
    flat = Rotation.from_matrix(np.stack([x, np.cross(up, x), up], axis=1))
    return np.asarray((flat * Rotation.from_euler("z", turn)).as_quat())


def steered(along: Vec3 | None, way: Vec3, wide: float) -> Vec3:
    """The direction of a blade that went some way: it turns within its own width.

    Args:
        along: Unit direction before, shape (3,); None: it had none.
        way: Where it went [m], shape (3,).
        wide: Its width [m].

    Returns:
        Unit direction, shape (3,), the one of both along the line that needs the smaller turn.
    """
    if along is not None:
        if way @ along < 0.0:
            way = -way
        way = way + wide * along
    return np.asarray(way / np.linalg.norm(way))


def on_tissue(last: Vec3, drag: Drag) -> Vec3:
    """Where on the tissue the pointer is now [m], shape (3,).

    Args:
        last: Where it was before [m], shape (3,).
        drag: Its hit counts unless it is much deeper or higher than before; then the pointer is as
            deep as it was.
    """
    ray = drag.point - drag.eye
    level = drag.eye + ray * (((last - drag.eye) @ drag.forward) / (ray @ drag.forward))
    if drag.hit is None:
        return np.asarray(level)
    deeper = abs(float((drag.hit - last) @ drag.forward))
    return drag.hit if deeper <= STEEPEST * float(np.linalg.norm(level - last)) else level
