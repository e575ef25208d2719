"""The risk regions as dots on the tissue."""

from __future__ import annotations

import viser

from tool_input.table.marks import DOT_SIZE, RISK
from tool_input.table.page_scene import PageScene
from tool_input.table.tissue_frame import TissueFrame


class RiskDots:
    """Draws the nodes of all risk regions in one window, whatever the view."""

    def __init__(self, scene: PageScene) -> None:
        """Begin without dots, in the window's scene."""
        self._scene = scene
        self._dots: viser.PointCloudHandle | None = None

    def show(self, frame: TissueFrame) -> None:
        """Draw the regions of a frame."""
        points = self._scene.to_page(frame.positions[frame.risk_rows])
        if self._dots is not None and len(points) == len(self._dots.points):
            self._dots.points = points
            return
        if self._dots is not None:
            self._dots.remove()
            self._dots = None
        if len(points):
            self._dots = self._scene.api.add_point_cloud(
                "/risk_regions", points, colors=RISK, point_size=DOT_SIZE, point_shape="circle"
            )
