"""Shape and size of a tool, and the controls that set them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import viser
from tissue_interfaces.msg import Tool

from tool_input.table.person import Person

SHAPES = {
    "sphere": Tool.SPHERE,
    "box": Tool.BOX,
    "line": Tool.CAPSULE,
    "triangle": Tool.TRIANGLE,
    "rectangle": Tool.RECTANGLE,
}
"""What people call the shapes; a line is a capsule."""

MM = 1e-3


def in_mm(length: float) -> float:
    """A length [m] in millimetres, as a control shows it: without the last bits."""
    return round(length / MM, 6)


@dataclass
class ToolSize:
    """How large a tool is in each of its shapes [m].

    Attributes:
        organ: Largest extent of the organ.
        shape: One of `SHAPES`.
        radius: Of spheres and lines.
        length: Of a line.
        box: Edges of a box along the tool's axes.
        blade: Of a triangle or a rectangle along the tool's x, and along its z.
    """

    organ: float
    shape: str
    radius: float
    length: float
    box: tuple[float, float, float]
    blade: tuple[float, float]

    @classmethod
    def suiting(cls, organ: float, shape: str) -> ToolSize:
        """A sphere of a twenty-fifth of an organ's extent [m]; the other shapes to match."""
        r = round(organ / 25, 4) or organ / 25
        return cls(organ, shape, r, 4 * r, (2 * r, 2 * r, 2 * r), (2 * r, 4 * r))

    @property
    def of_message(self) -> tuple[str, tuple[float, ...]]:
        """What `Tool` says: shape and size."""
        sizes = {"sphere": (self.radius,), "line": (self.radius, self.length), "box": self.box}
        return SHAPES[self.shape], sizes.get(self.shape, self.blade)

    def add_controls(
        self,
        gui: viser.GuiApi,
        person: Person,
        shapes: tuple[str, ...],
        changed: Callable[[], None],
    ) -> None:
        """Add what sets them to the window.

        Args:
            gui: Where.
            person: Whose window it is.
            shapes: What can be chosen.
            changed: Called after each change.
        """
        largest = self.organ / 4 / MM
        step = least = 10.0 ** math.floor(math.log10(largest / 100))
        shape = gui.add_dropdown("Shape", shapes, initial_value=self.shape)
        radius = gui.add_slider("Radius [mm]", least, largest, step, min(self.radius / MM, largest))
        length = gui.add_slider("Length [mm]", least, 2 * largest, step, self.length / MM)
        x, y, z = (edge / MM for edge in self.box)
        box = gui.add_vector3("Edges [mm]", (x, y, z), min=(least, least, least), step=step)
        wide, high = (edge / MM for edge in self.blade)
        width = gui.add_slider("Width [mm]", least, 2 * largest, step, wide)
        height = gui.add_slider("Height [mm]", least, 2 * largest, step, high)

        def show() -> None:
            radius.visible = self.shape in ("sphere", "line")
            length.visible = self.shape == "line"
            box.visible = self.shape == "box"
            width.visible = height.visible = self.shape in ("triangle", "rectangle")

        def take() -> None:
            self.shape = shape.value
            self.radius, self.length = radius.value * MM, length.value * MM
            x, y, z = box.value
            self.box = (x * MM, y * MM, z * MM)
            self.blade = (width.value * MM, height.value * MM)
            show()
            changed()

        for control in (shape, radius, length, box, width, height):
            control.on_update(person.in_turn(take))
        show()
