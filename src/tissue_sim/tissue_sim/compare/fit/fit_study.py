"""What fits find on the thesis' wall, and how long they take; docs/fit.md shows the figures.

`python3 -m tissue_sim.compare.fit.fit_study --out docs/results/fit.json`
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console

from tissue_sim.bench import machine
from tissue_sim.compare.fit.checkpoint import Generation
from tissue_sim.compare.fit.fit_study_table import print_result
from tissue_sim.compare.fit.fit_trials import (
    QUICK,
    REFERENCE,
    SELF_FITS,
    THESIS,
    SelfFit,
    Size,
    exact_problem,
    self_problem,
)
from tissue_sim.compare.fit.problem import Problem
from tissue_sim.compare.fit.search import FitResult, search
from tissue_sim.compare.fit.workers import Serial, Workers, workers_of
from tissue_sim.elastic import registry
from tissue_sim.whole_files import write_json

WANTED = {"ea": 1e-3, "cma": 1e-6}
"""Error relative to the worst that a model fitted to itself shall reach, by strategy."""


@dataclass(frozen=True)
class SelfRow:
    """How close a model comes to itself.

    Attributes:
        name, strategy, seed: What was fitted, how.
        error: Of the best candidate, relative to the worst.
        wanted: What it shall be below.
        evaluations: Candidates that were evaluated.
        wanted_after: Those until the error was below `wanted`; None: it never was.
        values: The best values.
        truth: Those of the model itself.
        product: Product of those of which only that matters; None: there are none.
        true_product: The same of the model itself.
        seconds: Time that it took in one process [s].
    """

    name: str
    strategy: str
    seed: int
    error: float
    wanted: float
    evaluations: int
    wanted_after: int | None
    values: dict[str, float]
    truth: dict[str, float]
    product: float | None
    true_product: float | None
    seconds: float


def self_rows(size: Size) -> Iterator[SelfRow]:
    """Every model fitted to itself with both strategies."""
    for fit in SELF_FITS:
        problem = self_problem(fit, size)
        for strategy in WANTED:
            for seed in size.seeds if fit is THESIS else size.seeds[:1]:
                yield _self_row(fit, problem, strategy, seed, size)


def times(size: Size) -> dict[str, Any]:
    """The time of a fit to finite elements in one process and in several, and that both agree."""
    problem = exact_problem(size)
    alone, alone_s = _timed(problem, size, lambda: Serial(problem))
    several, several_s = _timed(problem, size, lambda: workers_of(problem, size.processes))
    count = len(alone.evaluations)
    return {
        "nodes": problem.organ.mesh.node_rows,
        "frames": problem.cases[0].interaction.frames,
        "candidates": size.candidates[0],
        "generations": size.generations[0],
        "evaluations": count,
        "error": alone.best.error,
        "values": alone.best.values,
        "serial_s": alone_s,
        "serial_ms_per_evaluation": 1e3 * alone_s / count,
        "processes": size.processes,
        "pool_s": several_s,
        "pool_ms_per_evaluation": 1e3 * several_s / count,
        "speed_up": alone_s / several_s,
        "same_seed_same_result": alone.evaluations == several.evaluations,
        "resumed_same_result": _resumed(problem, size).evaluations == alone.evaluations,
    }


def _resumed(problem: Problem, size: Size) -> FitResult:
    """The result of a fit that is interrupted after half of its generations and resumed."""
    half = size.generations[0] // 2

    def interrupt(generation: Generation) -> None:
        if generation.number == half:
            raise KeyboardInterrupt

    with TemporaryDirectory() as folder, workers_of(problem, size.processes) as workers:
        checkpoint = Path(folder) / "checkpoint.json"
        for on_generation in (interrupt, None):
            strategy, generations = size.strategy("ea", problem.space, size.seeds[0])
            try:
                return search(problem, strategy, workers, generations, checkpoint, on_generation)
            except KeyboardInterrupt:
                continue
    raise AssertionError("the resumed fit was interrupted too")


def _timed(
    problem: Problem, size: Size, workers_for: Callable[[], Workers]
) -> tuple[FitResult, float]:
    """A fit with the thesis' algorithm, and the time with all that is started for it [s]."""
    strategy, generations = size.strategy("ea", problem.space, size.seeds[0])
    begun = time.perf_counter()
    with workers_for() as workers:
        found = search(problem, strategy, workers, generations)
    return found, time.perf_counter() - begun


def _self_row(fit: SelfFit, problem: Problem, name: str, seed: int, size: Size) -> SelfRow:
    strategy, generations = size.strategy(name, problem.space, seed)
    begun = time.perf_counter()
    found = search(problem, strategy, Serial(problem), generations)
    seconds = time.perf_counter() - begun
    wanted = WANTED[name]
    errors = [evaluation.error for evaluation in found.evaluations]
    truth = {key: problem.subject.values[key] for key in problem.space.names}
    best = found.best.values
    return SelfRow(
        fit.name, name, seed, found.best.error, wanted, len(errors),
        next((at + 1 for at, error in enumerate(errors) if error < wanted), None), best, truth,
        _product(fit, best), _product(fit, truth), seconds,
    )  # fmt: skip


def _product(fit: SelfFit, values: dict[str, float]) -> float | None:
    return math.prod(values[name] for name in fit.product) if fit.product else None


def run(out: Path | None, size: Size, say: Callable[[str], None] = print) -> dict[str, Any]:
    """Fit everything.

    Args:
        out: File to write; None writes nothing.
        size: How much is computed.
        say: Called with a line as each figure is ready.
    """
    registry.warm_up()
    rows = []
    for row in self_rows(size):
        rows.append(row)
        say(f"{row.name}, {row.strategy}, seed {row.seed}: {row.error:.2g} of the worst")
    timed = times(size)
    say(f"{timed['evaluations']} evaluations: {timed['serial_s']:.1f} s, {timed['pool_s']:.1f} s")
    result = {
        "machine": machine(),
        "size": asdict(size),
        "reference": REFERENCE,
        "self": [asdict(row) for row in rows],
        "times": timed,
    }
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_json(out, result)
    return result


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="what fits find on the wall, and how fast")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--quick", action="store_true", help="a small wall and few candidates")
    chosen = parser.parse_args()
    result = run(chosen.out, QUICK if chosen.quick else Size())
    print_result(result, Console())


if __name__ == "__main__":
    main()
