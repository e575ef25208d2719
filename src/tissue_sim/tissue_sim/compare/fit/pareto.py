"""Speed as a second objective: how small the error can be with how few steps a frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tissue_sim.compare.effort import Effort
from tissue_sim.compare.fit.checkpoint import Generation
from tissue_sim.compare.fit.problem import Evaluation, Problem
from tissue_sim.compare.fit.search import search
from tissue_sim.compare.fit.strategy import Strategy
from tissue_sim.compare.fit.workers import Workers
from tissue_sim.compare.trajectory import simulate

TIMED = 3
"""Times that the best of a step count is played to see how long its frames take."""


@dataclass(frozen=True)
class SpeedPoint:
    """The best that was found at one effort.

    Attributes:
        steps: Steps a frame.
        ms_per_frame: Time they take on this machine, median over the frames [ms]; None: the model
            is lost.
        best: The values and their error.
    """

    steps: float
    ms_per_frame: float | None
    best: Evaluation


@dataclass(frozen=True)
class SpeedFront:
    """What was found at several efforts.

    Attributes:
        points: One for each effort, the fewest steps first.
    """

    points: tuple[SpeedPoint, ...]

    @property
    def front(self) -> tuple[SpeedPoint, ...]:
        """Those than which no other one is both as fast and as close: the Pareto front.

        Efforts at which the model is always lost are not among them.
        """
        stable = [point for point in self.points if point.best.stable]
        chosen = pareto_front([(point.steps, point.best.error) for point in stable])
        return tuple(stable[row] for row in chosen)

    def fewest_steps_within(self, tolerance: float) -> SpeedPoint:
        """The fewest steps with which the error is at most `tolerance` (1: the worst).

        Raises:
            ValueError: It is larger at every effort; the message says the smallest.
        """
        for point in self.front:
            if point.best.error <= tolerance:
                return point
        closest = min(self.points, key=lambda point: point.best.error)
        raise ValueError(
            f"no effort has an error within {tolerance:g} of the worst; the smallest is "
            f"{closest.best.error:.3g}, with {closest.steps:g} steps a frame"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values: all points, and the steps of those that are the front."""
        return {
            "points": [asdict(point) for point in self.points],
            "front": [point.steps for point in self.front],
        }


def pareto_front(points: ArrayLike) -> NDArray[np.intp]:
    """Rows of points that no other one dominates, the smallest first objective first.

    A point dominates another if it is no worse in any objective and better in one. Of equal points
    the first counts.

    Args:
        points: Two objectives of each, both the smaller the better, shape (n, 2).
    """
    objectives = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    order = np.lexsort((objectives[:, 1], objectives[:, 0]))
    least = np.minimum.accumulate(np.concatenate([[np.inf], objectives[order, 1]]))[:-1]
    front: NDArray[np.intp] = order[objectives[order, 1] < least]
    return front


def speed_front(
    problem: Problem,
    steps: Iterable[float],
    strategy_of: Callable[[NDArray[np.float64] | None], Strategy],
    workers_of: Callable[[Problem], Workers],
    generations: int,
    folder: Path | None = None,
    on_generation: Callable[[float, Generation], None] | None = None,
) -> SpeedFront:
    """Fit a subject at several efforts, each from the best of the one before.

    What is best depends on the steps that there are: few want to be large, or stiff springs.

    Args:
        problem: What is minimised; its effort is replaced.
        steps: Steps a frame.
        strategy_of: A new strategy that starts at a point of the unit cube, shape (size,); None:
            wherever it likes.
        workers_of: What evaluates candidates of a problem; closed when an effort is done.
        generations: Generations at each effort.
        folder: Where the searches keep their checkpoints; None: nowhere.
        on_generation: Told the steps and each generation that is done.

    Raises:
        ValueError: No steps are given; or as `search`.
    """
    points: list[SpeedPoint] = []
    for count in sorted(set(steps)):
        effort = replace(problem, subject=replace(problem.subject, effort=Effort(steps=count)))
        start = np.array(points[-1].best.unit) if points else None
        told = None if on_generation is None else _telling(on_generation, count)
        checkpoint = None if folder is None else folder / f"steps_{count:g}.json"
        with workers_of(effort) as workers:
            found = search(effort, strategy_of(start), workers, generations, checkpoint, told)
        points.append(SpeedPoint(count, _time_of(effort, found.best), found.best))
    if not points:
        raise ValueError("there is no effort to fit at; allowed: one or several steps a frame")
    return SpeedFront(tuple(points))


def _telling(
    on_generation: Callable[[float, Generation], None], steps: float
) -> Callable[[Generation], None]:
    return lambda generation: on_generation(steps, generation)


def _time_of(problem: Problem, best: Evaluation) -> float | None:
    """Time a frame of the first case [ms]: of several runs the fastest."""
    if not best.stable:
        return None
    subject, case = problem.subject.with_values(best.values), problem.cases[0]
    runs = (simulate(subject, problem.organ, case.interaction) for _ in range(TIMED))
    return min(run.ms_per_frame for run in runs)
