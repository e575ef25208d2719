"""Evaluations on a Dask cluster."""

from __future__ import annotations

import hashlib
import logging
import math
import pickle
import platform
import time
import warnings
from concurrent.futures import CancelledError
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np
from distributed import Client, Future, KilledWorker, as_completed
from numpy.typing import NDArray

import tissue_sim
from tissue_sim.compare.fit.problem import Evaluation, Problem
from tissue_sim.compare.fit.workers import Workers, WorkersError

PATIENCE = 5.0
"""Longest wait for a scheduler, and then for a worker of it [s]."""

TASK_SECONDS = 0.1
"""Time of a task beside which Dask's own work on it, a millisecond or two, does not matter [s]."""


class DaskWorkers(Workers):
    """Evaluates candidates on the workers of a Dask scheduler.

    Dask does again what was under way on a worker that is lost. An evaluation depends on nothing
    but the candidate, so it comes out the same.
    """

    def __init__(self, problem: Problem, scheduler: str) -> None:
        """Connect, and hand the problem to the cluster.

        Args:
            problem: What candidates are evaluated of.
            scheduler: Address of the scheduler, such as tcp://10.0.0.1:8786.

        Raises:
            WorkersError: Nobody answers there, it has no workers, or one of them runs something
                else than this process.
        """
        self._space, self._scheduler = problem.space, scheduler
        self._client = _connected(scheduler)
        self._seconds = math.inf
        try:
            _check_alike(self._client)
            self._problem = _handed(self._client, problem)
        except BaseException:
            self.close()
            raise

    def evaluate(self, candidates: NDArray[np.float64]) -> list[Evaluation]:
        """Evaluate a generation; see `Workers.evaluate`.

        Raises:
            WorkersError: The scheduler is lost, or a candidate ends every worker it is given.
        """
        chunks = self._chunks(candidates)
        futures = self._client.map(_evaluated, chunks, problem=self._problem, pure=False)
        chunk_of = {future.key: number for number, future in enumerate(futures)}
        answers: dict[int, tuple[list[Evaluation], float]] = {}
        try:
            # Each is fetched at once: what is here is not lost with the worker that found it out.
            for future, answer in as_completed(futures, loop=self._client.loop, with_results=True):
                if isinstance(answer, CancelledError):
                    raise answer
                answers[chunk_of[future.key]] = answer
                future.release()
        except KilledWorker as error:
            number = chunk_of.get(error.task)
            raise self._given_up(None if number is None else chunks[number], error) from error
        except CancelledError as error:
            # Dask goes on to say the same on several screens.
            logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
            raise WorkersError(f"the Dask scheduler at {self._scheduler} is lost") from error
        self._seconds = sum(seconds for _, seconds in answers.values()) / max(len(candidates), 1)
        return [each for number in range(len(chunks)) for each in answers[number][0]]

    def close(self) -> None:
        """Leave the cluster, which goes on."""
        self._client.close()

    def _chunks(self, candidates: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Candidates of each task: one, or several if they take no time; all threads get some."""
        if not len(candidates):
            return []
        threads = max(sum(self._client.nthreads().values()), 1)
        fewest = min(threads, len(candidates))
        tasks = math.ceil(len(candidates) * min(self._seconds / TASK_SECONDS, 1.0))
        return np.array_split(candidates, max(tasks, fewest))

    def _given_up(self, chunk: NDArray[np.float64] | None, error: KilledWorker) -> WorkersError:
        named = "the problem"
        if chunk is not None:
            decoded = [self._space.decode(unit).items() for unit in chunk]
            named = " or ".join(
                f"({', '.join(f'{name}={value:.6g}' for name, value in values)})"
                for values in decoded
            )
        return WorkersError(
            f"candidate {named} was on each of {error.allowed_failures + 1} workers when they "
            "ended: it, or one that waited there too, ended them; what the last one, "
            f"{error.last_worker.address}, said stands in its log"
        )


def _connected(scheduler: str) -> Client:
    """A client of a scheduler that has a worker at least."""
    try:
        client = Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise WorkersError(
            f"no Dask scheduler answers at {scheduler!r} ({error}); allowed: an address such as "
            "tcp://10.0.0.1:8786, where `dask scheduler` runs, and `dask worker ADDRESS` on each "
            "machine that evaluates"
        ) from error
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError as error:
        client.close()
        raise WorkersError(
            f"the Dask scheduler at {scheduler} has no workers; start some: on each machine "
            f"`dask worker {scheduler}`"
        ) from error
    return client


def _handed(client: Client, problem: Problem) -> Future:
    """The problem on the cluster.

    As a task, not as scattered data: the scheduler keeps it, so that workers can have it that come
    later, even when all that had it are lost.
    """
    pickled = pickle.dumps(problem, pickle.HIGHEST_PROTOCOL)
    key = f"problem-{hashlib.sha256(pickled).hexdigest()[:16]}"
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sending large graph")
        return client.submit(pickle.loads, pickled, key=key)


def _evaluated(candidates: NDArray[np.float64], problem: Problem) -> tuple[list[Evaluation], float]:
    """On a worker: the evaluations, and the time they took [s]."""
    begun = time.perf_counter()
    return [problem.evaluate(unit) for unit in candidates], time.perf_counter() - begun


def _check_alike(client: Client) -> None:
    """Refuse workers that run something else than this process.

    Raises:
        WorkersError: One of them does; the message says which, and what.
    """
    here = environment()
    for worker, there in client.run(environment, on_error="return").items():
        if isinstance(there, BaseException):
            raise WorkersError(f"worker {worker} does not have this tissue_sim: {there!r}")
        unlike = [
            f"{name} {there[name]}, here {here[name]}" for name in here if there[name] != here[name]
        ]
        if unlike:
            raise WorkersError(
                f"worker {worker} runs {'; '.join(unlike)}: start it with the same packages and "
                "the same sources as this process"
            )


@cache
def environment() -> dict[str, str]:
    """What evaluations depend on besides the candidate, by name."""
    sources = hashlib.sha256()
    root = Path(tissue_sim.__file__).parent
    for package in ("compare", "compare/fit", "elastic", "geometry", "kernels"):
        for path in sorted((root / package).glob("*.py")):
            sources.update(path.read_bytes())
    return {
        "Python": ".".join(platform.python_version_tuple()[:2]),
        **{name: version(name) for name in ("numpy", "scipy", "numba")},
        "tissue_sim": sources.hexdigest()[:8],
    }
