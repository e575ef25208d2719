"""Waiting inside an `async def` callback of a single-threaded executor."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator


class Until:
    """Await it to wait until something holds, for at most so long; the result says whether it does.

    The executor resumes a waiting callback whenever it wakes up, so the question is asked again
    after every message and must be cheap. A timer of the node must wake the executor now and then,
    for the deadline to be noticed.
    """

    def __init__(self, holds: Callable[[], bool], seconds: float) -> None:
        self._holds = holds
        self._deadline = time.monotonic() + seconds

    def __await__(self) -> Generator[None, None, bool]:
        while not self._holds():
            if time.monotonic() > self._deadline:
                return False
            yield
        return True
