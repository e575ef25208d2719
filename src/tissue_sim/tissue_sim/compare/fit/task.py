"""From what a fit is asked for to what is searched, and by what."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.comparison import Progress
from tissue_sim.compare.fit.cma_es import CmaEs
from tissue_sim.compare.fit.evolutionary import Evolutionary
from tissue_sim.compare.fit.problem import Problem, case_of
from tissue_sim.compare.fit.settings import MEASURED, FitSettings
from tissue_sim.compare.fit.strategy import Strategy
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.reference_cache import cached
from tissue_sim.compare.sources.choose import interaction_from, reference_from
from tissue_sim.compare.sources.recorded import Recording
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import Trajectory

ALGORITHMS: dict[str, type[Evolutionary] | type[CmaEs]] = {"ea": Evolutionary, "cma": CmaEs}
"""Strategies by name."""


def problem_of(
    settings: FitSettings,
    organ: Organ | None,
    progress: Progress | None = None,
    say: Callable[[str], None] = print,
    cache: Path | None = None,
) -> Problem:
    """The problem that settings pose, its references computed.

    Args:
        settings: What is fitted to what.
        organ: The organ that they name; None: that of the recording.
        progress: Told how far a reference is.
        say: Told what a person should know of a recording.
        cache: Folder of references that were computed before; None: the user's.

    Raises:
        ValueError: An organ, interaction or reference is not there or does not go with the others.
        OSError: A file cannot be read.
    """
    cases = []
    for text in settings.interactions:
        recording = interaction_from(
            text, organ, settings.rate_hz, settings.namespace or None, settings.epoch
        )
        for note in recording.notes:
            say(f"{text}: {note}")
        organ = recording.organ
        reference = _reference(settings.reference, recording, progress, say, cache)
        cases.append(case_of(organ, recording.interaction, reference))
    if organ is None:
        raise ValueError("there is no interaction to fit to; allowed: one or several")
    return Problem(organ, settings.target, settings.space, tuple(cases))


def strategy_of(settings: FitSettings, start: NDArray[np.float64] | None = None) -> Strategy:
    """The strategy that settings ask for, at its beginning.

    Args:
        settings: What is fitted, and how.
        start: Where it starts in the unit cube, shape (size,); None: wherever it likes.
    """
    algorithm = ALGORITHMS[settings.strategy]
    given = {} if settings.population is None else {"population": settings.population}
    return algorithm(len(settings.ranges), settings.seed, start=start, **given)


def _reference(
    reference: Subject | Path | str,
    recording: Recording,
    progress: Progress | None,
    say: Callable[[str], None],
    cache: Path | None,
) -> Trajectory:
    organ, interaction = recording.organ, recording.interaction
    if reference == MEASURED:
        return recording.reference()
    if isinstance(reference, Path):
        return reference_from(reference, organ, interaction)
    assert isinstance(reference, Subject)

    def on_frame(frame: int) -> None:
        if progress is not None:
            progress(f"{reference.name}, {interaction.name}", frame + 1, interaction.frames)

    return cached(reference, organ, interaction, cache, on_frame, say)
