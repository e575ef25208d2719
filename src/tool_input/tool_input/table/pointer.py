"""From the pointer in a window to a drag on the tissue, in all three directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MODIFIER_PAUSE = 0.25
"""[s] A drag that goes on within this time with Shift pressed or let go is the same drag: viser
ends it and begins another a tenth of a second later."""

NEAREST = 0.1
"""A drag comes no nearer to the eye than this share of the distance it began at."""


@dataclass(frozen=True)
class Eye:
    """A camera.

    Attributes:
        position: Where it is [m], shape (3,).
        forward: Unit direction it looks in, shape (3,).
        up: Unit direction that is up in the window, shape (3,).
    """

    position: NDArray[np.float64]
    forward: NDArray[np.float64]
    up: NDArray[np.float64]


class DragPath:
    """Where a drag has come to.

    The pointer moves in the plane through the drag's start that faces the eye. With Shift its way
    up the window is a way into it. The point dragged stays under the pointer until Shift is used;
    from then on the pointer's ways count, not its places.

    Attributes:
        start: Where on the tissue it began [m], shape (3,).
        eye: The camera; it rests during a drag.
        normal: Outward unit normal of the tissue there, shape (3,).
    """

    def __init__(
        self, start: NDArray[np.float64], eye: Eye, normal: NDArray[np.float64] | None = None
    ) -> None:
        """Begin a drag."""
        self.start = start
        self.eye = eye
        self.normal = -eye.forward if normal is None else normal
        self._pointer = start
        self._slipped = np.zeros(3)
        self._depth = 0.0
        self._distance = max(float((start - eye.position) @ eye.forward), 1e-9)

    @property
    def sight(self) -> NDArray[np.float64]:
        """Unit direction from the eye to the point, shape (3,)."""
        way = self.point - self.eye.position
        return np.asarray(way / np.linalg.norm(way))

    @property
    def point(self) -> NDArray[np.float64]:
        """Where the drag has come to [m], shape (3,)."""
        plane = self._pointer - self._slipped - self.eye.position
        return np.asarray(self.eye.position + plane * (1.0 + self._depth / self._distance))

    def follow(self, pointer: NDArray[np.float64], in_depth: bool) -> None:
        """The pointer has moved.

        Args:
            pointer: Where it is in the plane through the start that faces the eye [m], shape (3,).
            in_depth: Whether Shift was pressed on the way.
        """
        way = pointer - self._pointer
        self._pointer = pointer
        if in_depth:
            self._slipped = self._slipped + way
            nearest = (NEAREST - 1.0) * self._distance
            self._depth = max(self._depth + float(way @ self.eye.up), nearest)
