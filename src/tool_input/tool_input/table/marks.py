"""What a mode draws in its person's window beside the tissue: lines, sheets and dots."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tool_input.table.page_scene import PageScene

Rgb = tuple[int, int, int]

WHITE: Rgb = (255, 255, 255)
SHEET: Rgb = (90, 170, 255)
RISK: Rgb = (255, 190, 40)
DOT_SIZE = 0.012
"""Of dots, in the page's units."""


class Marks:
    """The marks of one mode in one window, each by a name of its own."""

    def __init__(self, scene: PageScene, folder: str) -> None:
        """Begin without marks.

        Args:
            scene: The window's scene.
            folder: Name of the scene's node that they belong to, such as "/cut".
        """
        self._scene = scene
        self._folder = folder
        self._nodes: dict[str, Any] = {}

    def line(self, name: str, points: NDArray[np.float64], color: Rgb = WHITE) -> None:
        """Draw a line.

        Args:
            name: Its name; a line of that name is replaced.
            points: Along it [m], shape (n, 3), n at least 2.
            color: Of it.
        """
        page = self._scene.to_page(points)
        self._nodes[name] = self._scene.api.add_line_segments(
            f"{self._folder}/{name}", np.stack([page[:-1], page[1:]], axis=1),
            colors=color, thickness=3.0, thickness_units="screen",
        )  # fmt: skip

    def sheet(
        self, name: str, vertices: NDArray[np.float64], triangles: NDArray[np.integer]
    ) -> None:
        """Draw a surface that the tissue shows through.

        Args:
            name: Its name; a sheet of that name is replaced.
            vertices: Its corners [m], shape (n, 3).
            triangles: Rows of `vertices`, shape (m, 3).
        """
        self._nodes[name] = self._scene.api.add_mesh_simple(
            f"{self._folder}/{name}", self._scene.to_page(vertices), triangles.astype(np.uint32),
            color=SHEET, opacity=0.45, side="double", flat_shading=True,
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def dots(self, name: str, points: NDArray[np.floating], color: Rgb = WHITE) -> None:
        """Draw dots.

        Args:
            name: Their name; dots of that name are replaced.
            points: Where [m], shape (n, 3).
            color: Of them.
        """
        self._nodes[name] = self._scene.api.add_point_cloud(
            f"{self._folder}/{name}", self._scene.to_page(points), colors=color,
            point_size=DOT_SIZE, point_shape="circle",
        )  # fmt: skip

    def remove(self, name: str) -> None:
        """Draw this one no more, if it is there."""
        node = self._nodes.pop(name, None)
        if node is not None:
            node.remove()

    def clear(self) -> None:
        """Draw none of them any more."""
        for name in list(self._nodes):
            self.remove(name)
