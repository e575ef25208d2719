"""What colours mean: the range of a quantity, the bands it is cut into, and their colours."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tool_input.table.surface_parts import Color
from viz_bridge.difference_colors import UNKNOWN, map_colors, scale_top
from viz_bridge.picture_grid import COLORS

__all__ = ["BANDS", "UNKNOWN", "AutoScale", "Scale", "band_colors"]

BANDS = 10
EVEN_MAP, EVEN_STEPS = "magma_r", 13
"""Colour map of quantities: equal steps look equal, also to those who confuse red and green. Of so
many steps the first `BANDS` are used: on a dark page the darkest would not be seen."""

DIFFERENCE = "difference"
SHARE = 0.995
"""Share of the nodes whose values the range has room for: one node at a hold does not set it."""

LEAST_SHARE = 0.05
"""Values on one side of zero that reach less of the range than this share do not extend it."""

LEAST_TOPS = {"m": 1e-4, "Pa": 100.0, "": 1e-3}
"""A range ends no lower, by unit: tissue at rest shall look at rest, not like its last bits."""

SHRINK_AFTER = 3.0
"""The range shrinks when a smaller one has done for so long [s]."""


@dataclass(frozen=True)
class Scale:
    """The range of a quantity, in its own unit.

    Attributes:
        low: Where the lowest band begins; lower values are in it too.
        high: Where the highest band ends; higher values are in it too.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        """Check.

        Raises:
            ValueError: It has no extent, or is not finite.
        """
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(
                f"a range needs two numbers, the lower first, not {self.low:g} and {self.high:g}"
            )

    @property
    def levels(self) -> NDArray[np.float64]:
        """Values between successive bands, shape (BANDS - 1,)."""
        return np.linspace(self.low, self.high, BANDS + 1)[1:-1]

    @classmethod
    def around(cls, values: NDArray[np.floating], least: float = 0.0) -> Scale:
        """A range with round ends that begins or ends at zero, or has it in its middle.

        Args:
            values: What has to be seen on it; nan: unknown.
            least: It reaches at least so far from zero.
        """
        known = values[np.isfinite(values)]
        if not len(known):
            return cls(0.0, scale_top(least))
        low, high = np.quantile(known, [1.0 - SHARE, SHARE])
        top = scale_top(max(-low, high, least))
        below, above = low < -LEAST_SHARE * top, high > LEAST_SHARE * top
        return cls(-top if below else 0.0, top if above or not below else 0.0)

    def holds(self, other: Scale) -> bool:
        """Whether another range lies within this one."""
        return self.low <= other.low and other.high <= self.high


class AutoScale:
    """A range that follows the values: it grows at once, and shrinks after a while."""

    def __init__(self, least: float = 0.0, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without one.

        Args:
            least: It reaches at least so far from zero.
            clock: Seconds.
        """
        self._least = least
        self._clock = clock
        self._scale: Scale | None = None
        self._larger_needed = 0.0

    def follow(self, values: NDArray[np.floating]) -> Scale:
        """The range for some values [in their unit]; nan: unknown."""
        now, wanted = self._clock(), Scale.around(values, self._least)
        scale = self._scale
        if scale is None or not scale.holds(wanted):
            both = wanted if scale is None else _joined(scale, wanted)
            self._scale, self._larger_needed = both, now
        elif scale == wanted:
            self._larger_needed = now
        elif now - self._larger_needed > SHRINK_AFTER:
            self._scale, self._larger_needed = wanted, now
        assert self._scale is not None
        return self._scale


def _joined(one: Scale, other: Scale) -> Scale:
    low, high = min(one.low, other.low), max(one.high, other.high)
    if low < 0.0 < high:
        high = max(-low, high)
        low = -high
    return Scale(low, high)


def band_colors(quantity: str) -> tuple[Color, ...]:
    """Colours of the bands, that of the lowest values first.

    Args:
        quantity: What is shown; the difference of two models has the colours it has in pictures.
    """
    steps = (COLORS, BANDS) if quantity == DIFFERENCE else (EVEN_MAP, EVEN_STEPS)
    colors = map_colors(*steps)[:BANDS]
    return tuple((int(red), int(green), int(blue)) for red, green, blue in colors)
