"""Where burning tools have been while they were pressed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cut_service.burning import LARGEST, SMALLEST, Touch

LONGEST_GAP = 0.25
"""Most simulated time between two states that a tool is believed to have burned through [s]."""

MOST_WAITING = 2000
"""Touches kept; the oldest ones are forgotten."""


@dataclass
class _Tool:
    radius: float
    burns: bool = False
    tip: NDArray[np.float64] | None = None
    before: NDArray[np.float64] | None = None


class BurnStrokes:
    """Turns poses, presses and simulated time into touches.

    Tools of radius 0 do not burn.
    """

    def __init__(self) -> None:
        self._tools: dict[str, _Tool] = {}
        self._epoch, self._time = b"", 0.0
        self._touches: list[Touch] = []

    def set_tools(self, radii: dict[str, float], pressed: set[str]) -> None:
        """Which tools there are.

        Args:
            radii: Radius of each [m].
            pressed: Those in use that are where their source says, and not frozen.
        """
        known = self._tools
        self._tools = {
            name: known.get(name, _Tool(radius))
            for name, radius in radii.items() if SMALLEST <= radius <= LARGEST
        }  # fmt: skip
        for name, tool in self._tools.items():
            tool.radius, tool.burns = radii[name], name in pressed

    def move(self, name: str, tip: NDArray[np.float64]) -> None:
        """The tip of a tool is there now [m], shape (3,)."""
        if name in self._tools and np.isfinite(tip).all():
            self._tools[name].tip = tip

    def advance(self, epoch: bytes, now: float) -> None:
        """Simulated time has come to `now` [s]; tools have burned along their way since."""
        seconds = now - self._time
        if epoch != self._epoch:
            self._touches.clear()
            seconds = 0.0
        self._epoch, self._time = epoch, now
        for tool in self._tools.values():
            tip = tool.tip if tool.burns else None
            if tip is not None and 0.0 < seconds <= LONGEST_GAP:
                before = tip if tool.before is None else tool.before
                self._touches += _along(before, tip, tool.radius, seconds)
            tool.before = tip
        del self._touches[:-MOST_WAITING]

    def taken(self, epoch: bytes) -> list[Touch]:
        """The touches since the last call, if they are of this epoch."""
        taken, self._touches = self._touches, []
        return taken if epoch == self._epoch else []


def _along(
    start: NDArray[np.float64], end: NDArray[np.float64], radius: float, seconds: float
) -> list[Touch]:
    """Touches on the way from one place to another, no more than half a radius apart."""
    count = min(64, max(1, int(np.ceil(2.0 * np.linalg.norm(end - start) / radius))))
    return [
        Touch(start + (k / count) * (end - start), radius, seconds / count)
        for k in range(1, count + 1)
    ]
