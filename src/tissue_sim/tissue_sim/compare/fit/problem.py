"""What a fit minimises: how far a subject is from references, for values of a space."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.difference import check_alike, known_rows, mean_distance
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import Trajectory, only_held, simulate

REFUSED = 2.0
"""Error of values that the subject cannot have; that of a model lost in the first frame."""


@dataclass(frozen=True)
class Case:
    """An interaction, and what a model should do under it.

    Attributes:
        interaction: What is held.
        reference: How a reference moved, or what was measured.
        worst: How far tissue is from it that does not follow at all [m]; `case_of` measures it.
    """

    interaction: Interaction
    reference: Trajectory
    worst: float

    @property
    def digest(self) -> str:
        """What tells it from any other case on the same organ."""
        told = hashlib.sha256()
        for array in (self.interaction.nodes, self.interaction.held, self.interaction.displacement,
                      self.reference.displacement, self.reference.rows):  # fmt: skip
            told.update(b"all" if array is None else np.ascontiguousarray(array).tobytes())
        told.update(str(self.interaction.rate_hz).encode())
        return told.hexdigest()[:16]


def case_of(organ: Organ, interaction: Interaction, reference: Trajectory) -> Case:
    """A case with the worst that makes sense (THESIS.md, section 7).

    Raises:
        ValueError: The interaction or the reference is not one of this organ, or the reference
            moves no more than tissue that does not follow.
    """
    held = only_held(organ, interaction)
    check_alike(organ, held, reference)
    worst = mean_distance(held, reference, known_rows(organ, reference))
    if not (np.isfinite(worst) and worst > 0.0):
        raise ValueError(
            f"{reference.label} under {interaction.name}: nothing follows what is held (mean "
            f"distance {worst:g} m), so there is nothing to fit; allowed: a reference that moves"
        )
    return Case(interaction, reference, worst)


@dataclass(frozen=True)
class Evaluation:
    """How good values are.

    Attributes:
        unit: Where they are in the unit cube of the space.
        values: The values.
        error: Mean difference over the worst, averaged over the cases: 0 is identical, 1 is tissue
            that does not follow. Models that are lost have 1 and the share of frames that they did
            not live to see, `REFUSED` if they could not be built.
        stable: Whether the model was built and never lost.
        steps: Steps a frame that it made in the mean.
        reason: Why it is not stable; empty if it is.
    """

    unit: tuple[float, ...]
    values: dict[str, float]
    error: float
    stable: bool
    steps: float
    reason: str = ""

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values; floats keep every bit."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> Evaluation:
        """The evaluation of `to_json`."""
        return cls(**{**content, "unit": tuple(content["unit"])})


@dataclass(frozen=True)
class Problem:
    """The values of a space with which a subject comes closest to references.

    Can be pickled: a worker gets it once and evaluates many candidates.

    Attributes:
        organ: The organ.
        subject: The model, what is not fitted, and what it may do in a frame.
        space: What is fitted.
        cases: What it should do; the errors are averaged.

    Raises:
        ValueError: The parts do not go together; or the effort is a time, whose outcome depends on
            what else the machine does.
    """

    organ: Organ
    subject: Subject
    space: Space
    cases: tuple[Case, ...]

    def __post_init__(self) -> None:
        """Check it, and mark the whole numbers of the space."""
        self.subject.checked()
        object.__setattr__(self, "space", self.space.checked(self.subject))
        if not self.subject.effort.reproducible:
            raise ValueError(
                f"effort {self.subject.effort} depends on the machine; allowed in a fit: steps a "
                'frame such as 2.9, "rest" or "time"'
            )
        if not self.cases:
            raise ValueError("there is no case to fit to; allowed: one or several")
        for case in self.cases:
            case.interaction.checked(self.organ)

    @property
    def identity(self) -> dict[str, Any]:
        """What tells it from any other problem, as plain JSON values by name."""
        return {
            "organ": self.organ.digest,
            "material": asdict(self.organ.material),
            "model": self.subject.model,
            "values": dict(self.subject.values),
            "effort": str(self.subject.effort),
            "space": [asdict(parameter) for parameter in self.space.parameters],
            "cases": [case.digest for case in self.cases],
        }

    def evaluate(self, unit: NDArray[np.float64]) -> Evaluation:
        """Play all cases with the values at a point of the unit cube, shape (space.size,)."""
        values = self.space.decode(unit)
        place = tuple(map(float, unit))
        subject = self.subject.with_values(values)
        try:
            played = [simulate(subject, self.organ, case.interaction) for case in self.cases]
        except ValueError as refusal:
            return Evaluation(place, values, REFUSED, False, 0.0, str(refusal))
        steps = sum(int(t.steps.sum()) for t in played) / sum(t.frames for t in played)
        lost = [trajectory for trajectory in played if not trajectory.is_stable]
        if lost:
            share = float(np.mean([1.0 - t.stable / t.frames for t in played]))
            reason = f"lost in frame {lost[0].stable + 1} of {lost[0].frames}"
            return Evaluation(place, values, 1.0 + share, False, steps, reason)
        errors = [
            mean_distance(t, case.reference, known_rows(self.organ, case.reference)) / case.worst
            for t, case in zip(played, self.cases, strict=True)
        ]
        return Evaluation(place, values, float(np.mean(errors)), True, steps)
