"""Handles in the scene that move and turn a tool in all six degrees of freedom."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from tool_input.motion import Pose
from tool_input.table.page_scene import PageScene
from tool_input.table.person import Person

SIZE = 0.35
"""Length of the handles in the page's units: a sixth of the organ."""


class Gizmo:
    """Three arrows, three planes and three rings at a tool's tip."""

    def __init__(
        self,
        person: Person,
        scene: PageScene,
        name: str,
        pose: Pose,
        moved: Callable[[Pose], None],
    ) -> None:
        """Show the handles.

        Args:
            person: Whose they are.
            scene: The scene of their window.
            name: Name of the scene's node.
            pose: Where they are at first.
            moved: Called with each pose that they are dragged to.
        """
        self._scene = scene
        self._moved = moved
        self._dragged = False
        self._handles: viser.TransformControlsHandle = scene.api.add_transform_controls(
            name, scale=SIZE, line_width=4.0, depth_test=False
        )
        self._handles.on_update(person.in_turn(self._on_update))
        self.follow(pose)

    def follow(self, pose: Pose) -> None:
        """Be at a pose, unless they are being dragged."""
        if self._dragged:
            return
        x, y, z, w = (float(value) for value in pose.quaternion)
        self._handles.position = _triple(self._scene.to_page(pose.position))
        self._handles.wxyz = (w, x, y, z)

    def remove(self) -> None:
        """Show them no more."""
        self._handles.remove()

    def _on_update(self, event: Any) -> None:
        self._dragged = event.phase != "end"
        w, x, y, z = (float(value) for value in event.target.wxyz)
        quaternion = np.array([x, y, z, w])
        position = self._scene.to_organ(event.target.position)
        self._moved(Pose(position, quaternion / np.linalg.norm(quaternion)))


def _triple(point: NDArray[np.floating]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in point)
    return x, y, z
