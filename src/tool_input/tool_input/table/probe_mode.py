"""Probing: a drag pushes the tissue with a finger."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray
from tissue_interfaces.msg import Tool

from tool_input.table.modes import Drag, Vec3
from tool_input.table.page_scene import PageScene
from tool_input.table.person import Person
from tool_input.table.tool_mode import ToolMode, turned_to
from tool_input.table.tool_size import MM


class ProbeMode(ToolMode):
    """Pushes with a sphere, or with a line that points away from the eye."""

    name = "probe"
    key = "X"
    help = "Drag on the tissue to push it with a finger; Shift: in depth."
    kind = Tool.PROBE
    shapes = ("sphere", "line")

    def __init__(self, person: Person, scene: PageScene) -> None:
        """Begin without a tool."""
        super().__init__(person, scene)
        self._push = 0.5 * self.size.radius

    def tip_from_start(self, drag: Drag, axis: Vec3) -> Vec3:
        """The tip is as deep in the tissue as it shall push, along the view."""
        return np.asarray((self._push - self.size.radius) * drag.forward)

    def orientation(self, drag: Drag) -> NDArray[np.float64]:
        """The shaft points at the eye."""
        return turned_to(-drag.forward)

    def settings(self, gui: viser.GuiApi) -> None:
        """Those of every tool, and how deep it pushes."""
        super().settings(gui)
        most = 2 * self.size.organ / 25 / MM
        push = gui.add_slider("Push [mm]", 0.0, most, most / 100, min(self._push / MM, most))
        push.on_update(self.person.in_turn(lambda: setattr(self, "_push", push.value * MM)))
