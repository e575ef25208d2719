"""Everybody's tools in one window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import viser

from tool_input.table.page_scene import PageScene
from tool_input.table.surface_parts import Color
from tool_input.table.tissue_frame import TissueFrame, ToolShown
from tool_input.table.tool_meshes import tool_mesh

COLORS: dict[str, Color] = {
    "grab": (96, 176, 255),
    "cut": (236, 240, 246),
    "burn": (255, 150, 60),
    "patch": (176, 222, 190),
    "probe": (196, 150, 255),
}
FROZEN: Color = (150, 150, 150)
UNKNOWN_KIND: Color = (255, 214, 120)
OWN, OTHERS, PRESSED = 0.45, 0.22, 0.75
"""Opacity of one's own tools, of those of others, and of those in use."""

LABEL_SIZE = 0.7


@dataclass(frozen=True)
class ToolLook:
    """What a tool's drawing depends on, besides its pose.

    Attributes:
        shape: Its shape.
        size: As in Tool.size [m].
        scale: Units of the page in a metre.
        color: Red, green, blue.
        opacity: 0 to 1.
        frozen: Whether it does not follow its hand.
        label: What is written at its tip.
    """

    shape: str
    size: tuple[float, ...]
    scale: float
    color: Color
    opacity: float
    frozen: bool
    label: str

    @classmethod
    def of(cls, tool: ToolShown, person: str, scale: float) -> ToolLook:
        """How a tool looks to somebody.

        Args:
            tool: The tool.
            person: Name of who looks.
            scale: Units of the page in a metre.
        """
        frozen = tool.state == "frozen"
        own = tool.owner == person
        color = FROZEN if frozen else COLORS.get(tool.kind, UNKNOWN_KIND)
        opacity = PRESSED if tool.pressed else OWN if own else OTHERS
        label = f"{tool.id} (frozen)" if frozen else tool.id
        return cls(tool.shape, tool.size, scale, color, opacity, frozen, label)


class _DrawnTool:
    """One tool: its mesh and its label, in a frame that has its pose."""

    def __init__(self, api: viser.SceneApi, name: str, look: ToolLook) -> None:
        self.look = look
        self._frame = api.add_frame(name, show_axes=False)
        vertices, triangles = tool_mesh(look.shape, look.size)
        api.add_mesh_simple(
            f"{name}/shape", vertices * look.scale, triangles, color=look.color,
            opacity=look.opacity, wireframe=look.frozen, side="double", flat_shading=False,
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip
        api.add_label(f"{name}/label", look.label, font_screen_scale=LABEL_SIZE)

    def place(self, tool: ToolShown, scene: PageScene) -> None:
        x, y, z = (float(value) for value in scene.to_page(tool.pose[:3]))
        qx, qy, qz, qw = (float(value) for value in tool.pose[3:])
        self._frame.position, self._frame.wxyz = (x, y, z), (qw, qx, qy, qz)

    def remove(self) -> None:
        self._frame.remove()


class ToolsView:
    """Draws all tools: one's own brighter, frozen ones grey and as wires."""

    def __init__(self, scene: PageScene, person: str) -> None:
        """Begin without tools.

        Args:
            scene: The window's scene.
            person: Name of who looks.
        """
        self._scene = scene
        self._person = person
        self._drawn: dict[str, _DrawnTool] = {}

    def show(self, frame: TissueFrame) -> None:
        """Draw the tools of a frame. One that nobody has moved yet is not drawn."""
        there = {
            name: tool
            for name, tool in frame.tools.items()
            if tool.state != "free" and np.isfinite(tool.pose).all()
        }
        for name in set(self._drawn) - set(there):
            self._drawn.pop(name).remove()
        for name, tool in there.items():
            look = ToolLook.of(tool, self._person, self._scene.placement.scale)
            known = self._drawn.get(name)
            if known is None or known.look != look:
                if known is not None:
                    known.remove()
                known = self._drawn[name] = _DrawnTool(self._scene.api, f"/tools/{name}", look)
            known.place(tool, self._scene)
