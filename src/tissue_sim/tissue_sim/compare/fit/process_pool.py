"""Evaluations on several processes of this machine.

A pool of `concurrent.futures` loses all that is under way when one of its processes dies, and does
not know which candidate did it. Here each process has a connection of its own: the one candidate
that a dead process was at is evaluated again by its successor.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
from collections import Counter, deque
from multiprocessing.connection import wait

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.fit import worker_process
from tissue_sim.compare.fit.problem import Evaluation, Problem
from tissue_sim.compare.fit.workers import Workers, WorkersError

MOST_DEATHS = 3
"""Processes that may die of one candidate, or before they are ready."""

_ONE_THREAD = dict.fromkeys(
    ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
"""Environment of the processes: they share the processors, so their threads should not."""

_STARTING, _FREE = -2, -1
"""What a process is at that is at no candidate."""


class ProcessPool(Workers):
    """Evaluates candidates on processes of this machine, with one thread each."""

    def __init__(self, problem: Problem, processes: int | None = None) -> None:
        """Start the processes.

        Args:
            problem: What they evaluate candidates of; each of them is told once.
            processes: Number of processes; None: one for each processor that this one may use.

        Raises:
            ValueError: There cannot be so many.
        """
        self.processes = len(os.sched_getaffinity(0)) if processes is None else processes
        if self.processes < 1:
            raise ValueError(f"{processes} processes are not possible; allowed: 1 or more")
        self._problem = problem
        self._pickled = pickle.dumps(problem, pickle.HIGHEST_PROTOCOL)
        self._running: list[_Process] = []
        self._start_missing()

    def evaluate(self, candidates: NDArray[np.float64]) -> list[Evaluation]:
        """Evaluate a generation; see `Workers.evaluate`.

        Raises:
            WorkersError: Processes do not start, or die of one candidate again and again.
        """
        try:
            return self._evaluate(candidates)
        except BaseException:
            # Nobody waits any more for what they are at, after Ctrl-C for example.
            self.close()
            raise

    def close(self) -> None:
        """End the processes, whatever they are at."""
        for process in self._running:
            process.end()
        self._running.clear()

    def _start_missing(self) -> None:
        while len(self._running) < self.processes:
            self._running.append(_Process())

    def _evaluate(self, candidates: NDArray[np.float64]) -> list[Evaluation]:
        done: dict[int, Evaluation] = {}
        waiting = deque(range(len(candidates)))
        deaths: Counter[int] = Counter()
        while len(done) < len(candidates):
            self._start_missing()
            for process in self._running:
                if process.at == _FREE and waiting:
                    at = waiting.popleft()
                    process.begin(at, candidates[at])
            heard = wait([process.connection for process in self._running])
            for process in [each for each in self._running if each.connection in heard]:
                at = process.at
                try:
                    said = process.hear(self._pickled)
                except OSError:
                    self._running.remove(process)
                    reason = process.end()
                    deaths[at] += 1
                    if at != _FREE and deaths[at] == MOST_DEATHS:
                        raise self._given_up(candidates, at, reason) from None
                    if at >= 0:
                        waiting.appendleft(at)
                    continue
                if isinstance(said, Exception):
                    raise said
                if said is not None:
                    done[at] = said
        return [done[at] for at in range(len(candidates))]

    def _given_up(self, candidates: NDArray[np.float64], at: int, reason: str) -> WorkersError:
        if at == _STARTING:
            return WorkersError(
                f"{MOST_DEATHS} worker processes ended before they were ready ({reason}); what "
                "they said about it stands above"
            )
        values = self._problem.space.decode(candidates[at])
        named = ", ".join(f"{name}={value:.6g}" for name, value in values.items())
        return WorkersError(
            f"candidate {at + 1} of {len(candidates)} ({named}) ended each of the {MOST_DEATHS} "
            f"worker processes that evaluated it ({reason})"
        )


class _Process:
    """A worker process.

    Attributes:
        connection: Way to it.
        at: Number of the candidate that it is at, `_STARTING` or `_FREE`.
    """

    def __init__(self) -> None:
        self.connection, theirs = multiprocessing.Pipe()
        self._popen = subprocess.Popen(
            [sys.executable, "-m", worker_process.__name__, str(theirs.fileno())],
            env={**os.environ, **_ONE_THREAD, "PYTHONPATH": os.pathsep.join(sys.path)},
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            # Ctrl-C is for the one who asks for evaluations: it ends its processes itself.
            start_new_session=True,
        )
        theirs.close()
        self.at = _STARTING

    def begin(self, at: int, candidate: NDArray[np.float64]) -> None:
        """Give it a candidate."""
        self.at = at
        self._send(pickle.dumps(candidate))

    def hear(self, pickled: bytes) -> Evaluation | Exception | None:
        """The evaluation that it is done with, or what was raised instead; None: neither.

        Args:
            pickled: The problem, for one that asks.

        Raises:
            OSError: It has died.
        """
        try:
            said = self.connection.recv()
        except EOFError as error:
            raise ConnectionResetError from error
        if said == worker_process.WHICH_PROBLEM:
            self._send(pickled)
            return None
        self.at = _FREE
        return None if said == worker_process.READY else said

    def end(self) -> str:
        """End it; how it ended, in words."""
        self._popen.kill()
        code = self._popen.wait()
        self.connection.close()
        return f"exit status {code}" if code >= 0 else signal.Signals(-code).name

    def _send(self, message: bytes) -> None:
        # Whether it has died shows when it is heard.
        with contextlib.suppress(ConnectionError):
            self.connection.send_bytes(message)
