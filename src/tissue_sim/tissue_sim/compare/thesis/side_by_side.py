"""Many small fits at once on one set of processes, generation by generation."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.fit.evolutionary import Evolutionary
from tissue_sim.compare.fit.problem import Evaluation, Problem
from tissue_sim.compare.fit.workers import workers_of
from tissue_sim.whole_files import write_json

PORTION = 96
"""Candidates between two reports."""

Progress = Callable[[int, int], None]
"""Told how many candidates are evaluated, and of how many."""


@dataclass(frozen=True)
class Bundle:
    """Problems side by side: the first number of a candidate says whose it is.

    Attributes:
        problems: The problems.
    """

    problems: tuple[Problem, ...]

    def evaluate(self, candidate: NDArray[np.float64]) -> Evaluation:
        """Evaluate a candidate of one of them, shape (1 + the largest space's size,)."""
        problem = self.problems[int(candidate[0])]
        return problem.evaluate(candidate[1 : 1 + problem.space.size])


@dataclass
class _Fit:
    """A fit on its way."""

    strategy: Evolutionary
    generations: int
    best: Evaluation | None = None

    def learn(self, asked: NDArray[np.float64], evaluations: Sequence[Evaluation]) -> None:
        self.strategy.tell(asked, np.array([evaluation.error for evaluation in evaluations]))
        known = [*evaluations] if self.best is None else [self.best, *evaluations]
        self.best = min(known, key=lambda evaluation: evaluation.error)


def fit_all(
    problems: Sequence[Problem],
    generations: Sequence[int],
    seed: int,
    population: int,
    processes: int | None = None,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
) -> list[Evaluation]:
    """Fit each problem with the thesis' evolutionary algorithm; the best of each.

    Interrupted and begun again with the same arguments, the result is that of one run bit for bit.

    Args:
        problems: What is fitted.
        generations: Generations of each.
        seed: Of the random numbers; every problem has its own.
        population: Individuals of each.
        processes: Processes on this machine; None: one for each processor.
        checkpoint: File that is written after every generation, and read if it is there.
        progress: Told how far it is.
    """
    fits = [
        _Fit(Evolutionary(problem.space.size, seed + which, population), count)
        for which, (problem, count) in enumerate(zip(problems, generations, strict=True))
    ]
    identity = _identity(problems, generations, seed, population)
    begin = _resume(checkpoint, identity, fits)
    last = max(generations, default=0)
    total = sum(population + (count - 1) * (population - 1) for count in generations)
    if begin < last:
        bundle = cast(Problem, Bundle(tuple(problems)))  # Workers ask for nothing but `evaluate`.
        with workers_of(bundle, processes) as workers:
            for generation in range(begin, last):
                running = [which for which, fit in enumerate(fits) if fit.generations > generation]
                asked = [fits[which].strategy.ask() for which in running]
                done = sum(_asked(fit, generation, population) for fit in fits)
                candidates = _stacked(running, asked)
                evaluations: list[Evaluation] = []
                for first in range(0, len(candidates), PORTION):
                    evaluations += workers.evaluate(candidates[first : first + PORTION])
                    if progress:
                        progress(done + len(evaluations), total)
                for which, points in zip(running, asked, strict=True):
                    own, evaluations = evaluations[: len(points)], evaluations[len(points) :]
                    fits[which].learn(points, own)
                if checkpoint:
                    _save(checkpoint, identity, generation + 1, fits)
    return [fit.best for fit in fits if fit.best is not None]


def _asked(fit: _Fit, generation: int, population: int) -> int:
    """Candidates that a fit has asked for before a generation."""
    before = min(generation, fit.generations)
    return before and population + (before - 1) * (population - 1)


def _stacked(running: Sequence[int], asked: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Candidates as a `Bundle` reads them."""
    widest = max(points.shape[1] for points in asked)
    rows = [
        np.pad(np.column_stack([np.full(len(points), which), points]),
               ((0, 0), (0, widest - points.shape[1])))
        for which, points in zip(running, asked, strict=True)
    ]  # fmt: skip
    return np.concatenate(rows)


def _identity(
    problems: Sequence[Problem], generations: Sequence[int], seed: int, population: int
) -> str:
    told = [[problem.identity for problem in problems], list(generations), seed, population]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def _save(path: Path, identity: str, generation: int, fits: Sequence[_Fit]) -> None:
    state = [
        {"strategy": fit.strategy.state(), "best": fit.best.to_json() if fit.best else None}
        for fit in fits
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, {"identity": identity, "generation": generation, "fits": state})


def _resume(path: Path | None, identity: str, fits: Sequence[_Fit]) -> int:
    """The generation to go on with; fits that were on their way are put back there."""
    if path is None or not path.is_file():
        return 0
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    if content.get("identity") != identity:
        return 0  # Of another experiment: it is overwritten.
    for fit, state in zip(fits, content["fits"], strict=True):
        fit.strategy.restore(state["strategy"])
        fit.best = Evaluation.from_json(state["best"]) if state["best"] else None
    return int(content["generation"])
