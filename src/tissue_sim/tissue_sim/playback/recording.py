"""A recorded session as one row of frames."""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Sequence
from pathlib import Path

from tissue_sim.frame import JournalEntry
from tissue_sim.journal import JournalError, scene_at_start, scene_of
from tissue_sim.session_bag import RecordedEpoch, read_epochs
from tissue_sim.simulation import Simulation


class Recording:
    """The frames of all epochs of a session, one after the other, numbered from 1.

    Its time is that of its frames: `rate_hz` of them are a second, whether or not the machine kept
    up when it was recorded.

    Attributes:
        name: What people call it: the bag's name.
        entries: What each frame applied.
        rate_hz: Frames a second [1/s].
        organ: Name of the geometry.
    """

    def __init__(self, name: str, epochs: Sequence[RecordedEpoch]) -> None:
        """Check that every epoch can be simulated from its start.

        Raises:
            JournalError: There is no frame, a first keyframe is missing, or a journal begins late
                or has a gap.
        """
        self.name = name
        self.entries: list[JournalEntry] = []
        self._epochs: dict[int, RecordedEpoch] = {}
        for epoch in epochs:
            _refuse_gaps(epoch)
            self._epochs[len(self.entries) + 1] = epoch
            self.entries += epoch.entries
        if not self.entries:
            raise JournalError(f"{name} holds no frame")
        self.rate_hz = scene_of(self.entries[0]).rate_hz
        self.organ = epochs[0].organ

    def __str__(self) -> str:
        return f"{self.name}: {self.frames} frames, {self.seconds:.2f} s"

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.entries)

    @property
    def seconds(self) -> float:
        """Its duration [s]."""
        return self.frames / self.rate_hz

    def entry(self, frame: int) -> JournalEntry:
        """What a frame applied; frames count from 1."""
        return self.entries[frame - 1]

    def begins(self, frame: int) -> bool:
        """Whether a frame is the first of an epoch."""
        return frame in self._epochs

    def first_of(self, epoch: bytes) -> int:
        """The first frame of the epoch with this id; 0: it is not in the recording."""
        return next((first for first, of in self._epochs.items() if of.epoch == epoch), 0)

    def start_before(self, frame: int) -> int:
        """The first frame of the epoch that a frame belongs to."""
        return max(first for first in self._epochs if first <= frame)

    def epoch_at(self, frame: int) -> RecordedEpoch:
        """The epoch that a frame belongs to."""
        return self._epochs[self.start_before(frame)]

    def begin(self, frame: int) -> Simulation:
        """The simulation before the first frame of an epoch, as an epoch of its own.

        Args:
            frame: That first frame.
        """
        mesh = copy.deepcopy(self._epochs[frame].start)
        scene = scene_at_start(self.entry(frame), mesh, None, {})
        return Simulation(mesh, scene, os.urandom(16))

    def frame_at(self, seconds: float) -> int:
        """The frame shown at a time.

        Args:
            seconds: Time into the recording [s].

        Raises:
            ValueError: The recording is not so long.
        """
        if not (math.isfinite(seconds) and 0.0 <= seconds <= self.seconds):
            raise ValueError(
                f"{seconds:g} s is not in the recording; allowed: 0 to {self.seconds:g} s"
            )
        return max(1, round(seconds * self.rate_hz))


def read_recording(bag: Path, namespace: str | None = None) -> Recording:
    """The session that a bag holds.

    Args:
        bag: Bag directory or MCAP file.
        namespace: Namespace of the organ; None if there is only one.

    Raises:
        ValueError: The bag cannot be read, or cannot be simulated again.
    """
    return Recording(bag.resolve().name, read_epochs(bag, namespace))


def _refuse_gaps(epoch: RecordedEpoch) -> None:
    scene_at_start(epoch.entries[0], epoch.start, None, {})
    for expected, entry in enumerate(epoch.entries, 1):
        if entry.frame != expected:
            raise JournalError(
                f"the journal has a gap: frame {entry.frame} follows frame {expected - 1}; "
                "allowed: every frame from the first on"
            )
