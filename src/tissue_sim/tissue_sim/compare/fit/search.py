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
    memory = {_key(evaluation.values): evaluation for evaluation in so_far.evaluations}
    while len(so_far.history) < generations and not strategy.finished:
        candidates = strategy.ask()
        new = _not_known(problem.space, candidates, memory)
        played = workers.evaluate(candidates[new]) if new else []
        memory.update((_key(evaluation.values), evaluation) for evaluation in played)
        known = [memory[_key(problem.space.decode(candidate))] for candidate in candidates]
        errors = np.array([evaluation.error for evaluation in known])
        strategy.tell(candidates, errors)
        so_far.evaluations += played
        so_far.history.append(
            Generation(
                len(so_far.history) + 1,
                best_of(so_far.evaluations).error,
                float(np.median(errors)),
                len(played),
                sum(not e.stable for e in known),
            )  # fmt: skip
        )
        so_far.strategy = strategy.state()
        if checkpoint is not None:
            so_far.save(checkpoint)
        if on_generation is not None:
            on_generation(so_far.history[-1])
    return FitResult(
        best_of(so_far.evaluations), tuple(so_far.evaluations), tuple(so_far.history),
        strategy.finished,
    )  # fmt: skip


def best_of(evaluations: list[Evaluation]) -> Evaluation:
    """The smallest error, the first of equal ones; a model that is lost only if all are."""
    return min(evaluations, key=lambda evaluation: (not evaluation.stable, evaluation.error))


def _not_known(
    space: Space, candidates: NDArray[np.float64], memory: dict[tuple[float, ...], Evaluation]
) -> list[int]:
    """Which candidates have to be evaluated: of those with equal values the first, if none was."""
    first: dict[tuple[float, ...], int] = {}
    for number, candidate in enumerate(candidates):
        first.setdefault(_key(space.decode(candidate)), number)
    return [number for key, number in first.items() if key not in memory]


def _key(values: dict[str, float]) -> tuple[float, ...]:
    return tuple(values.values())
