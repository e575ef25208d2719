"""How fast a recording is played."""

from __future__ import annotations

import math

SLOWEST, FASTEST = 0.05, 20.0
"""Least and greatest rate [recorded seconds a second]."""


def checked_rate(rate: float) -> float:
    """The rate, if it is allowed.

    Raises:
        ValueError: It is not.
    """
    if not (math.isfinite(rate) and SLOWEST <= rate <= FASTEST):
        raise ValueError(f"rate {rate:g} is not allowed; allowed: {SLOWEST:g} to {FASTEST:g}")
    return rate


class PlaybackClock:
    """Counts the recorded frames that are due; ticks as often as frames were recorded.

    Attributes:
        rate: Recorded seconds a second.
        paused: Whether nothing is due.
        looping: Whether the recording begins again at its end.
    """

    def __init__(self, rate: float = 1.0, paused: bool = False, looping: bool = False) -> None:
        """Begin with nothing due.

        Raises:
            ValueError: The rate is not allowed.
        """
        self.rate, self.paused, self.looping = checked_rate(rate), paused, looping
        self._owed = 0.0

    def tick(self) -> int:
        """Whole frames that have become due since the last tick."""
        if self.paused:
            return 0
        # The small excess keeps rounding from stealing a frame where rates divide evenly.
        self._owed += self.rate + 1e-9
        frames = int(self._owed)
        self._owed -= frames
        return frames
