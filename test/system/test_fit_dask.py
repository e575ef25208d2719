"""Evaluations on a Dask cluster of several processes, some of which are killed."""

from __future__ import annotations

import os
import re
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest

from support.fit_problems import BAD, CLOUD, DiesOf, Sleeps, Watched, begun, block_problem
from support.processes import Processes, processes
from support.simulation_process import eventually
from tissue_sim.compare.fit import dask_workers
from tissue_sim.compare.fit.dask_workers import DaskWorkers
from tissue_sim.compare.fit.problem import Evaluation
from tissue_sim.compare.fit.workers import Serial, WorkersError, workers_of

LOCAL = ("--host", "127.0.0.1", "--no-dashboard")


class Cluster:
    """A scheduler and its workers, as `dask scheduler` and `dask worker` start them."""

    def __init__(self, world: Processes, name: str) -> None:
        self._world, self._name, self._started = world, name, 0
        self._workers: list[str] = []
        world.start(name, "dask", "scheduler", *LOCAL, "--port", "0")
        self.address = self._logged(name, r"Scheduler at: +(\S+)\n")

    def with_workers(self, count: int) -> str:
        """The address, once so many workers are there."""
        self._workers = [name for name in self._workers if self._world.runs(name)]
        while len(self._workers) < count:
            self._started += 1
            self._workers.append(f"{self._name}_{self._started}")
            self._world.start(
                self._workers[-1], "dask", "worker", self.address, *LOCAL, "--nthreads", "1",
                "--no-nanny", "--death-timeout", "60", "--local-directory", str(self._world.folder),
            )  # fmt: skip
        for name in self._workers:
            self._logged(name, r"Registered to: +(\S+)\n")
        return self.address

    def _logged(self, name: str, pattern: str) -> str:
        """What a process says, once it does."""
        return eventually(lambda: re.findall(pattern, self._world.log(name)))[0]

    def end_scheduler(self) -> None:
        """Kill the scheduler."""
        self._world.end(self._name, signal.SIGKILL)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    with (
        pytest.MonkeyPatch.context() as patch,
        processes(tmp_path_factory.mktemp("cluster")) as made,
    ):
        patch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
        # A candidate may take one worker with it, so that it takes no more to find one that does.
        patch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "1")
        # No candidate waits on a worker beside another one, which would be suspected with it.
        patch.setenv("DASK_DISTRIBUTED__SCHEDULER__WORKER_SATURATION", "1.0")
        yield made


@pytest.fixture(scope="module")
def cluster(world: Processes) -> Cluster:
    return Cluster(world, "scheduler")


@pytest.fixture(scope="module")
def expected() -> list[Evaluation]:
    return Serial(block_problem()).evaluate(CLOUD)


def while_evaluating(address: str, folder: Path, act: Callable[[], None]) -> list[Evaluation]:
    """What is found when something happens in the middle of a generation."""
    problem = Watched(Sleeps(0.1, folder))
    with (
        DaskWorkers(problem, address) as workers,  # type: ignore[arg-type]
        ThreadPoolExecutor(1) as beside,
    ):
        evaluations = beside.submit(workers.evaluate, CLOUD)
        eventually(lambda: len(begun(folder)) > 5)
        assert not evaluations.done()
        act()
        return evaluations.result()


def kill(numbers: list[int]) -> None:
    """Kill processes, and wait until they are gone."""
    killed = [psutil.Process(number) for number in set(numbers)]
    for process in killed:
        process.kill()
    assert psutil.wait_procs(killed, timeout=30.0)[1] == []


def test_scheduler_without_workers_is_refused(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_workers, "PATIENCE", 1.0)
    with pytest.raises(WorkersError, match=f"`dask worker {cluster.address}`"):
        # A scheduler of its own would take longer: this test is the first one.
        DaskWorkers(block_problem(), cluster.address)


def test_cluster_gives_bit_for_bit_what_one_process_gives(
    cluster: Cluster, expected: list[Evaluation]
) -> None:
    with workers_of(block_problem(), scheduler=cluster.with_workers(2)) as workers:
        assert workers.evaluate(CLOUD) == expected
        # Now it is known that they take no time, and they come several at once.
        assert workers.evaluate(CLOUD) == expected
        assert workers.evaluate(CLOUD[:0]) == []


def test_worker_killed_in_the_middle_loses_nothing(
    cluster: Cluster, expected: list[Evaluation], tmp_path: Path
) -> None:
    address = cluster.with_workers(2)
    assert while_evaluating(address, tmp_path, lambda: kill(begun(tmp_path)[:1])) == expected


def test_workers_that_come_later_are_told_the_problem(
    cluster: Cluster, expected: list[Evaluation], tmp_path: Path
) -> None:
    """All workers that knew it are killed."""

    def replace_all() -> None:
        kill(begun(tmp_path))
        cluster.with_workers(1)

    assert while_evaluating(cluster.with_workers(2), tmp_path, replace_all) == expected


def test_candidate_that_ends_every_worker_is_named(cluster: Cluster, tmp_path: Path) -> None:
    problem = Watched(DiesOf(BAD, 10, tmp_path))
    with (
        DaskWorkers(problem, cluster.with_workers(2)) as workers,  # type: ignore[arg-type]
        pytest.raises(WorkersError, match=r"candidate \(step=1.*\) was on each of 2 workers"),
    ):
        workers.evaluate(CLOUD)


def test_other_sources_or_packages_are_refused(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_workers, "version", lambda name: f"no {name}")
    dask_workers.environment.cache_clear()
    with pytest.raises(WorkersError, match=r"worker tcp:.* runs numpy .*, here no numpy; scipy"):
        DaskWorkers(block_problem(), cluster.with_workers(1))
    dask_workers.environment.cache_clear()


def test_lost_scheduler_is_told(world: Processes, tmp_path: Path) -> None:
    lonely = Cluster(world, "lonely")
    with pytest.raises(WorkersError, match=f"the Dask scheduler at {lonely.address} is lost"):
        while_evaluating(lonely.with_workers(1), tmp_path, lonely.end_scheduler)


def test_address_where_nobody_answers_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_workers, "PATIENCE", 0.5)
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        unused = f"tcp://127.0.0.1:{closed.getsockname()[1]}"
    for address in (unused, "nonsense", "http://127.0.0.1:1"):
        with pytest.raises(WorkersError, match=f"{address}.*`dask scheduler` runs"):
            workers_of(block_problem(), scheduler=address)
