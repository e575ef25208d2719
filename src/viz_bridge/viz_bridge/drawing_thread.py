"""Draws in a thread of its own, so that a slow or stopped viewer delays nobody."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from viz_bridge.cdr import Decoder
from viz_bridge.recording import Recording

LATEST_WINS = frozenset({"tissue/state", "tissue/difference"})
MOST_WAITING = 20_000
"""Messages that may wait besides the newest state: minutes of journal, a few megabytes."""


class DrawingThread:
    """Hands messages to a `Recording` one after the other.

    Of states only the newest waits; of everything else a bounded number, of which the oldest go
    first. Keyframes and edits count among them: after a gap the drawing waits for the next
    keyframe, and draws nothing wrong meanwhile.

    Attributes:
        passed_over: States that a newer one replaced before they were drawn.
        dropped: Other messages given up because too many waited.
        failure: Why drawing has ended; empty while it goes on.
    """

    def __init__(self, name: str, make: Callable[[], Recording]) -> None:
        """Start.

        Args:
            name: What is drawn to, for people.
            make: Makes the recording; called in the thread.
        """
        self.name = name
        self.passed_over = 0
        self.dropped = 0
        self.drawn = 0
        self.failure = ""
        self._make = make
        self._waiting: deque[tuple[str, Decoder, bytes, int]] = deque()
        self._newest: dict[str, tuple[str, Decoder, bytes, int]] = {}
        self._wake = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._work, name=f"drawing {name}", daemon=True)
        self._thread.start()

    def put(self, topic: str, decoder: Decoder, data: bytes, received: int) -> None:
        """Hand over a message; returns at once."""
        item = (topic, decoder, data, received)
        with self._wake:
            if self._closing or self.failure:
                return
            if topic in LATEST_WINS:
                self.passed_over += topic in self._newest
                self._newest[topic] = item
            else:
                if len(self._waiting) >= MOST_WAITING:
                    self._waiting.popleft()
                    self.dropped += 1
                self._waiting.append(item)
            self._wake.notify()

    def close(self, timeout: float) -> bool:
        """Draw what waits and end; False where that takes longer than the timeout [s]."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _work(self) -> None:
        recording = self._make()
        try:
            while True:
                with self._wake:
                    while not (self._waiting or self._newest or self._closing):
                        self._wake.wait()
                    items = [*self._waiting, *self._newest.values()]
                    self._waiting.clear()
                    self._newest.clear()
                    if self._closing and not items:
                        break
                for topic, decoder, data, received in items:
                    recording.take(topic, decoder(data), received)
                self.drawn = recording.states
        except (ValueError, OSError, RuntimeError) as error:
            self.failure = str(error)
        finally:
            recording.close()
