"""What a simulation holds, frame by frame, as an interaction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.interaction import Interaction, InteractionError
from tissue_sim.compare.organ import Organ
from tissue_sim.simulation import Simulation

EXACTLY = 1e-9
"""Keeps rounding from taking the frame before where rates divide evenly."""


def frames_at(rate_hz: float, recorded_hz: float, recorded: int) -> NDArray[np.int64]:
    """The newest recorded frame at each time k / rate_hz, counted from 0.

    Args:
        rate_hz: Frames per second wanted [1/s].
        recorded_hz: Frames per second there are [1/s].
        recorded: How many there are.

    Raises:
        InteractionError: More frames a second are wanted than there are.
    """
    if not 1.0 <= rate_hz <= recorded_hz * (1.0 + EXACTLY):
        raise InteractionError(
            f"{rate_hz:g} frames a second cannot be taken from {recorded_hz:g}; "
            f"allowed: 1 to {recorded_hz:g}"
        )
    ratio = recorded_hz / rate_hz
    wanted = np.floor(np.arange(int(recorded / ratio) + 2) * ratio + EXACTLY).astype(np.int64)
    return wanted[wanted < recorded]


AFTERWARDS = 1.0
"""Time after the last release that counts [s]: tissue comes back; then there is only waiting."""


class HeldFrames:
    """Collects what a simulation holds.

    What comes before the first hold is left out, since all tissue rests until then, and so is what
    comes long after the last one. Frames in which the simulation is paused are left out as well.
    Nodes of holds by force are taken from where the simulation let them be.
    """

    def __init__(self) -> None:
        self._numbers: list[int] = []
        self._rows: list[NDArray[np.int32]] = []
        self._places: list[NDArray[np.float64]] = []
        self._by_force: set[str] = set()

    def take(self, simulation: Simulation) -> None:
        """Take the frame that a simulation has just made."""
        rows = simulation.holds.rows
        if simulation.paused or not (len(rows) or self._rows):
            return
        self._numbers.append(simulation.frame)
        self._rows.append(rows)
        self._places.append(simulation.state.displacement[rows].astype(np.float64))
        self._by_force.update(
            hold.tool for hold in simulation.holds.by_id.values() if hold.patch is not None
        )

    def interaction(
        self, name: str, organ: Organ, recorded_hz: float, rate_hz: float
    ) -> tuple[Interaction, NDArray[np.int64]]:
        """The interaction, and the number of the simulation's frame that each of its frames is.

        Args:
            name: Name for people.
            organ: The organ.
            recorded_hz: Frames of the simulation per second [1/s].
            rate_hz: Frames per second wanted [1/s].

        Raises:
            InteractionError: Nothing was held, or more frames are wanted than there are.
        """
        if not self._rows:
            raise InteractionError(f"{name}: no tool holds tissue in any frame")
        last = max(frame for frame, rows in enumerate(self._rows) if len(rows))
        counted = min(len(self._rows), last + 1 + round(AFTERWARDS * recorded_hz))
        chosen = frames_at(rate_hz, recorded_hz, counted)
        nodes = np.unique(np.concatenate([self._rows[frame] for frame in chosen]))
        held = np.zeros((len(chosen), len(nodes)), dtype=np.bool_)
        displacement = np.zeros((*held.shape, 3))
        for row, frame in enumerate(chosen):
            which = np.searchsorted(nodes, self._rows[frame])
            held[row, which] = True
            displacement[row, which] = self._places[frame]
        interaction = Interaction(
            name, rate_hz, nodes.astype(np.int32), held, displacement, organ.digest
        )
        return interaction.checked(organ), np.array(self._numbers)[chosen]

    def notes(self) -> tuple[str, ...]:
        """What people should know of it."""
        return tuple(
            f"{tool} holds by force: its nodes are held where the recorded model let them be"
            for tool in sorted(self._by_force)
        )
