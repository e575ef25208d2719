"""All that a fit comes to: the best values, the way there, the price of speed and the landscape."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tissue_sim.compare.fit.checkpoint import Generation
from tissue_sim.compare.fit.landscape import Landscape, landscape
from tissue_sim.compare.fit.pareto import SpeedFront, speed_front
from tissue_sim.compare.fit.problem import Problem
from tissue_sim.compare.fit.search import FitResult, search
from tissue_sim.compare.fit.settings import FitSettings
from tissue_sim.compare.fit.task import strategy_of
from tissue_sim.compare.fit.workers import workers_of
from tissue_sim.compare.report.result import (
    interaction_document,
    made,
    number,
    organ_document,
    subject_document,
)
from tissue_sim.compare.subject import Subject
from tissue_sim.whole_files import write_json

FORMAT = 1
"""Version of the JSON."""

CHECKPOINT = "checkpoint.json"
"""File in a fit's folder from which it can go on."""

AT_BOUND = 0.005
"""Share of a range within which a value is at its bound."""

Told = Callable[[str, int, int, float | None], None]
"""Told what is done, how far it is, how far it goes, and the smallest error so far."""


@dataclass(frozen=True)
class FitOutcome:
    """What a fit came to.

    Attributes:
        problem: What was minimised.
        strategy: How it was searched, as plain JSON values by name.
        found: What the search found.
        seconds: Time of the search in this run [s].
        tolerance: Error relative to the worst that is good enough.
        front: The best at several efforts; None: nobody asked.
        grid: The landscape; None: nobody asked.
    """

    problem: Problem
    strategy: dict[str, Any]
    found: FitResult
    seconds: float
    tolerance: float
    front: SpeedFront | None = None
    grid: Landscape | None = None

    @property
    def subject(self) -> Subject:
        """The target with the best values."""
        return self.problem.subject.with_values(self.found.best.values)

    @property
    def at_bounds(self) -> dict[str, str]:
        """Best values that are at a bound, "lower" or "upper" by name: the range hides better."""
        best = self.found.best
        sides = {}
        for name, place in zip(self.problem.space.names, best.unit, strict=True):
            if place <= AT_BOUND or place >= 1.0 - AT_BOUND:
                sides[name] = "lower" if place <= AT_BOUND else "upper"
        return sides

    def to_json(self, command: str = "") -> dict[str, Any]:
        """Plain JSON values in SI units; docs/fit.md says what they are.

        Args:
            command: The command that made it, as a person would type it again.
        """
        best = self.found.best
        return {
            "format": FORMAT,
            "made": made(command),
            "organ": organ_document(self.problem.organ),
            "target": subject_document(self.problem.subject),
            "ranges": [asdict(parameter) for parameter in self.problem.space.parameters],
            "cases": [
                {
                    "interaction": interaction_document(case.interaction),
                    "reference": case.reference.label,
                    "worst_mean_m": number(case.worst),
                }
                for case in self.problem.cases
            ],
            "strategy": self.strategy,
            "best": {
                **best.to_json(), "subject": self.subject.text, "at_bounds": self.at_bounds,
            },
            "seconds": self.seconds,
            "finished": self.found.finished,
            "generations": [asdict(generation) for generation in self.found.history],
            "evaluations": [evaluation.to_json() for evaluation in self.found.evaluations],
            "tolerance": self.tolerance,
            "speed": None if self.front is None else self.front.to_json(),
            "landscape": None if self.grid is None else self.grid.to_json(),
        }  # fmt: skip

    def write(self, path: Path, command: str = "") -> None:
        """Write `to_json`, whole or not at all."""
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, self.to_json(command))


def run_fit(settings: FitSettings, problem: Problem, out: Path, told: Told) -> FitOutcome:
    """Search, and what else the settings ask for.

    Args:
        settings: How it is searched.
        problem: The problem that they pose.
        out: Folder of the checkpoints: what is there already is gone on with.
        told: Told how far it is.

    Raises:
        ValueError: As `search` and `workers_of`.
    """
    strategy = strategy_of(settings)

    def on_generation(generation: Generation) -> None:
        told("search", generation.number, settings.generations, generation.best)

    begun = time.perf_counter()
    with workers_of(problem, settings.processes, settings.scheduler) as workers:
        found = search(
            problem, strategy, workers, settings.generations, out / CHECKPOINT, on_generation
        )
        seconds = time.perf_counter() - begun
        grid = None
        if settings.landscape is not None:
            grid = landscape(
                problem, workers, *settings.landscape.names, settings.landscape.points,
                found.best.values, lambda row, rows: told("landscape", row, rows, None),
            )  # fmt: skip
    front = _front(settings, problem, out, told) if settings.pareto else None
    return FitOutcome(problem, strategy.settings, found, seconds, settings.tolerance, front, grid)


def _front(settings: FitSettings, problem: Problem, out: Path, told: Told) -> SpeedFront:
    def on_generation(steps: float, generation: Generation) -> None:
        told(f"{steps:g} a frame", generation.number, settings.generations, generation.best)

    return speed_front(
        problem, settings.pareto, lambda start: strategy_of(settings, start),
        lambda each: workers_of(each, settings.processes, settings.scheduler),
        settings.generations, out, on_generation,
    )  # fmt: skip
