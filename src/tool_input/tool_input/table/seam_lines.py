"""Sutures and the edges of named holes, as lines on the tissue."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from tissue_sim.geometry.holes import HoleLostError
from tool_input.table.page_scene import PageScene
from tool_input.table.surface_parts import Color, lifted
from tool_input.table.tissue_frame import TissueFrame

THREAD: Color = (244, 236, 205)
EDGE: Color = (255, 196, 0)
THICKNESS = 3.0
"""[pixels]"""

LIFT = 0.002
"""How far over the tissue threads are, as a share of the organ's extent."""


def thread_segments(frame: TissueFrame, lift: float) -> NDArray[np.float32]:
    """Both ends of every stitch [m], shape (n, 2, 3).

    Args:
        frame: The tissue.
        lift: How far over its surface they are [m].
    """
    nodes = frame.mesh.sutures.nodes
    if not len(nodes):
        return np.empty((0, 2, 3), dtype=np.float32)
    segments: NDArray[np.float32] = lifted(frame.surface, frame.positions, lift)[nodes]
    return segments


def hole_segments(frame: TissueFrame) -> NDArray[np.float32]:
    """Both ends of each piece of the holes' edges [m], shape (n, 2, 3); without lost holes."""
    pieces = [np.empty((0, 2, 3), dtype=np.float32)]
    for hole in frame.holes:
        try:
            loop = hole.loop(frame.mesh, frame.positions)
        except HoleLostError:
            continue
        pieces.append(np.stack([loop, np.roll(loop, -1, axis=0)], axis=1).astype(np.float32))
    return np.concatenate(pieces)


class SeamLines:
    """Draws them in one window."""

    def __init__(self, scene: PageScene) -> None:
        """Begin without lines, in the window's scene."""
        self._scene = scene
        self._lines: dict[str, viser.LineSegmentsHandle] = {}

    def show(self, frame: TissueFrame) -> None:
        """Draw the sutures and holes of a frame."""
        threads = thread_segments(frame, LIFT * self._scene.organ_size)
        self._draw("/sutures", threads, THREAD)
        self._draw("/holes", hole_segments(frame), EDGE)

    def _draw(self, name: str, segments: NDArray[np.float32], color: Color) -> None:
        line = self._lines.get(name)
        if not len(segments):
            if line is not None:
                self._lines.pop(name).remove()
            return
        points = self._scene.to_page(segments)
        if line is not None:
            line.points = points
        else:
            self._lines[name] = self._scene.api.add_line_segments(
                name, points, colors=color, thickness=THICKNESS, thickness_units="screen"
            )
