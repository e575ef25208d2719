"""Drags on the organ in one window, from viser's events to what a mode is told."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tool_input.table.modes import END, MOVE, START, Drag
from tool_input.table.page_scene import PageScene
from tool_input.table.pointer import MODIFIER_PAUSE, DragPath, Eye
from tool_input.table.sight import Sight
from tool_input.table.tissue_frame import TissueFrame

DEPTH_MODIFIER = "shift"


class DragInput:
    """Joins viser's events to drags: one START, MOVEs and one END each.

    viser ends a drag and begins another when Shift is pressed or let go. Such a pair goes on as the
    same drag, so an END waits for `MODIFIER_PAUSE`: `expire` is called again and again.
    """

    def __init__(
        self,
        scene: PageScene,
        tell: Callable[[Drag], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin without a drag.

        Args:
            scene: The window's scene, which knows the page's units.
            tell: Called with every event.
            clock: Seconds.
        """
        self._scene = scene
        self._tell = tell
        self._clock = clock
        self._path: DragPath | None = None
        self._sight: Sight | None = None
        self._frame: TissueFrame | None = None
        self._ended: float | None = None
        self._begun_at: tuple[float, ...] = ()
        self._in_depth = False

    @property
    def dragging(self) -> bool:
        """Whether a drag goes on."""
        return self._path is not None

    def see(self, frame: TissueFrame) -> None:
        """The tissue has another shape now."""
        self._frame, self._sight = frame, None

    def take(self, event: Any, eye: Eye) -> None:
        """An event of viser's (`viser.SceneNodeDragEvent`).

        Args:
            event: The event.
            eye: The window's camera.
        """
        in_depth = event.modifier == DEPTH_MODIFIER
        pointer = self._scene.to_organ(event.end_position)
        if event.phase == "start":
            self._begin(event, eye, in_depth)
        if self._path is None:
            return
        self._in_depth = in_depth
        self._path.follow(pointer, in_depth)
        self._say(MOVE)
        if event.phase == "end":
            self._ended = self._clock()

    def expire(self) -> None:
        """End the drag whose end has not been taken back."""
        if self._ended is not None and self._clock() - self._ended > MODIFIER_PAUSE:
            self.end()

    def end(self) -> None:
        """End the drag, if there is one."""
        if self._path is not None:
            self._say(END)
        self._path = self._ended = None

    def forget(self) -> None:
        """Drop the drag, if there is one, without an END: its mode is left."""
        self._path = self._ended = None

    def _begin(self, event: Any, eye: Eye, in_depth: bool) -> None:
        at = tuple(float(value) for value in event.start_position)
        same_place = self._path is not None and np.allclose(at, self._begun_at, atol=1e-4)
        if self._ended is not None and same_place and in_depth != self._in_depth:
            self._ended = None
            return
        self.end()
        start = self._scene.to_organ(at)
        hit = self._hit(eye.position, start - eye.position)
        self._begun_at = at
        self._path = DragPath(start, eye, hit[1] if hit is not None else None)
        self._in_depth = in_depth
        self._say(START)

    def _say(self, phase: str) -> None:
        path = self._path
        assert path is not None
        hit = self._hit(path.eye.position, path.point - path.eye.position)
        self._tell(
            Drag(
                phase=phase,
                start=path.start,
                point=path.start if phase == START else path.point,
                eye=path.eye.position,
                forward=path.eye.forward,
                hit=None if hit is None else hit[0],
                normal=path.normal,
            )
        )

    def _hit(
        self, origin: NDArray[np.float64], way: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        if self._frame is None:
            return None
        if self._sight is None:
            self._sight = Sight.of(self._frame)
        hit = self._sight.hit(origin, way / np.linalg.norm(way))
        return None if hit is None else (hit.point, hit.normal)
