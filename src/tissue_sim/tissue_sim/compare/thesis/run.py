"""The experiment as one command: progress, files, table."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from tissue_sim.bench import machine
from tissue_sim.compare.thesis.conditions import Conditions
from tissue_sim.compare.thesis.experiment import (
    FULL,
    QUICK,
    SEED,
    SHORT,
    Say,
    Search,
    measure,
    rows_of,
)
from tissue_sim.compare.thesis.influences import as_markdown, measure_influences
from tissue_sim.compare.thesis.table import print_table
from tissue_sim.whole_files import write_json

QUICK_CONDITIONS = Conditions(amplitudes=(0.008,))


def experiment(out: Path, quick: bool = False, processes: int | None = None) -> dict[str, Any]:
    """Run the experiment, print its table and write its result.

    Args:
        out: File to write; checkpoints lie in a folder beside it, without its suffix.
        quick: One amplitude and a short search.
        processes: Processes on this machine; None: one for each processor.
    """
    conditions, search = (QUICK_CONDITIONS, QUICK) if quick else (Conditions(), FULL)
    checkpoint = out.with_suffix("") / ("quick.json" if quick else "fits.json")
    begun = time.perf_counter()
    with _progress() as say:
        outcomes = measure(conditions, search, processes=processes, checkpoint=checkpoint, say=say)
    result = {
        "rows": rows_of(outcomes),
        "conditions": conditions.to_json(),
        "search": _told(search),
        "machine": machine(),
        "seconds": round(time.perf_counter() - begun, 1),
        "trials": outcomes,
    }
    _write(out, result)
    checkpoint.unlink(missing_ok=True)
    print_table(result)
    return result


def influences(out: Path, quick: bool = False, processes: int | None = None) -> dict[str, Any]:
    """Run the table of influences; see `experiment`."""
    begun = time.perf_counter()
    with _progress() as say:
        result = measure_influences(QUICK if quick else SHORT, processes, out.with_suffix(""), say)
    result |= {"seed": SEED, "machine": machine(), "seconds": round(time.perf_counter() - begun, 1)}
    _write(out, result)
    Console().print(as_markdown(result), markup=False, highlight=False, soft_wrap=True)
    return result


def _told(search: Search) -> dict[str, Any]:
    return {
        "algorithm": "evolutionary", "seed": SEED, "population": search.population,
        "generations": list(search.generations),
    }  # fmt: skip


def _write(out: Path, result: dict[str, Any]) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    write_json(out, result)


@contextmanager
def _progress() -> Iterator[Say]:
    """A bar on standard error with what is done now."""
    columns = (
        TextColumn("{task.description}"), BarColumn(bar_width=24), MofNCompleteColumn(),
        TimeElapsedColumn(),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True)) as bars:
        task = bars.add_task("", total=None)

        def say(what: str, done: int, total: int) -> None:
            bars.update(task, description=what, completed=done, total=total)

        yield say
