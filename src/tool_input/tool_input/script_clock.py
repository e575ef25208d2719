"""Clocks a procedure is played against."""

from __future__ import annotations

import threading
import time

from tissue_interfaces.msg import Journal

LONGEST_GUESS = 0.05
"""Seconds the simulation's clock is carried on beyond the newest frame."""


class WallClock:
    """Time as people know it."""

    def __init__(self) -> None:
        self._origin = 0.0

    def start(self) -> None:
        """Time 0 is now."""
        self._origin = time.monotonic()

    def now(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._origin

    def silence(self) -> float:
        """Seconds since the clock was heard of; this one is always there."""
        return 0.0


class SimulationClock:
    """The organ's time, from the journal.

    Where the simulation is slower than real time, so is the procedure. It stands still while the
    simulation is paused and goes on over a reset.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._epoch = b""
        self._sim_time = 0.0
        self._passed = 0.0
        self._frame_seconds = 0.0
        self._heard = time.monotonic()

    def start(self) -> None:
        """Time 0 is the newest frame."""
        with self._lock:
            self._passed = 0.0
            self._heard = time.monotonic()

    def hear(self, message: Journal) -> None:
        """Take the time of a frame."""
        with self._lock:
            epoch = bytes(message.epoch)
            if epoch == self._epoch:
                self._frame_seconds = max(0.0, message.sim_time - self._sim_time)
                self._passed += self._frame_seconds
            self._epoch = epoch
            self._sim_time = message.sim_time
            self._heard = time.monotonic()

    def now(self) -> float:
        """Seconds of the organ's time since the start, carried on smoothly between frames."""
        with self._lock:
            since = time.monotonic() - self._heard
            return self._passed + min(since, self._frame_seconds, LONGEST_GUESS)

    def silence(self) -> float:
        """Seconds since the last frame."""
        with self._lock:
            return time.monotonic() - self._heard
