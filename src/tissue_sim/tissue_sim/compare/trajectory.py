"""How a model moves under an interaction, or how tissue was measured to move."""

from __future__ import annotations

import math
import time
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.effort import MOST_STEPS, Effort
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import Subject
from tissue_sim.elastic.model import Model, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.kept_state import EXPLODED

QUIET = 64
"""Steps in a row in which nothing moves, after which a model that is not idle counts as at rest:
finite elements that renew their matrix pause for some forty."""

CARRIED = 1e-9
"""Keeps rounding from stealing a step where steps and frames divide evenly."""


class TrajectoryError(ValueError):
    """A file holds no trajectory, or not one of this organ or interaction."""


@dataclass(frozen=True)
class Trajectory:
    """Displacements frame by frame.

    Attributes:
        label: Whose they are.
        rate_hz: Frames per second [1/s].
        displacement: From rest [m], float32, shape (frames, node_rows, 3).
        steps: Steps of the model in each frame, shape (frames,); empty: it was measured.
        seconds: Time that stepping took in each frame [s], shape (frames,).
        stable: Frames before the model was lost; the number of frames if it was not.
        rows: Rows that mean something, sorted; None: all. A measurement may know some only.
        organ: Digest of the organ.
    """

    label: str
    rate_hz: float
    displacement: NDArray[np.float32]
    steps: NDArray[np.int64]
    seconds: NDArray[np.float64]
    stable: int
    organ: str
    rows: NDArray[np.int32] | None = None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.displacement)

    @property
    def is_stable(self) -> bool:
        """Whether the model was never lost."""
        return self.stable == self.frames

    @property
    def steps_per_frame(self) -> float:
        """Steps of a frame, mean while the model was stable; nan if it was measured."""
        return float(self._played(self.steps).mean()) if len(self.steps) else math.nan

    @property
    def ms_per_frame(self) -> float:
        """Time of a frame [ms]: median time of a step by steps of a frame; nan if measured.

        Not the median over the frames: with less than a step a frame most of them cost nothing.
        """
        steps = self._played(self.steps)
        if not steps.any():
            return math.nan
        made = steps > 0
        per_step = np.median(self._played(self.seconds)[made] / steps[made])
        return 1e3 * float(per_step) * self.steps_per_frame

    def _played(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values of the frames before the model was lost, and of that one if there is no other."""
        return values[: max(1, self.stable)]

    def save(self, path: Path) -> None:
        """Write it as a NumPy archive (.npz), whole or not at all."""
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(path.name + ".partial")
        rows: dict[str, Any] = {} if self.rows is None else {"rows": self.rows}
        with partial.open("wb") as file:
            np.savez_compressed(
                file, label=self.label, rate_hz=self.rate_hz, displacement=self.displacement,
                steps=self.steps, seconds=self.seconds, stable=self.stable, organ=self.organ,
                **rows,
            )  # fmt: skip
        partial.replace(path)

    @classmethod
    def load(cls, path: Path) -> Trajectory:
        """Read what `save` wrote.

        Raises:
            TrajectoryError: The file is not one of these.
            OSError: It cannot be read.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                return cls(
                    str(file["label"]), float(file["rate_hz"]), file["displacement"],
                    file["steps"], file["seconds"], int(file["stable"]), str(file["organ"]),
                    file.get("rows"),
                )  # fmt: skip
        except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, ValueError) as error:
            raise TrajectoryError(f"{path} is no trajectory: {error}") from error


class Player:
    """Plays an interaction to a model, frame by frame.

    Attributes:
        model: The model.
        state: Its state after the last frame.
    """

    def __init__(self, model: Model, organ: Organ, interaction: Interaction) -> None:
        """Stand before the first frame, at rest.

        Raises:
            InteractionError: The interaction is not one of this organ.
        """
        self._organ, self._interaction = organ, interaction.checked(organ)
        self.model = model
        network: SpringNetwork = model.springs  # type: ignore[attr-defined]
        self.state = State(organ.mesh, network.dtype)
        self._held = np.empty(0, dtype=np.int32)
        self._owed = 0.0
        model.prescribed_changed(self.state, self._held)

    def play(self, frame: int, effort: Effort) -> tuple[int, float]:
        """Hold what is held in a frame and step; steps made and seconds they took."""
        self._hold(frame)
        steps, seconds = self._wanted(effort)
        begun = time.perf_counter()
        if effort.to_rest is not None:
            made = self._step_to_rest(effort.to_rest)
        elif seconds is not None:
            made = self._step_until(begun + seconds)
        else:
            made = steps
            for _ in range(steps):
                self.model.step(self.state)
        return made, time.perf_counter() - begun

    def _hold(self, frame: int) -> None:
        interaction, state = self._interaction, self.state
        which = interaction.held[frame]
        rows = interaction.nodes[which]
        if not np.array_equal(rows, self._held):
            freed = np.setdiff1d(self._held, rows)
            # What is let go of starts from rest, as in `Simulation.release`.
            state.previous[freed] = state.displacement[freed]
            mesh = self._organ.mesh
            state.prescribed[:] = mesh.fixed
            state.prescribed[rows] = True
            self._held = rows
            self.model.prescribed_changed(state, rows)
        state.displacement[rows] = interaction.displacement[frame, which]

    def _wanted(self, effort: Effort) -> tuple[int, float | None]:
        """Steps of this frame, or the time for them [s]."""
        if effort.seconds is not None and self.model.time_step is None:
            return 0, effort.seconds
        if effort.steps is not None:
            share = effort.steps
        elif self.model.time_step is not None:
            share = 1.0 / (self._interaction.rate_hz * self.model.time_step)
        else:
            share = 1.0
        self._owed += share + CARRIED
        steps = int(self._owed)
        self._owed -= steps
        return steps, None

    def _step_until(self, end: float) -> int:
        """At least one step; a step is begun if one as long as the longest would be in time."""
        made, longest, last = 0, 0.0, time.perf_counter()
        while True:
            self.model.step(self.state)
            made += 1
            now = time.perf_counter()
            longest, last = max(longest, now - last), now
            if now + longest > end or self.model.idle:
                return made

    def _step_to_rest(self, tolerance: float) -> int:
        before, quiet = np.empty_like(self.state.displacement), 0
        for made in range(1, MOST_STEPS + 1):
            np.copyto(before, self.state.displacement)
            self.model.step(self.state)
            if self.model.idle:
                return made
            moved = float(np.abs(self.state.displacement - before).max())
            quiet = quiet + 1 if moved <= tolerance and self.model.time_step is None else 0
            if quiet == QUIET:
                return made
        return MOST_STEPS


def simulate(
    subject: Subject,
    organ: Organ,
    interaction: Interaction,
    on_frame: Callable[[int], None] | None = None,
    model: Model | None = None,
) -> Trajectory:
    """Play an interaction to a subject.

    A model whose state is not finite or explodes is lost: from that frame on nothing moves but what
    is held.

    Args:
        subject: The model, its parameters and its effort.
        organ: The organ; it is not changed.
        interaction: What is held.
        on_frame: Told the number of each frame that is done.
        model: The subject's model on this organ, if it is built already; one that has been played
            to before remembers it.

    Raises:
        ValueError: The subject makes no sense on this organ, or the interaction is not one of it.
    """
    player = Player(subject.build(organ) if model is None else model, organ, interaction)
    frames, count = interaction.frames, organ.mesh.node_rows
    displacement = np.zeros((frames, count, 3), dtype=np.float32)
    steps, seconds = np.zeros(frames, dtype=np.int64), np.zeros(frames)
    limit = EXPLODED * organ.size
    stable = frames
    for frame in range(frames):
        steps[frame], seconds[frame] = player.play(frame, subject.effort)
        shape = player.state.displacement[:count]
        farthest = float(np.abs(shape).max())
        if not farthest <= limit:
            stable = frame
            break
        displacement[frame] = shape
        if on_frame is not None:
            on_frame(frame)
    if stable < frames:
        displacement[stable:] = only_held(organ, interaction).displacement[stable:]
    return Trajectory(
        subject.name, interaction.rate_hz, displacement, steps, seconds, stable, organ.digest
    )


def only_held(organ: Organ, interaction: Interaction) -> Trajectory:
    """The worst that makes sense: held nodes move, and nothing else does (THESIS.md, section 7)."""
    interaction.checked(organ)
    frames = interaction.frames
    displacement = np.zeros((frames, organ.mesh.node_rows, 3), dtype=np.float32)
    displacement[:, interaction.nodes] = interaction.displacement
    return Trajectory(
        "only what is held moves", interaction.rate_hz, displacement,
        np.zeros(frames, dtype=np.int64), np.zeros(frames), frames, organ.digest,
    )  # fmt: skip
