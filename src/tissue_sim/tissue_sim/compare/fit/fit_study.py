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
from rich.table import Table

from tissue_sim.bench import machine
from tissue_sim.compare.fit.checkpoint import Generation
from tissue_sim.compare.fit.cma_es import CmaEs
from tissue_sim.compare.fit.evolutionary import Evolutionary
from tissue_sim.compare.fit.problem import Problem, case_of
from tissue_sim.compare.fit.search import FitResult, search
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.fit.strategy import Strategy
from tissue_sim.compare.fit.workers import Serial, Workers, workers_of
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.sources.motions import motion
from tissue_sim.compare.subject import parse_subject
from tissue_sim.compare.trajectory import simulate
from tissue_sim.elastic import registry
from tissue_sim.whole_files import write_json

WANTED = {"ea": 1e-3, "cma": 1e-6}
"""Error relative to the worst that a model fitted to itself shall reach, by strategy."""

REFERENCE = "finite_element@rest"


@dataclass(frozen=True)
class SelfFit:
    """A model that is fitted to itself.

    Attributes:
        name: Name for people.
        subject: The model with the values that are to be found again.
        ranges: Where they are looked for.
        product: Values of which only the product matters.
    """

    name: str
    subject: str
    ranges: tuple[str, ...]
    product: tuple[str, ...] = ()


THESIS = SelfFit(
    "quasi-static, as in the thesis",
    "quasi_static:levels=10000,keep_until_rest=0,force_step=0.2,springs.stiffness=0.2@1.9",
    ("force_step=0.01..1", "springs.stiffness=0.01..1"),
    ("force_step", "springs.stiffness"),
)
"""The thesis' check: fitted to itself at (0.2, 0.2) (THESIS.md, section 7)."""

SELF_FITS = (
    THESIS,
    SelfFit("lr", "lr:step=1.2,linear_factor=0.05@2", ("step=0.1..1.99", "linear_factor=0..0.3")),
    SelfFit(
        "spring-mass",
        "spring_mass:mass_scaling=2,time_step=0.002,damping=0.067,springs.stiffness=0.5@2.9",
        ("damping=0..0.5", "springs.stiffness=0.05..20:log"),
    ),
)


@dataclass(frozen=True)
class Size:
    """How much is computed.

    Attributes:
        nodes: Nodes of the wall along its sides.
        seconds: Pull and time without motion after it [s].
        seeds: Seeds of the thesis' check; the other models take the first one.
        candidates, generations: Of each strategy.
        processes: Processes that a fit is timed with, beside none.
    """

    nodes: tuple[int, int, int] = (17, 26, 2)
    seconds: tuple[float, float] = (1.5, 3.0)
    seeds: tuple[int, ...] = (1, 2, 3, 4, 5)
    candidates: tuple[int, int] = (40, 12)
    generations: tuple[int, int] = (30, 60)
    processes: int = 2

    def strategy(self, name: str, space: Space, seed: int) -> tuple[Strategy, int]:
        """A strategy by name, and its generations."""
        if name == "ea":
            return Evolutionary(space.size, seed, self.candidates[0]), self.generations[0]
        return CmaEs(space.size, seed, self.candidates[1]), self.generations[1]


QUICK = Size((5, 6, 2), (0.3, 0.2), (1,), (8, 6), (4, 6))


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


def self_problem(fit: SelfFit, size: Size) -> Problem:
    """A model to be fitted to itself under an oblique pull of the wall."""
    subject = parse_subject(fit.subject)
    organ, pull = _pulled_wall(size)
    case = case_of(organ, pull, simulate(subject, organ, pull))
    return Problem(organ, subject, Space.parse(*fit.ranges), (case,))


def exact_problem(size: Size) -> Problem:
    """The thesis' quasi-static model, to be fitted to finite elements at equilibrium."""
    organ, pull = _pulled_wall(size)
    case = case_of(organ, pull, simulate(parse_subject(REFERENCE), organ, pull))
    return Problem(organ, parse_subject(THESIS.subject), Space.parse(*THESIS.ranges), (case,))


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


def _pulled_wall(size: Size) -> tuple[Organ, Interaction]:
    columns, rows, layers = size.nodes
    organ = load_organ("wall", parameters={"columns": columns, "rows": rows, "layers": layers})
    pull, hold = size.seconds
    return organ, motion("oblique", organ, pull_seconds=pull, hold_seconds=hold)


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
        "self": [asdict(row) for row in rows],
        "times": timed,
    }
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_json(out, result)
    return result


def print_result(result: dict[str, Any], console: Console) -> None:
    """Print what was found as tables of at most 80 columns."""
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column("fitted to itself", min_width=20, overflow="fold")
    for heading, least in (
        ("by", 3), ("seed", 4), ("of the worst", 12), ("reached after", 13), ("product", 8),
    ):  # fmt: skip
        table.add_column(heading, justify="right", no_wrap=True, min_width=least)
    for row in result["self"]:
        after = row["wanted_after"]
        product = row["product"]
        table.add_row(
            row["name"], row["strategy"], f"{row['seed']}",
            f"{row['error']:.1e}", "not" if after is None else f"{after} of {row['evaluations']}",
            "" if product is None else f"{product:.6f}",
        )  # fmt: skip
    console.print(table)
    timed = result["times"]
    for line in (
        f"reached: {WANTED['ea']:g} of the worst with ea, {WANTED['cma']:g} with cma",
        f"{timed['candidates']} candidates x {timed['generations']} generations to {REFERENCE}: "
        f"{timed['serial_s']:.1f} s in one process, {timed['pool_s']:.1f} s in "
        f"{timed['processes']}",
        f"the same seed gives the same result: {_yes(timed['same_seed_same_result'])}",
        f"interrupted and resumed gives the same: {_yes(timed['resumed_same_result'])}",
    ):
        console.print(line, highlight=False, soft_wrap=True)


def _yes(true: bool) -> str:
    return "yes" if true else "no"


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
