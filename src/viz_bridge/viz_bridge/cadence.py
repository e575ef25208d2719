"""Rate, gaps and late frames of a stream of states, seen from outside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BLOCK = 300
"""Frames over which the grid of deadlines is taken as fixed: clocks drift."""

EARLY = 0.1
"""Share of a period by which a frame may begin before its deadline as estimated."""


@dataclass(frozen=True)
class Cadence:
    """What a subscriber saw of one epoch.

    Attributes:
        frames: States received.
        lost: Frame numbers that never arrived.
        hz: Frames published a second, on average.
        late: Frames published more than half a period after their deadline, and deadlines skipped.
        skipped: Deadlines without a frame.
        seconds: From the first to the last frame.
    """

    frames: int
    lost: int
    hz: float
    late: int
    skipped: int
    seconds: float


def cadence(
    frames: NDArray[np.int64],
    stamps: NDArray[np.int64],
    published: NDArray[np.int64],
    rate_hz: float,
) -> Cadence:
    """Judge the states of one epoch.

    Deadlines lie on a grid that is known only through the stamps: almost every frame begins at its
    deadline, so the grid is where most stamps lie.

    Args:
        frames: Frame numbers, ascending, shape (n,).
        stamps: Times at the start of the frames [ns].
        published: Times of publishing [ns].
        rate_hz: Frames a second that are due.
    """
    count = len(frames)
    if count < 2:
        return Cadence(count, 0, 0.0, 0, 0, 0.0)
    seconds = (stamps[-1] - stamps[0]) / 1e9
    span = int(frames[-1] - frames[0])
    lost = span + 1 - count
    period = 1e9 / rate_hz
    # Relative to the first stamp: floats keep nanoseconds for days.
    begun = (stamps - stamps[0]).astype(np.float64)
    taken = (published - stamps[0]).astype(np.float64)
    slots = np.empty(count, dtype=np.int64)
    late = np.zeros(count, dtype=np.bool_)
    phase = 0.0
    for first in range(0, count, BLOCK):
        block = slice(first, first + BLOCK)
        near = _phase(begun[block], period)
        # The grid drifts on from where it was: it never jumps by a period.
        phase = near + np.round((phase - near) / period) * period if first else near
        slots[block] = np.floor((begun[block] - phase) / period + EARLY)
        deadlines = phase + slots[block] * period
        late[block] = taken[block] - deadlines > 0.5 * period
    steps = np.diff(slots)
    skipped = int(np.maximum(steps - np.diff(frames), 0).sum())
    hz = float(span / seconds) if seconds > 0 else 0.0
    return Cadence(count, lost, hz, int(late.sum()) + skipped, skipped, float(seconds))


def _phase(times: NDArray[np.float64], period: float) -> float:
    turns = times / period
    angles = 2 * np.pi * (turns - np.floor(turns))
    centre = np.angle(np.exp(1j * angles).mean())
    # The median of what lies about the mean direction: late beginnings pull the mean.
    offsets = np.angle(np.exp(1j * (angles - centre)))
    return float((centre + np.median(offsets)) / (2 * np.pi) * period)


class LatencyMeter:
    """Pose to state: receipt of the first state that carries a pose's stamp, minus that stamp."""

    def __init__(self) -> None:
        self._newest: dict[str, int] = {}
        self.milliseconds: list[float] = []

    def take(self, tool: str, stamp: int, received: int) -> None:
        """Take one tool of a state.

        Args:
            tool: Its id.
            stamp: Stamp of the pose applied [ns]; 0: none.
            received: Receipt of the state [ns].
        """
        if stamp and self._newest.get(tool) != stamp:
            # The first state after a start carries a pose of unknown age.
            if tool in self._newest:
                self.milliseconds.append((received - stamp) / 1e6)
            self._newest[tool] = stamp

    def quantiles(self) -> dict[str, float]:
        """p50, p99 and max [ms], and the number of poses; empty without poses."""
        if not self.milliseconds:
            return {}
        p50, p99 = np.quantile(self.milliseconds, [0.5, 0.99])
        return {
            "p50": float(p50),
            "p99": float(p99),
            "max": float(max(self.milliseconds)),
            "poses": len(self.milliseconds),
        }
