"""The search for the best values: a strategy asks, workers answer, generation after generation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.fit.checkpoint import Checkpoint, Generation
from tissue_sim.compare.fit.problem import Evaluation, Problem
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.fit.strategy import Strategy
from tissue_sim.compare.fit.workers import Workers

OnGeneration = Callable[[Generation], None]
"""Told each generation when it is done, its checkpoint written."""


@dataclass(frozen=True)
class FitResult:
    """What a search found.

    Attributes:
        best: The smallest error; of a stable model if any was.
        evaluations: All evaluations, in the order of the candidates; no values twice.
        history: The generations.
        finished: Whether the strategy saw no sense in going on.
    """

    best: Evaluation
    evaluations: tuple[Evaluation, ...]
    history: tuple[Generation, ...]
    finished: bool

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return asdict(self)


def search(
    problem: Problem,
    strategy: Strategy,
    workers: Workers,
    generations: int,
    checkpoint: Path | None = None,
    on_generation: OnGeneration | None = None,
) -> FitResult:
    """Search for the values with the smallest error.

    A search that was interrupted, by whatever, goes on from the last whole generation when it is
    called again with the same checkpoint, and finds the same, bit for bit, as one that was not.
    Values that come up again are not evaluated again.

    Args:
        problem: What is minimised.
        strategy: Where to look; a new one.
        workers: What evaluates the candidates of this problem.
        generations: Generations in all, those of the checkpoint included.
        checkpoint: File that is written after each generation; None: none.
        on_generation: Told each generation that is done; those of the checkpoint are not told.

    Raises:
        CheckpointError: The checkpoint is of another problem, strategy or seed.
        ValueError: There are no generations.
    """
    if generations < 1:
        raise ValueError(f"{generations} generations are too few; allowed: from 1")
    so_far = Checkpoint.resume(checkpoint, {**problem.identity, "strategy": strategy.settings})
    if so_far.strategy is not None:
        strategy.restore(so_far.strategy)
    memory = _Memory(problem.space, so_far.evaluations)
    while len(so_far.history) < generations and not strategy.finished:
        candidates = strategy.ask()
        played = memory.evaluate(candidates, workers)
        known = memory.of(candidates)
        strategy.tell(candidates, np.array([evaluation.error for evaluation in known]))
        so_far.evaluations += played
        so_far.history.append(_generation(so_far, known, len(played)))
        so_far.strategy = strategy.state()
        if checkpoint is not None:
            so_far.save(checkpoint)
        if on_generation is not None:
            on_generation(so_far.history[-1])
    evaluations = so_far.evaluations
    return FitResult(
        best_of(evaluations), tuple(evaluations), tuple(so_far.history), strategy.finished
    )


def best_of(evaluations: list[Evaluation]) -> Evaluation:
    """The smallest error, the first of equal ones; a model that is lost only if all are."""
    return min(evaluations, key=lambda evaluation: (not evaluation.stable, evaluation.error))


class _Memory:
    """Evaluations by their values: whole numbers and parents that live on come up again."""

    def __init__(self, space: Space, evaluations: list[Evaluation]) -> None:
        self._space = space
        self._known = {tuple(entry.values.values()): entry for entry in evaluations}

    def evaluate(self, candidates: NDArray[np.float64], workers: Workers) -> list[Evaluation]:
        """Evaluate what is not known, each values once; what was evaluated."""
        new: dict[tuple[float, ...], int] = {}
        for number, candidate in enumerate(candidates):
            key = self._key(candidate)
            if key not in self._known:
                new.setdefault(key, number)
        played = workers.evaluate(candidates[list(new.values())]) if new else []
        self._known.update(zip(new, played, strict=True))
        return played

    def of(self, candidates: NDArray[np.float64]) -> list[Evaluation]:
        """The evaluations of candidates that are known."""
        return [self._known[self._key(candidate)] for candidate in candidates]

    def _key(self, candidate: NDArray[np.float64]) -> tuple[float, ...]:
        return tuple(self._space.decode(candidate).values())


def _generation(so_far: Checkpoint, known: list[Evaluation], played: int) -> Generation:
    return Generation(
        number=len(so_far.history) + 1,
        best=best_of(so_far.evaluations).error,
        median=float(np.median([evaluation.error for evaluation in known])),
        played=played,
        unstable=sum(not evaluation.stable for evaluation in known),
    )
