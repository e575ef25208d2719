"""Plays a recording by simulating it again, from any frame on."""

from __future__ import annotations

import os
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissue_sim.frame import Budget, Frame, JournalEntry
from tissue_sim.journal import Replayer
from tissue_sim.playback.checkpoints import Checkpoints
from tissue_sim.playback.recorded_states import RecordedStates
from tissue_sim.playback.recording import Recording


class Player:
    """A simulation that goes through a recording, bit by bit as it was.

    What it shows is an epoch of its own, and another one after each jump: within an epoch, frames
    and versions only grow.

    Attributes:
        recording: What is played.
        checkpoints: States on the way that it can go back to.
        simulation: What repeats it; replaced where another epoch begins, and by `seek`.
        frame: Frame of the recording it stands after; 0: before the first.
        target: Frame that is being sought; 0: none.
        differing: Frames that did not come out as recorded.
        states: Shapes to show instead of simulating them; None: it simulates.
    """

    def __init__(
        self,
        recording: Recording,
        checkpoints: Checkpoints,
        states: RecordedStates | None = None,
    ) -> None:
        """Stand before the first frame."""
        self.recording, self.checkpoints, self.states = recording, checkpoints, states
        self.simulation = recording.begin(1)
        self.frame = self.target = self.differing = 0
        self._from = 0
        checkpoints.offer(0, self.simulation)

    @property
    def over(self) -> bool:
        """Whether the last frame has been played."""
        return self.frame == self.recording.frames

    @property
    def progress(self) -> float:
        """Share of the way to the target that is done, 0 to 1; 1 without one."""
        way = self.target - 1 - self._from
        return (self.frame - self._from) / way if self.target and way > 0 else 1.0

    def play(self) -> Frame:
        """Repeat the next frame of the recording."""
        following = self.frame + 1
        if self.recording.begins(following) and self.simulation.frame:
            self.simulation = self.recording.begin(following)
        entry = self.recording.entry(following)
        entry = replace(entry, epoch=self.simulation.epoch)
        if self.states is not None:
            self.frame = following
            return self._shown(entry, self.states.at(following))
        frame = Replayer(self.simulation).play(entry)
        self.count(frame)
        self.checkpoints.offer(self.frame, self.simulation)
        return frame

    def simulate(self) -> None:
        """Set out for the state after this frame itself, where shapes were only shown."""
        frame, self.states = self.frame, None
        # Nothing of what was shown is a state to go on from.
        self.frame = self.recording.frames + 1
        self.seek(frame + 1)

    def _shown(self, entry: JournalEntry, shape: NDArray[np.float32] | None) -> Frame:
        """All that a frame applied, without a step of the model, and the shape that came of it."""
        simulation = self.simulation
        frame = Replayer(simulation).play(entry, Budget(steps=0))
        simulation.sim_time = entry.sim_time
        rows = simulation.mesh.node_rows
        if shape is not None and len(shape) == rows:
            state = simulation.state
            state.displacement[:rows] = shape - simulation.mesh.rest[:rows]
            state.previous[:rows] = state.displacement[:rows]
            frame = replace(frame, positions=shape)
        return replace(frame, journal=replace(frame.journal, sim_time=entry.sim_time), wrenches={})

    def count(self, frame: Frame, compare: bool = True) -> None:
        """Take note that the next frame has been played, by whomever.

        Args:
            frame: What came out.
            compare: Whether it is to be what was recorded.
        """
        self.frame += 1
        if compare:
            self.differing += frame.journal.crc32 != self.recording.entry(self.frame).crc32

    def seek(self, frame: int) -> None:
        """Set out for a frame; `approach` goes the way.

        It begins here, at the newest state kept before the frame, or at the start of the frame's
        epoch: whatever is nearest.
        """
        first = self.recording.start_before(frame)
        kept = self.checkpoints.newest_before(frame)
        # After the last frame of an epoch the next one is not begun yet.
        usable = kept is not None and kept >= (first if first > 1 else 0)
        nearest = kept if usable and kept is not None else first - 1
        if not nearest <= self.frame < frame:
            self.simulation = (
                self.checkpoints.at(nearest) if usable else self.recording.begin(first)
            )
            self.frame = nearest
        self._from, self.target = self.frame, frame

    def approach(self, until: float) -> bool:
        """Go on towards the target, for some time.

        Args:
            until: Steady time (`time.perf_counter`) at which to stop [s].

        Returns:
            Whether the target is the next frame.
        """
        while self.frame < self.target - 1:
            if time.perf_counter() > until:
                return False
            self.play()
        self.target = 0
        self.simulation.epoch = os.urandom(16)
        return True
