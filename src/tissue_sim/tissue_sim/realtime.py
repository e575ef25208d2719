"""Absolute deadlines, and what came of them."""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SWITCH_INTERVAL = 0.0001
"""How long another thread may keep Python from the loop thread [s]."""

WAKE_MARGIN = 0.0002
"""Sleeping ends so long before the deadline; the rest is spent polling [s]."""


def prepare_process() -> None:
    """Make Python's own pauses short: hand over quickly, and do not collect what lives for ever."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.collect()
    gc.freeze()
    gc.disable()


def take_priority(priority: int, everywhere: bool = False) -> str:
    """Let the calling thread, and threads it starts from now on, go before ordinary ones.

    Args:
        priority: SCHED_FIFO priority from 1 to 99; 0 leaves everything as it is.
        everywhere: Also all other threads that the process has now. The loop waits for them: for
            Python's lock and for those of the middleware. It would wait long for one that holds a
            lock and is kept from running by another process.

    Returns:
        Why the system does not allow it, and what would; empty: it does.
    """
    if priority == 0:
        return ""
    threads = [0]
    if everywhere:
        threads += [int(task.name) for task in Path("/proc/self/task").iterdir()]
    try:
        for thread in threads:
            # A thread may have ended meanwhile.
            with contextlib.suppress(ProcessLookupError):
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return (
            f"the loop runs without real-time priority ({error.strerror}): other processes can "
            f"delay it; allow it with '{os.environ.get('USER', '<user>')} - rtprio 99' in "
            "/etc/security/limits.conf"
        )
    return ""


def start_loop(
    run: Callable[[], None], priority: int, tell: Callable[[str], None]
) -> threading.Thread:
    """Get the process ready for a loop with deadlines, and start that in a thread of its own.

    Args:
        run: The loop.
        priority: SCHED_FIFO priority of its thread, 0 to 99; that of all others is one less.
        tell: Called with why the system does not allow it, if it does not.
    """
    prepare_process()
    refused = take_priority(max(priority - 1, 0), everywhere=True)
    if refused:
        tell(refused)

    def loop() -> None:
        take_priority(priority)
        run()

    thread = threading.Thread(target=loop, name="loop", daemon=True)
    thread.start()
    return thread


class FixedRate:
    """Deadlines on a grid that starts once and never drifts.

    A deadline that has passed already when it is asked for is skipped: the loop goes on at the next
    point of the grid. Late is what is published more than half a period after its deadline, or
    skipped.

    Attributes:
        period: Time between deadlines [s].
        deadline: The current deadline, on the steady clock [s].
        late: Deadlines missed, skipped ones included.
        skipped: Deadlines without a frame.
        count: Deadlines so far, skipped ones included.
    """

    def __init__(self, rate_hz: float, clock: Callable[[], float] = time.perf_counter) -> None:
        self.period = 1.0 / rate_hz
        self._clock = clock
        self.late = self.skipped = self.count = 0
        self.deadline = clock()

    def start(self) -> None:
        """Begin the grid now."""
        self.deadline = self._clock() - self.period
        self.late = self.skipped = self.count = 0

    def wait(self, stop: threading.Event) -> bool:
        """Sleep until the next deadline that is not over yet.

        Returns:
            False when `stop` was set meanwhile.
        """
        now = self._clock()
        self.deadline += self.period
        behind = now - self.deadline
        if behind > self.period:
            missed = int(behind / self.period)
            self.deadline += missed * self.period
            self.skipped += missed
            self.late += missed
            self.count += missed
        self.count += 1
        remaining = self.deadline - now - WAKE_MARGIN
        if remaining > 0 and stop.wait(remaining):
            return False
        remaining = self.deadline - self._clock()
        if remaining > 0:
            time.sleep(remaining)
        return not stop.is_set()

    def published(self) -> bool:
        """Say that the frame is published; whether it is late."""
        late = self._clock() > self.late_at
        self.late += late
        return late

    @property
    def late_at(self) -> float:
        """Steady time from which on the frame is late when it is published [s]."""
        return self.deadline + 0.5 * self.period

    def slack(self) -> float:
        """Time left until the next deadline [s]."""
        return self.deadline + self.period - self._clock()


class Window:
    """The last values of something, for their quantiles.

    Attributes:
        count: Values so far, forgotten ones included.
    """

    def __init__(self, length: int = 4096) -> None:
        self._values = np.zeros(length)
        self.count = 0

    def add(self, value: float) -> None:
        """Remember a value, forgetting the oldest if need be."""
        self._values[self.count % len(self._values)] = value
        self.count += 1

    def extend(self, values: NDArray[np.float64]) -> None:
        """Remember several values."""
        length = len(self._values)
        kept = values[-length:]
        places = np.arange(self.count + len(values) - len(kept), self.count + len(values)) % length
        self._values[places] = kept
        self.count += len(values)

    def values(self) -> NDArray[np.float64]:
        """The values remembered, in no order, shape (n,)."""
        return self._values[: min(self.count, len(self._values))]

    def quantiles(self, *shares: float) -> list[float]:
        """Quantiles, such as 0.5 and 0.99; zeros when there is nothing yet."""
        values = self.values()
        if not len(values):
            return [0.0 for _ in shares]
        return [float(q) for q in np.quantile(values, shares)]
