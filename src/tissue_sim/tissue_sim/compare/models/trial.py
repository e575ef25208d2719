"""How models come out in a trial: an organ, an interaction, and what they are compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from tissue_sim.compare.difference import difference
from tissue_sim.compare.effort import Effort
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.models.step_cost import StepCost, bought
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.reference_cache import Say, cached
from tissue_sim.compare.sources.motions import motion
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import Trajectory, only_held, simulate

AT_REST = Effort.parse("rest")


@dataclass(frozen=True)
class Reference:
    """What models are compared with: a model in equilibrium.

    Attributes:
        subject: The model.
        every: Of so many frames the last one counts.
    """

    subject: Subject
    every: int = 1

    def moved(self, organ: Organ, interaction: Interaction, say: Say) -> Trajectory:
        """How it moves, in the frames that count; told how far it is."""
        frames = self._frames
        seen = replace(
            interaction, rate_hz=interaction.rate_hz / self.every, held=interaction.held[frames],
            displacement=interaction.displacement[frames],
        )  # fmt: skip
        what = f"{organ.name}, {interaction.name}: {self.subject.name} in equilibrium"
        say(what)

        def on_frame(frame: int) -> None:
            say(f"{what}, frame {frame + 1} of {seen.frames}")

        return cached(self.subject, organ, seen, on_frame=on_frame, say=say)

    def seen(self, trajectory: Trajectory) -> Trajectory:
        """A trajectory in the frames that count."""
        frames = self._frames
        return replace(
            trajectory, rate_hz=trajectory.rate_hz / self.every,
            displacement=trajectory.displacement[frames], steps=trajectory.steps[frames],
            seconds=trajectory.seconds[frames], stable=trajectory.stable // self.every,
        )  # fmt: skip

    @property
    def _frames(self) -> slice:
        return slice(self.every - 1, None, self.every)


REFERENCES = {
    "linear": Reference(Subject("finite_element", effort=AT_REST)),
    "corotated": Reference(
        Subject("finite_element", {"corotated": 1.0, "tolerance": 1e-3}, AT_REST), every=5
    ),
}
"""The thesis' reference, and one that turns with the tissue, whose equilibrium takes seconds a
frame on the heart: a fifth of the frames have to do."""


@dataclass(frozen=True)
class Error:
    """How far a model is from a reference.

    Attributes:
        relative: Mean over nodes and frames over that of tissue that does not follow at all.
        mean_mm: Mean over nodes and frames [mm].
        p95_mm: 95th percentile of the nodes, mean over the frames [mm].
        largest_mm: Largest of a node in any frame [mm].
        volume: Largest share of the volume that is missing or too much in a frame.
    """

    relative: float
    mean_mm: float
    p95_mm: float
    largest_mm: float
    volume: float


@dataclass(frozen=True)
class Row:
    """A model on an organ under an interaction, with a budget.

    Attributes:
        organ: Name of the organ.
        interaction: Name of the interaction.
        label: Name of the model and its variant.
        budget_ms: Time a frame [ms].
        model: Name of the model.
        values: What differs from its defaults.
        steps: Steps a frame.
        real_time: Whether simulated time keeps up; models without time do.
        ms: Time that the steps of a frame took, mean over the frames [ms].
        lost: Frames after the model was lost.
        errors: By name of the reference.
    """

    organ: str
    interaction: str
    label: str
    budget_ms: float
    model: str
    values: dict[str, float]
    steps: float
    real_time: bool
    ms: float
    lost: int
    errors: dict[str, Error]

    @property
    def subject(self) -> Subject:
        """What was judged, with the steps it made: another run makes the same."""
        return Subject(self.model, self.values, Effort(steps=self.steps), self.label)

    @classmethod
    def of(cls, values: dict[str, Any]) -> Row:
        """The row of plain JSON values, as `dataclasses.asdict` gives them."""
        errors = {name: Error(**error) for name, error in values["errors"].items()}
        return cls(**{**values, "errors": errors})


@dataclass(frozen=True)
class Trial:
    """An interaction with an organ, and how the references move.

    Attributes:
        organ: The organ.
        interaction: The interaction.
        references: The references' movements in the frames that count, by name.
        worst: Mean distance of tissue that does not follow at all [m], by name of the reference.
    """

    organ: Organ
    interaction: Interaction
    references: dict[str, Trajectory]
    worst: dict[str, float]

    @classmethod
    def of(
        cls,
        organ: Organ,
        name: str,
        references: Sequence[str] = tuple(REFERENCES),
        say: Say = lambda line: None,
    ) -> Trial:
        """A trial of a motion by name.

        Args:
            organ: The organ.
            name: One of `MOTIONS`.
            references: Some of `REFERENCES`; they are computed, or taken from the user's cache.
            say: Told how far that is.

        Raises:
            ValueError: There is no such motion, or the organ has no tetrahedra.
        """
        interaction = motion(name, organ)
        moved = {each: REFERENCES[each].moved(organ, interaction, say) for each in references}
        still = only_held(organ, interaction)
        worst = {
            each: difference(organ, REFERENCES[each].seen(still), moved[each]).mean
            for each in references
        }
        return cls(organ, interaction, moved, worst)

    def errors(self, trajectory: Trajectory) -> dict[str, Error]:
        """How far a trajectory is from the references, by name."""
        found = {}
        for name, moved in self.references.items():
            apart = difference(self.organ, REFERENCES[name].seen(trajectory), moved)
            millimetres = (1e3 * far for far in (apart.mean, apart.p95, apart.largest))
            relative = apart.mean / self.worst[name]
            figures = (relative, *millimetres, apart.largest_volume_error)
            found[name] = Error(*(_rounded(figure, 6) for figure in figures))
        return found

    def judged(self, subject: Subject, cost: StepCost, budget_ms: float) -> Row:
        """How a model comes out with a budget.

        Args:
            subject: The model; its effort is replaced.
            cost: What a step of it costs on this organ.
            budget_ms: Time a frame [ms].
        """
        share = bought(subject, cost, budget_ms, self.interaction.rate_hz)
        trajectory = simulate(share.subject, self.organ, self.interaction)
        return Row(
            self.organ.name, self.interaction.name, subject.name, budget_ms, subject.model,
            dict(share.subject.values), share.steps, share.real_time,
            _rounded(1e3 * float(trajectory.seconds.mean()), 4),
            trajectory.frames - trajectory.stable, self.errors(trajectory),
        )  # fmt: skip


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")
