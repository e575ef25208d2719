"""A reference and any number of targets under one interaction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tissue_sim.compare.difference import Difference, difference
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import Trajectory, only_held, simulate

Progress = Callable[[str, int, int], None]
"""Told a label, the frames that are done and how many there are."""


@dataclass(frozen=True)
class Target:
    """How a target came out.

    Attributes:
        subject: The target.
        trajectory: How it moved.
        difference: How far it is from the reference.
        relative: Its mean difference over that of tissue that does not follow at all.
    """

    subject: Subject
    trajectory: Trajectory
    difference: Difference
    relative: float


@dataclass(frozen=True)
class Comparison:
    """What a comparison found.

    Attributes:
        organ: The organ.
        interaction: What was done to it.
        reference: How the reference moved, or what was measured.
        reference_subject: The model of the reference; None: it was measured.
        worst: How far tissue is from it that does not follow at all.
        targets: The targets, as given.
    """

    organ: Organ
    interaction: Interaction
    reference: Trajectory
    reference_subject: Subject | None
    worst: Difference
    targets: tuple[Target, ...]

    @property
    def ranking(self) -> tuple[Target, ...]:
        """The targets, the closest first."""
        return tuple(sorted(self.targets, key=lambda target: target.difference.mean))


def compare(
    organ: Organ,
    interaction: Interaction,
    reference: Subject | Trajectory,
    targets: Sequence[Subject],
    progress: Progress | None = None,
) -> Comparison:
    """Play one interaction to a reference and to targets.

    Args:
        organ: The organ.
        interaction: What is held, for all of them.
        reference: The model to come close to, or what was measured or simulated before.
        targets: The models that are judged.
        progress: Told how far it is.

    Raises:
        ValueError: A subject, the interaction or the reference does not go with the organ.
    """
    for subject in targets:
        subject.checked()
    subject_of = reference if isinstance(reference, Subject) else None
    moved = (
        _played(reference, organ, interaction, progress)
        if isinstance(reference, Subject)
        else reference
    )
    worst = difference(organ, only_held(organ, interaction), moved)
    results = []
    for subject in targets:
        trajectory = _played(subject, organ, interaction, progress)
        apart = difference(organ, trajectory, moved)
        results.append(Target(subject, trajectory, apart, apart.mean / worst.mean))
    return Comparison(organ, interaction, moved, subject_of, worst, tuple(results))


def _played(
    subject: Subject, organ: Organ, interaction: Interaction, progress: Progress | None
) -> Trajectory:
    if progress is None:
        return simulate(subject, organ, interaction)
    frames = interaction.frames
    progress(subject.name, 0, frames)
    return simulate(
        subject, organ, interaction, lambda frame: progress(subject.name, frame + 1, frames)
    )
