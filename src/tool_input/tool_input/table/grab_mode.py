"""Grabbing: a drag holds the tissue inside a shape and pulls it along."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tissue_interfaces.msg import Tool

from tool_input.table.modes import Drag, Vec3
from tool_input.table.tool_mode import ToolMode, turned_to


class GrabMode(ToolMode):
    """Holds what is inside a sphere, a box or a line."""

    name = "grab"
    key = "Z"
    help = "Drag on the tissue to hold it and pull it in the plane of the view; Shift: in depth."
    kind = Tool.GRAB
    shapes = ("sphere", "box", "line")

    def tip_from_start(self, drag: Drag, axis: Vec3) -> Vec3:
        """The shape's middle is where the drag begins."""
        return -0.5 * self.size.length * axis if self.size.shape == "line" else np.zeros(3)

    def orientation(self, drag: Drag) -> NDArray[np.float64]:
        """Boxes stand on the tissue, lines lie on it across the view."""
        if self.size.shape == "line":
            across = np.cross(drag.normal, drag.forward)
            length = float(np.linalg.norm(across))
            if length < 1e-3:
                # Seen from straight above: any direction along the tissue will do.
                across = np.cross(drag.normal, np.eye(3)[np.argmin(np.abs(drag.normal))])
                length = float(np.linalg.norm(across))
            return turned_to(across / length)
        return turned_to(drag.normal)
