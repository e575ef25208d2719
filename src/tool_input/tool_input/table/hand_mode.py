"""Taking a tool that is there: one of the scene, or of a recording that was taken over."""

from __future__ import annotations

import numpy as np
import viser

from tool_input.motion import Pose
from tool_input.table.gizmo import Gizmo
from tool_input.table.modes import START, Drag
from tool_input.table.page_scene import PageScene
from tool_input.table.person import Person, TakenTool

NONE = "choose one"


class HandMode:
    """Carries a tool that is there, by drags and by handles.

    It stays the person's, where it is and in use or not, when another mode is chosen.

    Attributes:
        person: Whose window it is.
    """

    name = "hand"
    key = "T"
    help = "Takes a tool that is there and that nobody moves; drags carry it, handles turn it too."

    def __init__(self, person: Person, scene: PageScene) -> None:
        """Begin with an empty hand."""
        self.person = person
        self._scene = scene
        self._tool: TakenTool | None = None
        self._offset = np.zeros(3)
        self._gizmo: Gizmo | None = None
        self._using: viser.GuiCheckboxHandle | None = None

    def drag(self, drag: Drag) -> None:
        """Carry the tool as far as the pointer is dragged."""
        tool = self._taken
        if tool is None:
            if drag.phase == START:
                raise ValueError("choose the tool to take first")
            return
        if drag.phase == START:
            self._offset = self._pose(tool).position - drag.start
            return
        tool.move(drag.point + self._offset)
        if self._gizmo is not None:
            self._gizmo.follow(self._pose(tool))

    def settings(self, gui: viser.GuiApi) -> None:
        """Which tool, whether it is in use, and letting it be."""
        there = sorted(name for name in self.person.desk.tools if not self._is_own(name))
        chosen = NONE if self._taken is None else self._taken.id
        tool = gui.add_dropdown("Tool", (NONE, *there), initial_value=chosen)
        using = self._using = gui.add_checkbox("Pressed", False, hint="Use the tool where it is")
        leave = gui.add_button(
            "Let it be", hint="Let go of what it holds; somebody else can take it"
        )
        tool.on_update(self.person.in_turn(lambda: self._take(tool.value)))
        using.on_update(self.person.in_turn(lambda: self._press(using.value)))
        leave.on_click(self.person.in_turn(lambda: setattr(tool, "value", NONE)))
        self._show()

    def leave(self) -> None:
        """The tool stays where it is, in use or not."""
        self._using = None
        self._hide_gizmo()

    @property
    def _taken(self) -> TakenTool | None:
        """The tool in hand; None also when it has gone, with its organ or by somebody's request."""
        tool, person = self._tool, self.person
        if tool is not None and (
            tool.name not in person.tools.names or tool.id not in person.desk.tools
        ):
            self._tool = None
        return self._tool

    def _is_own(self, name: str) -> bool:
        prefix = f"{self.person.tool_prefix}_"
        made = name.removeprefix(prefix)
        return name.startswith(prefix) and made in self.person.tools.names

    def _take(self, name: str) -> None:
        before = self._taken
        if before is not None and before.id != name:
            self.person.tools.remove(before.name)
            self._tool = None
        try:
            if name != NONE:
                self._tool = self.person.tools.take(name)
        finally:
            self._show()

    def _show(self) -> None:
        """Handles and the box are those of the tool."""
        self._hide_gizmo()
        tool = self._taken
        if tool is not None:
            pose = self._pose(tool)
            self._gizmo = Gizmo(self.person, self._scene, "/handles_hand", pose, self._by_hand)
        if self._using is not None:
            self._using.value = tool is not None and tool.pressed

    def _hide_gizmo(self) -> None:
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None

    def _by_hand(self, pose: Pose) -> None:
        tool = self._taken
        if tool is not None:
            tool.move(pose.position, pose.quaternion)

    def _press(self, pressed: bool) -> None:
        tool = self._taken
        if tool is not None and tool.pressed != pressed:
            tool.use(pressed)

    def _pose(self, tool: TakenTool) -> Pose:
        """Where it is wanted, or is as long as nobody has moved it."""
        if tool.pose is not None:
            return tool.pose
        pose = self.person.desk.pose(tool.id)
        return Pose(pose[:3], pose[3:])
