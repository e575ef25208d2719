"""Replaying a journal: the same inputs with the same numbers of steps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissue_sim.frame import Budget, Frame, JournalEntry
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

START = "start"


class JournalError(ValueError):
    """A journal that cannot be replayed."""


@dataclass(frozen=True)
class Replay:
    """What a replay gave.

    Attributes:
        frames: Frames replayed.
        mismatches: Frames whose positions differ from the recorded ones; empty: bit-exact.
        positions: Positions after the last frame [m], shape (node_rows, 3).
        simulation: The simulation after the last frame.
    """

    frames: int
    mismatches: tuple[int, ...]
    positions: NDArray[np.float32]
    simulation: Simulation


def scene_of(entry: JournalEntry) -> Scene:
    """The scene that an epoch started with.

    Args:
        entry: Its first entry.

    Raises:
        JournalError: The entry is not an epoch's start.
    """
    commands = entry.inputs.commands
    if entry.frame != 1 or not commands or commands[0].kind != START:
        raise JournalError(
            f"the journal begins at frame {entry.frame}, not at its epoch's start: a replay needs "
            "every frame from frame 1 on. Start recording before the simulation starts"
        )
    return Scene.from_arguments(commands[0].arguments)


def epochs_of(entries: Iterable[JournalEntry]) -> dict[bytes, list[JournalEntry]]:
    """Entries by epoch, each in the order of frames, epochs in the order they appear."""
    epochs: dict[bytes, list[JournalEntry]] = {}
    for entry in entries:
        epochs.setdefault(entry.epoch, []).append(entry)
    return {epoch: sorted(of, key=lambda entry: entry.frame) for epoch, of in epochs.items()}


class Replayer:
    """Repeats an epoch entry by entry.

    Attributes:
        simulation: What repeats it.
        other_model: Whether another model runs than the journal tells; changes of model are then
            left out.
    """

    def __init__(self, simulation: Simulation, other_model: bool = False) -> None:
        """Go on after the frame that a simulation stands at."""
        self.simulation, self.other_model = simulation, other_model

    def play(self, entry: JournalEntry, budget: Budget | None = None) -> Frame:
        """Repeat the next frame.

        Args:
            entry: Its entry.
            budget: How much to step; None: as often as the journal tells, and a dynamic model that
                runs instead of the recorded one as its time step asks.

        Raises:
            JournalError: The entry is of another epoch, or not of the next frame.
        """
        simulation, inputs = self.simulation, entry.inputs
        _refuse_gap(simulation, entry)
        left_out = (START, "set_model") if self.other_model else (START,)
        kept = tuple(command for command in inputs.commands if command.kind not in left_out)
        if budget is None:
            own_steps = self.other_model and simulation.model.time_step is not None
            budget = Budget() if own_steps else Budget(steps=entry.steps)
        return simulation.advance(replace(inputs, commands=kept), budget)


def replay(
    entries: Iterable[JournalEntry],
    mesh: Mesh,
    model: str | None = None,
    parameters: Mapping[str, float] | None = None,
    on_frame: Callable[[Simulation, Frame], None] | None = None,
) -> Replay:
    """Repeat one epoch.

    Args:
        entries: Journal of the epoch from its start, in the order of frames.
        mesh: The epoch's first keyframe; it is changed in place.
        model: Another model to run instead; changes of model are then left out and nothing is
            compared.
        parameters: Parameters of that model.
        on_frame: Called after each frame.

    Raises:
        JournalError: The journal does not begin at the start of an epoch, has a gap, or mixes
            epochs.
    """
    replayer: Replayer | None = None
    mismatches: list[int] = []
    frame: Frame | None = None
    for entry in entries:
        if replayer is None:
            scene = scene_at_start(entry, mesh, model, parameters or {})
            replayer = Replayer(Simulation(mesh, scene, entry.epoch), model is not None)
        frame = replayer.play(entry)
        if model is None and frame.journal.crc32 != entry.crc32:
            mismatches.append(entry.frame)
        if on_frame is not None:
            on_frame(replayer.simulation, frame)
    if replayer is None or frame is None:
        raise JournalError("the journal is empty")
    simulation = replayer.simulation
    return Replay(simulation.frame, tuple(mismatches), frame.positions.copy(), simulation)


def scene_at_start(
    entry: JournalEntry, mesh: Mesh, model: str | None, parameters: Mapping[str, float]
) -> Scene:
    """The scene to repeat an epoch in.

    Args:
        entry: The epoch's first entry.
        mesh: Its first keyframe.
        model: Another model to run instead; None: the one it started with.
        parameters: Parameters of that model.

    Raises:
        JournalError: The entry is not the first, or the mesh is not what it started with.
    """
    scene = scene_of(entry)
    if scene.displacement is not None and len(scene.displacement) != mesh.node_rows:
        raise JournalError(
            f"the journal starts with {len(scene.displacement)} nodes, the mesh has "
            f"{mesh.node_rows}: it is not the first keyframe of this epoch"
        )
    if mesh.version != 1:
        raise JournalError(
            f"the mesh is at version {mesh.version}, not at 1: the first keyframe of the epoch is "
            "missing"
        )
    if model is None:
        return scene
    own = {**scene.parameters.get(model, {}), **parameters}
    return replace(scene, model=model, parameters={**scene.parameters, model: own})


def _refuse_gap(simulation: Simulation, entry: JournalEntry) -> None:
    if entry.epoch != simulation.epoch:
        raise JournalError(
            f"the journal goes on with epoch {entry.epoch.hex()} after {simulation.epoch.hex()}; "
            "replay one epoch at a time"
        )
    if entry.frame != simulation.frame + 1:
        raise JournalError(
            f"the journal has a gap: frame {entry.frame} follows frame {simulation.frame}"
        )
