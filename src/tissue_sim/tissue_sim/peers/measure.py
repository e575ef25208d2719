"""Time from a pull until the tissue is where it belongs, with the best of some settings."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tissue_sim.peers.task import Simulator, Task

TARGET = 0.05
"""Error that counts as arrived."""

LOST = 1e3
"""Error at which a run is given up."""

AT_REST = 1e-9
"""Tissue that moved by less than this in 500 steps [m] is at rest."""

REPEATS = 5
FINALISTS = 3
"""Most settings that are run more than once."""

CLOSE, SOON = 1.5, 1000.0
"""Finalists are within this factor of the best, where the best arrives within so many ms."""

PATIENCE = 3.0
"""A setting is given up after this many times the time of the best before it."""


@dataclass(frozen=True)
class Entry:
    """A simulator and the settings to try.

    Attributes:
        label: Name of the row.
        settings: Settings to try.
        build: Makes it from a task and settings.
        package: Its package, imported under the same name; "" for this library's own models.
        licence: Licence of the package.
    """

    label: str
    settings: tuple[dict[str, Any], ...]
    build: Callable[[Task, dict[str, Any]], Simulator]
    package: str = ""
    licence: str = ""


@dataclass(frozen=True)
class Run:
    """One pull.

    Attributes:
        settings: Of the simulator.
        arrived_ms: Processor time until the error stayed below the target [ms]; None: never.
        wall_ms: Time on the clock until then, or of all steps [ms].
        steps: Steps until then, or all.
        step_ms: Processor time of one of these [ms].
        end: Why the run ended: "arrived", "at rest", "time" or "lost".
        error: Error at the end; lost: the largest known.
        largest: Largest distance of a free node at the end over the pull.
    """

    settings: dict[str, Any]
    arrived_ms: float | None
    wall_ms: float
    steps: int
    step_ms: float
    end: str
    error: float
    largest: float

    @property
    def rank(self) -> tuple[float, float]:
        """Orders runs: what arrives sooner, then what ends nearer."""
        arrived = np.inf if self.arrived_ms is None else self.arrived_ms
        return (arrived, self.error)


def measure(entry: Entry, task: Task, seconds: float) -> dict[str, Any]:
    """Try all settings once, then the best of them a few times; the best median counts.

    Args:
        entry: Simulator.
        task: What to pull.
        seconds: Most time of a run [s].

    Returns:
        A row of the table; the medians of the repeated runs.
    """
    # Kernels are compiled and caches filled before anything is timed.
    pulled(entry, task, entry.settings[0], 0.1)
    tried: list[Run] = []
    for settings in entry.settings:
        best = min((run.arrived_ms for run in tried if run.arrived_ms is not None), default=np.inf)
        tried.append(pulled(entry, task, settings, min(seconds, 1e-3 * PATIENCE * best)))
    ranked = sorted(tried, key=lambda run: run.rank)
    runs = min(
        (_repeated(entry, task, run, seconds) for run in _finalists(ranked)),
        key=lambda runs: runs[len(runs) // 2].rank,
    )
    return {
        "geometry": task.geometry,
        "simulator": entry.label,
        "peer": bool(entry.package),
        **asdict(runs[len(runs) // 2]),
        "step_ms": statistics.median(run.step_ms for run in runs),
        "arrived_ms_of_runs": [run.arrived_ms for run in runs],
        "tried": [asdict(run) for run in tried],
    }


def _finalists(ranked: list[Run]) -> list[Run]:
    best = ranked[0].arrived_ms
    if best is None or best > SOON:
        return ranked[:1]
    near = [run for run in ranked if run.arrived_ms is not None and run.arrived_ms < CLOSE * best]
    return near[:FINALISTS]


def _repeated(entry: Entry, task: Task, run: Run, seconds: float) -> list[Run]:
    """Runs with the same settings in their order; what does not arrive is not repeated."""
    if run.arrived_ms is None:
        return [run]
    again = (pulled(entry, task, run.settings, seconds) for _ in range(REPEATS))
    return sorted(again, key=lambda run: run.rank)


def pulled(entry: Entry, task: Task, settings: dict[str, Any], seconds: float) -> Run:
    """Pull once, from rest.

    Processor time of all threads counts, which others on the machine do not lengthen, and that of
    steps only. The run ends when it has been within the target for as long again as it took to
    arrive and for 20 steps, when nothing moves any more, when it is lost, or when the time is over.
    """
    simulator = entry.build(task, settings)
    simulator.step()
    simulator.pull()
    elapsed, wall, steps, arrived, end, error = 0.0, 0.0, 0, None, "", 1.0
    last = simulator.displacement().copy()
    while not end:
        at, begin = time.perf_counter(), time.process_time()
        simulator.step()
        elapsed += time.process_time() - begin
        wall += time.perf_counter() - at
        steps += 1
        now = task.error(simulator.displacement())
        error = now if now < LOST else LOST
        if error > TARGET:
            arrived = None
        elif arrived is None:
            arrived = (elapsed, wall, steps)
        if error == LOST:
            end = "lost"
        elif arrived and elapsed >= 2 * arrived[0] and steps >= arrived[2] + 20:
            end = "arrived"
        elif elapsed >= seconds and not arrived:
            end = "time"
        elif steps % 500 == 0:
            if np.abs(simulator.displacement() - last).max() < AT_REST:
                end = "arrived" if arrived else "at rest"
            last = simulator.displacement().copy()
    largest = min(task.largest_error(simulator.displacement()), LOST) if end != "lost" else LOST
    close = getattr(simulator, "close", None)
    if close is not None:
        close()
    until, wall, count = arrived or (elapsed, wall, steps)
    return Run(
        settings, 1e3 * until if arrived else None, 1e3 * wall, count, 1e3 * until / count, end,
        error, largest,
    )  # fmt: skip
