"""Where the candidates of a fit are evaluated: in this process, in several, or on a cluster.

All of them give the same evaluations in the same order, so which one is used changes nothing but
the time.
"""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.fit.problem import Evaluation, Problem


class WorkersError(ValueError):
    """Candidates cannot be evaluated where they should be; the message says why."""


class Workers(Protocol):
    """Evaluates candidates of one problem; a context manager that closes itself."""

    def evaluate(self, candidates: NDArray[np.float64]) -> list[Evaluation]:
        """Evaluate a generation.

        Args:
            candidates: Points of the unit cube, shape (count, size).

        Returns:
            The evaluation of each, in this order.

        Raises:
            WorkersError: They cannot be evaluated there.
        """
        ...

    def close(self) -> None:
        """Give back everything that was started for it; may be called again."""
        return

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


class Serial(Workers):
    """One candidate after the other in this process."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    def evaluate(self, candidates: NDArray[np.float64]) -> list[Evaluation]:
        """Evaluate a generation; see `Workers.evaluate`."""
        return [self._problem.evaluate(candidate) for candidate in candidates]


def workers_of(
    problem: Problem, processes: int | None = None, scheduler: str | None = None
) -> Workers:
    """The workers that a person asks for.

    Args:
        problem: What they evaluate candidates of.
        processes: Processes on this machine, 1: this one; None: one for each processor.
        scheduler: Address of a Dask scheduler; None: this machine.

    Raises:
        ValueError: Both are given, or there cannot be so many processes.
        WorkersError: Nothing usable answers at the address.
    """
    if scheduler is None:
        from tissue_sim.compare.fit.process_pool import ProcessPool

        return Serial(problem) if processes == 1 else ProcessPool(problem, processes)
    if processes is not None:
        raise ValueError(
            f"{processes} processes here and the scheduler {scheduler} are asked for; allowed: one "
            "of them (Dask's workers say themselves how many there are)"
        )
    # Dask takes a second and a half to import.
    from tissue_sim.compare.fit.dask_workers import DaskWorkers

    return DaskWorkers(problem, scheduler)
