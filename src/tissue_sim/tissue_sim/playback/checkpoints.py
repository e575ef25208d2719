"""States of a simulation kept while a recording is played, to go back to."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable

from tissue_sim.simulation import Simulation

SHARE = 0.02
"""Share of the time that keeping states may take."""

SHORTEST = 1.0
"""Least time between two states [s]."""


class Checkpoints:
    """Whole simulations by frame, in a bounded amount of memory.

    Each is a string of bytes that never leaves the process: its size is known, and nothing in it is
    looked at by Python's collector of garbage between two frames. Where a new one does not fit, the
    one that is missed least is dropped: that whose neighbours lie closest together.
    """

    def __init__(self, limit: int, clock: Callable[[], float] = time.perf_counter) -> None:
        """Begin with none.

        Args:
            limit: Most bytes kept; 0: none.
            clock: Steady time [s].
        """
        self.limit = limit
        self._clock = clock
        self._kept: dict[int, bytes] = {}
        self._next = -float("inf")

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def frames(self) -> list[int]:
        """The frames after which states are kept, in order."""
        return sorted(self._kept)

    @property
    def size(self) -> int:
        """Bytes kept."""
        return sum(map(len, self._kept.values()))

    def offer(self, frame: int, simulation: Simulation) -> None:
        """Keep the state after a frame, unless it is too soon after the last one or known."""
        began = self._clock()
        if not self.limit or began < self._next or frame in self._kept:
            return
        self._kept[frame] = pickle.dumps(simulation, pickle.HIGHEST_PROTOCOL)
        ended = self._clock()
        self._next = ended + max(SHORTEST, (ended - began) / SHARE)
        while self.size > self.limit:
            del self._kept[self._least_missed()]

    def at(self, frame: int) -> Simulation:
        """The state after a frame, as a simulation of its own.

        Raises:
            KeyError: It is not kept.
        """
        simulation: Simulation = pickle.loads(self._kept[frame])
        return simulation

    def newest_before(self, frame: int) -> int | None:
        """The newest frame before another one after which a state is kept; None: there is none."""
        return max((kept for kept in self._kept if kept < frame), default=None)

    def _least_missed(self) -> int:
        """The one between the closest neighbours; first and newest stay as long as possible."""
        frames = self.frames
        gaps = [after - before for before, after in zip(frames, frames[2:], strict=False)]
        return frames[1 + gaps.index(min(gaps))] if gaps else frames[-1]
