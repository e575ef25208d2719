"""Patches: a drag lays one on the tissue; its rim is sewn to a hole, whose edge can be drawn."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray
from tissue_interfaces.srv import AddPatch, Closure, Suture

from tool_input.table.marks import Marks
from tool_input.table.modes import END, START, Drag, Vec3
from tool_input.table.page_scene import PageScene
from tool_input.table.patch_outline import ELLIPSE, RECTANGLE, outline
from tool_input.table.person import Person
from tool_input.table.sew_mode import counted, spread
from tool_input.table.sight import Sight
from tool_input.table.tool_size import MM, in_mm

HOLE = "edge of a hole"
CLOSEST = "closest tissue"
EDGE_POINTS = 60
"""Of a hole's edge in a request."""


class PatchMode:
    """Lays patches, names holes and sews the one into the other."""

    name = "patch"
    key = "N"
    help = (
        "Drag from one side of a hole to the other: a patch as long as that is laid there; sew its "
        "rim. Choose *edge of a hole* and draw all around a hole to name it: how far it is closed "
        "is then told."
    )

    def __init__(self, person: Person, scene: PageScene) -> None:
        """Begin without a patch."""
        self._person = person
        self._marks = Marks(scene, "/patch")
        self._shape = ELLIPSE
        self._width = 1.0
        self._thickness = 1e-3
        self._modulus = 2e5
        self._spacing = 0.04 * scene.organ_size
        self._hole, self._new_hole = CLOSEST, "hole"
        self._line: list[Vec3] | None = None
        self._normal = np.zeros(3)
        self._sight: Sight | None = None
        self._last = 0
        self._offer: viser.GuiDropdownHandle[str] | None = None

    def drag(self, drag: Drag) -> None:
        """Lay the patch from where the drag begins to where it ends, or take its way as an edge."""
        if drag.phase == START:
            self._line, self._normal = [drag.start], drag.normal
            frame = self._person.desk.frame()
            self._sight = None if frame is None else Sight.of(frame)
        if self._line is None or self._sight is None:
            return
        if drag.hit is not None:
            self._line.append(drag.hit)
        try:
            corners = np.array(self._line) if self._shape == HOLE else self._outline(drag)
        except ValueError:
            if drag.phase != END:
                return
            self._forget()
            raise
        if drag.phase == END:
            self._forget()
            if self._shape == HOLE:
                self._name_hole(corners)
            else:
                self._lay(corners)
        else:
            self._marks.line("outline", np.concatenate([corners, corners[:1]]))

    def settings(self, gui: viser.GuiApi) -> None:
        """Shape and material of a patch, and how it is sewn in."""
        shape = gui.add_dropdown("Draw", (ELLIPSE, RECTANGLE, HOLE), initial_value=self._shape)
        width = gui.add_slider("Width / length", 0.2, 3.0, 0.05, self._width)
        thickness = gui.add_number("Thickness [mm]", in_mm(self._thickness), min=0.05, step=0.05)
        modulus = gui.add_number("Stiffness [kPa]", self._modulus / 1e3, min=1.0, step=10.0)
        new_hole = gui.add_text("Name of the hole", self._new_hole)
        offered = self._holes()
        if self._hole not in offered:
            self._hole = CLOSEST
        holes = gui.add_dropdown("Sew to", offered, initial_value=self._hole)
        most = 5.0 * in_mm(self._spacing)
        spacing = gui.add_slider("Spacing [mm]", most / 100, most, most / 100, in_mm(self._spacing))
        sew = gui.add_button("Sew rim", hint="Of the patch you laid last")

        def take() -> None:
            self._shape, self._width = shape.value, width.value
            self._thickness, self._modulus = thickness.value * MM, modulus.value * 1e3
            self._new_hole, self._hole = new_hole.value, holes.value
            self._spacing = spacing.value * MM
            new_hole.visible = self._shape == HOLE
            width.visible = thickness.visible = modulus.visible = self._shape != HOLE

        for control in (shape, width, thickness, modulus, new_hole, holes, spacing):
            control.on_update(self._person.in_turn(take))
        sew.on_click(self._person.in_turn(self._sew_rim))
        self._offer = holes
        take()

    def leave(self) -> None:
        """Forget what was drawn."""
        self._forget()
        self._offer = None

    def _forget(self) -> None:
        self._line = self._sight = None
        self._marks.clear()

    def _holes(self) -> tuple[str, ...]:
        heard = self._person.desk.holes
        return (CLOSEST, *(hole.name for hole in heard.holes)) if heard is not None else (CLOSEST,)

    def _outline(self, drag: Drag) -> NDArray[np.float64]:
        """Corners of the patch as far as it has been dragged [m], shape (n, 3)."""
        assert self._sight is not None
        ray = drag.point - drag.eye
        hit = self._sight.hit(drag.eye, ray / np.linalg.norm(ray))
        end, normal = drag.point, self._normal
        if hit is not None:
            end, normal = hit.point, normal + hit.normal
        return outline(
            self._shape, drag.start, end, normal, self._width, self._sight.positions,
            0.5 * self._thickness,
        )  # fmt: skip

    def _lay(self, corners: NDArray[np.float64]) -> None:
        request = AddPatch.Request(
            corners=corners.ravel().tolist(), thickness=self._thickness, young_modulus=self._modulus
        )
        request.header.frame_id = self._person.desk.frame_id
        self._person.request("add_patch", request, self._laid)

    def _laid(self, answer: AddPatch.Response) -> None:
        self._last = int(answer.patch_id)
        self._person.tell(
            f"Laid {answer.patch_name}: {1e4 * answer.area:.2g} cm2. Move it with grab, or sew its "
            "rim."
        )

    def _name_hole(self, line: NDArray[np.float64]) -> None:
        edge = spread(np.concatenate([line, line[:1]]), EDGE_POINTS + 1)[:-1]
        request = Closure.Request(name=self._new_hole, positions=edge.ravel().tolist())
        request.header.frame_id = self._person.desk.frame_id
        self._person.request("closure", request, self._named)

    def _named(self, answer: Closure.Response) -> None:
        for hole in answer.holes:
            if self._offer is not None:
                self._offer.options = tuple(dict.fromkeys([*self._holes(), hole.name]))
                self._offer.value = hole.name
            self._person.tell(
                f"{hole.name}: {1e4 * hole.area:.2g} cm2, {hole.covered:.0%} of it closed."
            )

    def _sew_rim(self) -> None:
        request = Suture.Request(
            action=Suture.Request.SEW_RIM, patch=self._own_patch(), spacing=self._spacing,
            hole="" if self._hole == CLOSEST else self._hole, running=True, length=0.0,
        )  # fmt: skip
        request.header.frame_id = self._person.desk.frame_id
        self._person.request(
            "suture", request,
            lambda answer: self._person.tell(f"Sewn in: {counted(len(answer.made))}."),
        )  # fmt: skip

    def _own_patch(self) -> int:
        """The patch that this person laid last, if it is still there; 0: the only one there is."""
        mesh = self._person.desk.replica.mesh
        ids = [] if mesh is None else [patch.id for patch in mesh.patches]
        if not ids:
            raise ValueError("there is no patch; drag from one side of a hole to the other")
        return self._last if self._last in ids else 0
