"""What an evaluation costs beside its own time where it is not made in this process."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import cast

import numpy as np
from distributed import LocalCluster
from numpy.typing import NDArray

from tissue_sim.compare.fit.dask_workers import TASK_SECONDS, DaskWorkers
from tissue_sim.compare.fit.problem import Evaluation, Problem
from tissue_sim.compare.fit.process_pool import ProcessPool
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.fit.workers import Workers


@dataclass(frozen=True)
class Sleeping:
    """Stands for a problem whose evaluations take a known time and nothing of the machine.

    Attributes:
        space: Where candidates are.
    """

    space: Space

    def evaluate(self, unit: NDArray[np.float64]) -> Evaluation:
        """Sleep."""
        time.sleep(TASK_SECONDS)
        return Evaluation(tuple(map(float, unit)), self.space.decode(unit), 0.0, True, 0.0)


@contextmanager
def pool(problem: Problem, count: int) -> Iterator[Workers]:
    """Processes of this machine."""
    with ProcessPool(problem, count) as workers:
        yield workers


@contextmanager
def dask(problem: Problem, count: int) -> Iterator[Workers]:
    """A cluster on this machine."""
    with (
        LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs=logging.ERROR,
        ) as cluster,
        DaskWorkers(problem, cluster.scheduler_address) as workers,
    ):
        yield workers


WAYS: dict[str, Callable[[Problem, int], AbstractContextManager[Workers]]] = {
    "pool": pool,
    "dask": dask,
}


def seconds_of(workers: Workers, candidates: NDArray[np.float64]) -> float:
    """Time of a generation [s]."""
    begun = time.perf_counter()
    workers.evaluate(candidates)
    return time.perf_counter() - begun


def overhead(space: Space, way: str, number: int, count: int) -> float:
    """Time that an evaluation costs besides its own, found with some that only sleep [s]."""
    candidates = np.random.default_rng(2).random((count, space.size))
    with WAYS[way](cast(Problem, Sleeping(space)), number) as workers:
        workers.evaluate(candidates)
        asleep = math.ceil(count / number) * TASK_SECONDS
        return (seconds_of(workers, candidates) - asleep) / count


def predicted(
    population: int, cores: int, evaluation_s: float, overhead_s: float, generations: int
) -> float:
    """Time of a fit on many cores [s].

    The next generation needs all errors of the last one, so cores beyond its candidates are idle;
    and one process hands out candidates one after the other.
    """
    rounds = math.ceil(population / cores)
    return generations * (rounds * evaluation_s + population * overhead_s)
