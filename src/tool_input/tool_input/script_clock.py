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

    Where the simulation is slower than real time, so is the procedure. It stands still while
    somebody else has paused the simulation and goes on over a reset. A pause of the procedure's own
    would never end so: it is as long as the procedure says in real seconds.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._epoch = b""
        self._sim_time = 0.0
        self._passed = 0.0
        self._frame_seconds = 0.0
        self._heard = time.monotonic()
        self._paused_at: float | None = None

    def start(self) -> None:
        """Time 0 is the newest frame."""
        with self._lock:
            self._passed = 0.0
            self._heard = time.monotonic()

    def pause(self, paused: bool) -> None:
        """Go by real seconds as long as the procedure has paused the simulation."""
        passed = self.now()
        with self._lock:
            self._passed, self._frame_seconds = passed, 0.0
            self._paused_at = time.monotonic() if paused else None

    def hear(self, message: Journal) -> None:
        """Take the time of a frame."""
        with self._lock:
            epoch = bytes(message.epoch)
            if epoch == self._epoch and self._paused_at is None:
                self._frame_seconds = max(0.0, message.sim_time - self._sim_time)
                self._passed += self._frame_seconds
            self._epoch = epoch
            self._sim_time = message.sim_time
            self._heard = time.monotonic()

    def now(self) -> float:
        """Seconds of the organ's time since the start, carried on smoothly between frames."""
        with self._lock:
            now = time.monotonic()
            if self._paused_at is not None:
                return self._passed + now - self._paused_at
            return self._passed + min(now - self._heard, self._frame_seconds, LONGEST_GUESS)

    def silence(self) -> float:
        """Seconds since the last frame."""
        with self._lock:
            return time.monotonic() - self._heard
