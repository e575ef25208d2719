"""Where the nodes were, as a bag has it, for playing without simulating."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.playback.recording import Recording

LEAST_HZ = 5.0
"""Fewer states a second are no motion."""


class RecordedStates:
    """The states of a bag by frame of the recording, read when they are needed."""

    def __init__(self, bag: Path, namespace: str | None, recording: Recording) -> None:
        """Look how many there are.

        Args:
            bag: Bag directory or MCAP file.
            namespace: Namespace of the organ; None if there is only one.
            recording: The session in it.

        Raises:
            ValueError: There are too few, or the bag cannot be read.
        """
        # Here, so that the numeric library needs no ROS.
        from viz_bridge.bag_reader import only_namespace, topic_counts

        self._bag, self._recording = bag, recording
        self._topic = f"{only_namespace(bag, namespace)}/tissue/state"
        found = topic_counts(bag).get(self._topic, 0) / recording.seconds
        if found < LEAST_HZ:
            raise ValueError(
                f"{bag} holds {found:.1f} states a second, at least {LEAST_HZ:g} are needed to "
                "play them: simulate it again instead, or record with --record-state-hz 60"
            )
        self._times: dict[int, int] = {}
        self._rest: Iterator[tuple[int, NDArray[np.float32]]] = iter(())
        nothing = np.empty((0, 3), dtype=np.float32)
        self._next: tuple[int, NDArray[np.float32]] | None = (recording.frames + 1, nothing)

    def at(self, frame: int) -> NDArray[np.float32] | None:
        """Positions after a frame of the recording [m], shape (n, 3); None: they were not kept."""
        if self._next is None or self._next[0] > frame:
            earlier = max((known for known in self._times if known <= frame), default=0)
            self._rest = self._from(self._times.get(earlier, 0))
            self._next = next(self._rest, None)
        while self._next is not None and self._next[0] < frame:
            self._next = next(self._rest, None)
        return self._next[1] if self._next is not None and self._next[0] == frame else None

    def _from(self, start: int) -> Iterator[tuple[int, NDArray[np.float32]]]:
        from viz_bridge.bag_reader import read_bag

        for item in read_bag(self._bag, (self._topic,), start):
            message = item.message
            first = self._recording.first_of(message.epoch.tobytes())
            if first:
                frame = first - 1 + int(message.frame)
                self._times.setdefault(frame, item.log_time)
                yield frame, np.asarray(message.positions, dtype=np.float32).reshape(-1, 3)
