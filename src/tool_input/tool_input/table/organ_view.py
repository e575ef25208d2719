"""The organ in one window."""

from __future__ import annotations

import viser

from tool_input.table.page_scene import PageScene
from tool_input.table.tissue_frame import Surface, TissueFrame

TISSUE = (196, 92, 84)


class OrganView:
    """The organ's surface, deformed with every frame.

    Attributes:
        mesh_handle: What is dragged on; another one after the surface has changed.
    """

    def __init__(self, scene: PageScene) -> None:
        """Show nothing yet."""
        self.mesh_handle: viser.MeshHandle | None = None
        self._scene = scene
        self._surface: Surface | None = None

    def show(self, frame: TissueFrame) -> None:
        """Show the tissue at one frame."""
        vertices = self._scene.to_page(frame.positions[frame.surface.nodes])
        if self.mesh_handle is not None and frame.surface is self._surface:
            self.mesh_handle.vertices = vertices
            return
        self._surface = frame.surface
        self.mesh_handle = self._scene.api.add_mesh_simple(
            "/organ", vertices, frame.surface.triangles, color=TISSUE, side="double"
        )
