"""Workers give what one process gives, whatever happens to the processes."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from support.fit_problems import BAD, CLOUD, DiesOf, Watched, begun, block_problem, refuses
from support.simulation_process import eventually
from tissue_sim.compare.fit.process_pool import MOST_DEATHS, ProcessPool
from tissue_sim.compare.fit.workers import Serial, WorkersError, workers_of


@pytest.fixture(scope="module")
def pool() -> Iterator[ProcessPool]:
    with ProcessPool(block_problem(), 2) as running:
        yield running


@contextmanager
def watched(happens: Any, processes: int = 2) -> Iterator[ProcessPool]:
    with ProcessPool(Watched(happens), processes) as running:  # type: ignore[arg-type]
        yield running


def children() -> set[psutil.Process]:
    return set(psutil.Process().children(recursive=True))


def test_processes_give_bit_for_bit_what_one_process_gives(pool: ProcessPool) -> None:
    assert pool.evaluate(CLOUD) == Serial(block_problem()).evaluate(CLOUD)


def test_evaluations_come_in_the_order_of_the_candidates(pool: ProcessPool) -> None:
    for candidates in (CLOUD, CLOUD[::-1], CLOUD[:1], CLOUD[:0]):
        units = [evaluation.unit for evaluation in pool.evaluate(candidates)]
        assert units == [tuple(candidate) for candidate in candidates]


def test_a_candidate_whose_process_dies_is_evaluated_again(tmp_path: Path) -> None:
    with watched(DiesOf(BAD, 1, tmp_path)) as running:
        evaluations = running.evaluate(CLOUD)
    assert evaluations == Serial(block_problem()).evaluate(CLOUD)
    assert len(list(tmp_path.iterdir())) == 2


def test_a_candidate_that_ends_every_process_is_named(tmp_path: Path) -> None:
    candidates = np.array([[0.1, 0.2], [0.9, math.log(2.0, 20.0)]])
    before = children()
    with (
        watched(DiesOf(0.5, MOST_DEATHS, tmp_path), processes=1) as running,
        pytest.raises(
            WorkersError, match=r"candidate 2 of 2 \(step=1\.37, material.*=2000\).*SIGKILL"
        ),
    ):
        running.evaluate(candidates)
    assert children() == before


def test_processes_killed_between_generations_are_replaced(pool: ProcessPool) -> None:
    before = pool.evaluate(CLOUD)
    killed = children()
    for child in killed:
        child.kill()
    assert pool.evaluate(CLOUD) == before
    assert killed.isdisjoint(children())


def test_processes_that_cannot_begin_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", shutil.which("false"))
    with (
        ProcessPool(block_problem(), 1) as running,
        pytest.raises(WorkersError, match="ended before they were ready"),
    ):
        running.evaluate(CLOUD)


def test_what_an_evaluation_raises_is_raised_with_its_place() -> None:
    with watched(refuses, processes=1) as running, pytest.raises(ZeroDivisionError) as caught:
        running.evaluate(CLOUD)
    assert "in refuses" in caught.value.__notes__[0]


def test_a_process_uses_one_thread(pool: ProcessPool) -> None:
    pool.evaluate(CLOUD)
    for child in children():
        environment = child.environ()
        assert environment["NUMBA_NUM_THREADS"] == environment["OMP_NUM_THREADS"] == "1"


INTERRUPTED = """
import sys
from pathlib import Path
from support.fit_problems import CLOUD, Sleeps, Watched
from tissue_sim.compare.fit.process_pool import ProcessPool

# Not guarded by __name__: a person's script need not be.
with ProcessPool(Watched(Sleeps(60.0, Path(sys.argv[1]))), 2) as running:
    running.evaluate(CLOUD)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_no_process_outlives_the_one_that_started_it(
    tmp_path: Path, number: signal.Signals
) -> None:
    script = tmp_path / "fit.py"
    script.write_text(INTERRUPTED)
    folder = tmp_path / "begun"
    folder.mkdir()
    fit = subprocess.Popen(
        [sys.executable, str(script), str(folder)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stderr=subprocess.DEVNULL,
        # Tests that run in the background of a shell ignore it, and so would their children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    eventually(lambda: len(begun(folder)) == 2)
    evaluating = [psutil.Process(number) for number in begun(folder)]
    fit.send_signal(number)
    fit.wait(timeout=30.0)
    assert psutil.wait_procs(evaluating, timeout=30.0)[1] == []


def test_workers_that_a_person_asks_for() -> None:
    problem = block_problem()
    with workers_of(problem, processes=1) as one, workers_of(problem, processes=2) as two:
        assert isinstance(one, Serial)
        assert isinstance(two, ProcessPool)
        assert two.processes == 2
    with workers_of(problem) as all_of_them:
        assert isinstance(all_of_them, ProcessPool)
        assert all_of_them.processes == len(os.sched_getaffinity(0))
    with pytest.raises(ValueError, match="0 processes are not possible"):
        workers_of(problem, processes=0)
    with pytest.raises(ValueError, match="allowed: one of them"):
        workers_of(problem, processes=2, scheduler="tcp://127.0.0.1:1")
