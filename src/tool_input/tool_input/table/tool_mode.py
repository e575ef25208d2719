"""What grabbing and probing have in common: a drag presses a tool, carries it and lets go."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from tool_input.motion import Pose
from tool_input.table.gizmo import Gizmo
from tool_input.table.modes import END, START, Drag, Vec3
from tool_input.table.page_scene import PageScene
from tool_input.table.person import UPRIGHT, Person, PersonTool
from tool_input.table.tool_size import ToolSize


class ToolMode(ABC):
    """A mode in which a drag on the tissue uses a tool; subclasses say which.

    With "keep" the tool stays pressed when the drag ends, also when another mode is chosen, and the
    next drag takes another tool: several places can be held at once.

    Attributes:
        kind: Kind of the tool.
        shapes: What shapes the person can choose.
        person: Whose window it is.
        size: Shape and size of the next tool.
    """

    name: str
    key: str
    help: str
    kind: str
    shapes: tuple[str, ...]

    def __init__(self, person: Person, scene: PageScene) -> None:
        """Begin without a tool."""
        self.person = person
        self.size = ToolSize.suiting(scene.organ_size, self.shapes[0])
        self._scene = scene
        self._tool: PersonTool | None = None
        self._offset = np.zeros(3)
        self._turned: NDArray[np.float64] | None = None
        self._keep = False
        self._gizmo: Gizmo | None = None
        self._using: viser.GuiCheckboxHandle | None = None

    # What a subclass decides

    @abstractmethod
    def tip_from_start(self, drag: Drag, axis: Vec3) -> Vec3:
        """From where a drag begins to where it puts the tool's tip [m], shape (3,).

        Args:
            drag: The start of the drag.
            axis: Unit direction of the tool's z, shape (3,).
        """

    @abstractmethod
    def orientation(self, drag: Drag) -> NDArray[np.float64]:
        """How the tool is turned, as long as nobody turned it: x y z w, shape (4,)."""

    def more(self) -> dict[str, Any]:
        """Further fields of the tool's `Tool` message."""
        return {}

    # Mode

    def drag(self, drag: Drag) -> None:
        """Press the tool where the drag begins, carry it along, and let go."""
        tool = self._ready()
        if drag.phase == START:
            self._use(False)
            quaternion = self.orientation(drag) if self._turned is None else self._turned
            self._offset = self.tip_from_start(drag, _z_axis(quaternion))
            tool.move(drag.start + self._offset, quaternion)
            self._use(True)
            return
        tool.move(drag.point + self._offset)
        self._show_gizmo()
        if drag.phase == END:
            self._finish(tool)

    def settings(self, gui: viser.GuiApi) -> None:
        """Shape, size, keeping, and the handles."""
        self._add_controls(gui)
        keep = gui.add_checkbox(
            "Keep", self._keep, hint="It stays pressed after the drag; the next drag takes another"
        )
        free = gui.add_button("Let go of all", hint="Release every tool of this kind")
        keep.on_update(self.person.in_turn(lambda: setattr(self, "_keep", keep.value)))
        free.on_click(self.person.in_turn(self._let_go_of_all))

    def leave(self) -> None:
        """Let go of what is not to be kept."""
        self._toggle_gizmo(False)
        self._using = None
        if self._tool is not None and not (self._keep and self._tool.pressed):
            self.person.tools.remove(self._tool.name)
        self._tool = None

    # How it does that

    def _add_controls(self, gui: viser.GuiApi) -> None:
        """Shape, size and handles of the tool, and whether it is pressed; it is made."""
        self.size.add_controls(gui, self.person, self.shapes, self._resize)
        using = self._using = gui.add_checkbox("Pressed", False, hint="Use the tool where it is")
        handles = gui.add_checkbox("Handles", False, hint="Move and turn the tool by handles")
        using.on_update(self.person.in_turn(lambda: self._press_here(using.value)))
        handles.on_update(self.person.in_turn(lambda: self._toggle_gizmo(handles.value)))
        self._ready()

    def _ready(self) -> PersonTool:
        """The tool of the next drag, made if need be."""
        if self._tool is None:
            shape, size = self.size.of_message
            self._tool = self.person.tools.make(
                self._free_name(), self.kind, shape, size, **self.more()
            )
        return self._tool

    def _free_name(self) -> str:
        taken = self.person.tools.names
        names = [self.name, *(f"{self.name}_{number}" for number in range(2, len(taken) + 3))]
        return next(name for name in names if name not in taken)

    def _resize(self) -> None:
        shape, size = self.size.of_message
        self._turned = None
        self._ready().change(self.kind, shape, size, **self.more())

    def _use(self, pressed: bool) -> None:
        tool = self._ready()
        if tool.pressed != pressed:
            tool.use(pressed)
        if self._using is not None and self._using.value != pressed:
            self._using.value = pressed

    def _press_here(self, pressed: bool) -> None:
        tool = self._ready()
        if tool.pressed == pressed:
            return  # The box follows the tool, and says so.
        if tool.pose is None:
            tool.move(self._scene.placement.centre, UPRIGHT)
        self._use(pressed)

    def _finish(self, tool: PersonTool) -> None:
        if not self._keep:
            self._use(False)
        elif self._gizmo is None:
            # The next drag takes another tool, which is made now: it must be heard by then.
            self._tool = None
            self._ready()
            self._use(False)

    def _let_go_of_all(self) -> None:
        for tool in self.person.tools.of_kind(self.kind):
            tool.use(False)
            if tool is not self._tool:
                self.person.tools.remove(tool.name)
        self._use(False)

    def _toggle_gizmo(self, shown: bool) -> None:
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None
        if shown:
            tool = self._ready()
            if tool.pose is None:
                tool.move(self._scene.placement.centre, UPRIGHT)
            assert tool.pose is not None
            name = f"/handles_{self.name}"
            self._gizmo = Gizmo(self.person, self._scene, name, tool.pose, self._by_hand)

    def _show_gizmo(self) -> None:
        if self._gizmo is not None and self._tool is not None and self._tool.pose is not None:
            self._gizmo.follow(self._tool.pose)

    def _by_hand(self, pose: Pose) -> None:
        self._turned = pose.quaternion
        self._ready().move(pose.position, pose.quaternion)


def _z_axis(quaternion: NDArray[np.float64]) -> Vec3:
    x, y, z, w = quaternion
    return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def turned_to(axis: Vec3) -> NDArray[np.float64]:
    """The shortest turn that takes z to a unit direction: x y z w, shape (4,)."""
    half = np.array([-axis[1], axis[0], 0.0, 1.0 + axis[2]])
    length = float(np.linalg.norm(half))
    if length < 1e-6:
        return np.array([1.0, 0.0, 0.0, 0.0])
    return half / length
