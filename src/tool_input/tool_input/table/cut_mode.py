"""Cutting along a drawn line: what it will cut is shown while it is drawn."""

from __future__ import annotations

import viser
from tissue_interfaces.srv import Cut

from tool_input.table.drawn_line import DrawnLine, Ruled
from tool_input.table.marks import Marks
from tool_input.table.modes import END, START, Drag
from tool_input.table.page_scene import PageScene
from tool_input.table.person import Person
from tool_input.table.sight import Sight
from tool_input.table.tool_size import MM, in_mm

THROUGH, DEPTH = "through the wall", "to a depth"
FREE, STRAIGHT = "as drawn", "straight"
METHODS = ("split", "subdivide", "remove")
"""How `tissue/cut` can cut, see docs/cutting.md."""

SPACING = 0.5
"""Distance of the line's points in mean edges of the surface: closer ones would cut no better."""


class CutMode:
    """Cuts along a line drawn on the tissue, as deep along the view as is set."""

    name = "cut"
    key = "C"
    help = (
        "Draw a line on the tissue: it is cut along your view, through the wall or to a depth. To "
        "cut a piece off, draw from edge to edge or all around it. Without *Cut when drawn* a blue "
        "sheet shows first what would be cut: turn the view to see it, best as wireframe."
    )

    def __init__(self, person: Person, scene: PageScene) -> None:
        """Begin without a line."""
        self._person = person
        self._scene = scene
        self._marks = Marks(scene, "/cut_line")
        self._line: DrawnLine | None = None
        self._ended = False
        self._reach = THROUGH
        self._depth = 0.1 * scene.organ_size
        self._course = FREE
        self._method = METHODS[0]
        self._at_once = True

    def drag(self, drag: Drag) -> None:
        """Draw the line; cut along it at its end, or wait to be told."""
        if drag.phase == START:
            self._ended = False
            spacing = SPACING * self._sight().edge
            self._line = DrawnLine(drag.eye, drag.forward, drag.start, spacing)
            return
        if self._line is None or self._ended:
            return
        if self._course == STRAIGHT:
            self._line.straighten(drag.point)
        else:
            self._line.draw(drag.point)
        self._ended = drag.phase == END
        if self._ended and self._at_once:
            self._cut()
        else:
            self._preview()

    def settings(self, gui: viser.GuiApi) -> None:
        """How deep and how straight, and whether to cut at once."""
        most = self._scene.organ_size / MM
        reach = gui.add_dropdown("Reach", (THROUGH, DEPTH), initial_value=self._reach)
        depth = gui.add_slider(
            "Depth [mm]", most / 200, most, most / 200, in_mm(self._depth),
            visible=self._reach == DEPTH, hint="Along the view, from the surface",
        )  # fmt: skip
        course = gui.add_dropdown("Line", (FREE, STRAIGHT), initial_value=self._course)
        method = gui.add_dropdown(
            "Method", METHODS, initial_value=self._method,
            hint="Split along faces, divide elements, or take them out",
        )  # fmt: skip
        at_once = gui.add_checkbox(
            "Cut when drawn", self._at_once, hint="Otherwise the sheet stays until you press Cut"
        )
        buttons = gui.add_button_group("Line drawn", ("Cut", "Discard"), visible=not self._at_once)

        def take() -> None:
            self._reach, self._depth = reach.value, depth.value * MM
            self._course, self._method, self._at_once = course.value, method.value, at_once.value
            depth.visible, buttons.visible = self._reach == DEPTH, not self._at_once
            self._preview()

        for control in (reach, depth, course, method, at_once):
            control.on_update(self._person.in_turn(take))
        buttons.on_click(
            self._person.in_turn(lambda: self._cut() if buttons.value == "Cut" else self.leave())
        )

    def leave(self) -> None:
        """Forget the line."""
        self._line = None
        self._marks.clear()

    def _sight(self) -> Sight:
        frame = self._person.desk.frame()
        if frame is None:
            raise ValueError("there is no tissue yet; wait for the simulation")
        return Sight.of(frame)

    def _sheet(self) -> Ruled:
        if self._line is None:
            raise ValueError("there is no line; draw one on the tissue")
        depth = self._depth if self._reach == DEPTH else None
        return self._line.sheet(self._sight(), depth, self._ended)

    def _preview(self) -> None:
        """Show what would be cut, once there is enough of a line."""
        try:
            sheet = self._sheet()
        except ValueError:
            self._marks.clear()
            return
        self._marks.sheet("sheet", sheet.vertices, sheet.triangles)
        self._marks.line("line", sheet.near)

    def _cut(self) -> None:
        try:
            sheet = self._sheet()
        finally:
            self.leave()
        request = Cut.Request(method=self._method)
        request.sweep.header.frame_id = self._person.desk.frame_id
        request.sweep.vertices = sheet.vertices.ravel().tolist()
        request.sweep.triangles = sheet.triangles.ravel().tolist()
        self._person.request("cut", request, self._done)

    def _done(self, answer: Cut.Response) -> None:
        report = answer.report
        self._person.tell(
            f"Cut: {report.faces_split} faces opened, the organ is in "
            f"{report.components} part{'s' if report.components != 1 else ''}."
        )
