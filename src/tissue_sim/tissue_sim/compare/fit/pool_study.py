"""What several processes gain, what an evaluation costs on them, and what many cores would give.

`python3 -m tissue_sim.compare.fit.pool_study --out docs/results/pool.json`; docs/scale.md shows the
figures.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tissue_sim.bench import machine
from tissue_sim.compare.fit.fit_trials import QUICK, Size, exact_problem
from tissue_sim.compare.fit.pool_cost import WAYS, overhead, predicted, seconds_of
from tissue_sim.compare.fit.problem import Problem
from tissue_sim.compare.fit.workers import Serial, Workers
from tissue_sim.elastic import registry
from tissue_sim.whole_files import write_json

POPULATIONS = (40, 1000)
"""Candidates of a generation for which many cores are thought of."""
GENERATIONS = 30
CORES = (1, 2, 8, 40, 1000)


@dataclass(frozen=True)
class PoolRow:
    """Evaluations in one way.

    Attributes:
        way: "pool" or "dask".
        workers: Number of processes.
        start_s: Time until the first evaluation was there, started processes included [s].
        generation_s: Time of a generation, median of the rounds [s].
        speed_up: Time in one process over it, of the same round, median.
        least, most: Least and most of the rounds.
        overhead_ms: Time that an evaluation costs besides its own [ms].
        same: Whether all evaluations are those of one process, bit for bit.
    """

    way: str
    workers: int
    start_s: float
    generation_s: float
    speed_up: float
    least: float
    most: float
    overhead_ms: float
    same: bool


def measured(problem: Problem, count: int, rounds: int) -> tuple[float, list[PoolRow]]:
    """Time of an evaluation in this process [s], and all ways beside it.

    The machine is shared: in each round this process and a way evaluate the same generation, now
    one first, now the other, and what counts is the ratio within the round.
    """
    candidates = np.random.default_rng(1).random((count, problem.space.size))
    cores = len(os.sched_getaffinity(0))
    here = Serial(problem)
    expected = here.evaluate(candidates)
    alone, rows = [], []
    for way, open_workers in WAYS.items():
        for number in sorted({1, min(2, cores), cores}):
            begun = time.perf_counter()
            with open_workers(problem, number) as workers:
                workers.evaluate(candidates[:1])
                start = time.perf_counter() - begun
                same = workers.evaluate(candidates) == expected
                pairs = [_pair(here, workers, candidates, turn) for turn in range(rounds)]
            alone += [ours for ours, _ in pairs]
            ratios = [ours / theirs for ours, theirs in pairs]
            rows.append(
                PoolRow(
                    way, number, start, statistics.median(theirs for _, theirs in pairs),
                    statistics.median(ratios), min(ratios), max(ratios),
                    1e3 * overhead(problem.space, way, number, count), same,
                )
            )  # fmt: skip
    return statistics.median(alone) / count, rows


def _pair(
    here: Workers, there: Workers, candidates: NDArray[np.float64], turn: int
) -> tuple[float, float]:
    """Time of a generation here and there [s]; who comes first alternates."""
    if turn % 2:
        theirs = seconds_of(there, candidates)
        return seconds_of(here, candidates), theirs
    return seconds_of(here, candidates), seconds_of(there, candidates)


def run(out: Path | None, size: Size, rounds: int) -> dict[str, Any]:
    """Measure, and say what many cores would give.

    Args:
        out: File to write; None writes nothing.
        size: The wall, and the candidates of a generation.
        rounds: Pairs of generations for each way.
    """
    registry.warm_up()
    problem, count = exact_problem(size), size.candidates[0]
    evaluation_s, rows = measured(problem, count, rounds)
    cost_s = 1e-3 * next(row.overhead_ms for row in reversed(rows) if row.way == "dask")
    result = {
        "machine": machine(),
        "nodes": problem.organ.mesh.node_rows,
        "frames": problem.cases[0].interaction.frames,
        "candidates": count,
        "rounds": rounds,
        "evaluation_s": evaluation_s,
        "rows": [asdict(row) for row in rows],
        "predicted": [
            {"population": population, "generations": GENERATIONS, "cores": cores,
             "seconds": predicted(population, cores, evaluation_s, cost_s, GENERATIONS)}
            for population in POPULATIONS for cores in CORES
        ],
    }  # fmt: skip
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_json(out, result)
    return result


def print_result(result: dict[str, Any], console: Console) -> None:
    """Print what was measured as tables of at most 80 columns."""
    console.print(
        f"{result['nodes']} nodes, {result['frames']} frames, {result['candidates']} candidates: "
        f"{1e3 * result['evaluation_s']:.0f} ms an evaluation in one process",
        highlight=False, soft_wrap=True,
    )  # fmt: skip
    table = _table(
        ("", 4), ("processes", 9), ("start [s]", 9), ("speed-up", 8), ("of rounds", 12),
        ("overhead [ms]", 13), ("same", 4),
    )  # fmt: skip
    for row in result["rows"]:
        table.add_row(
            row["way"], f"{row['workers']}", f"{row['start_s']:.1f}", f"{row['speed_up']:.2f}",
            f"{row['least']:.2f} to {row['most']:.2f}", f"{row['overhead_ms']:.2f}",
            "yes" if row["same"] else "no",
        )  # fmt: skip
    console.print(table)
    console.print(
        f"\n{GENERATIONS} generations, each waiting for the last one, would take:",
        highlight=False, soft_wrap=True,
    )  # fmt: skip
    table = _table(("candidates \\ cores", 18), *((f"{cores}", 9) for cores in CORES))
    for population in POPULATIONS:
        table.add_row(
            f"{population}",
            *(
                f"{e['seconds']:,.1f} s"
                for e in result["predicted"]
                if e["population"] == population
            ),
        )
    console.print(table)


def as_markdown(result: dict[str, Any]) -> str:
    """What was measured and what the formula makes of it, as two tables."""
    lines = [
        "| | processes | started after | speed-up | overhead an evaluation | as in one process |",
        "|---" * 6 + "|",
    ]
    lines += [
        f"| {row['way']} | {row['workers']} | {row['start_s']:.1f} s | {row['speed_up']:.2f} | "
        f"{row['overhead_ms']:.1f} ms | {'bit for bit' if row['same'] else 'no'} |"
        for row in result["rows"]
    ]
    cores = sorted({row["cores"] for row in result["predicted"]})
    seconds = {(row["population"], row["cores"]): row["seconds"] for row in result["predicted"]}
    lines += [
        "",
        "| candidates, 30 generations | " + " | ".join(f"{count} cores" for count in cores) + " |",
        "|---" * (len(cores) + 1) + "|",
    ]
    lines += [
        f"| {population} | "
        + " | ".join(f"{seconds[population, count]:.1f} s" for count in cores) + " |"
        for population in sorted({population for population, _ in seconds})
    ]  # fmt: skip
    return "\n".join(lines)


def _table(*headings: tuple[str, int]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    for heading, least in headings:
        table.add_column(escape(heading), justify="right", no_wrap=True, min_width=least)
    return table


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="what several processes gain")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="a small wall and few candidates")
    chosen = parser.parse_args()
    print_result(run(chosen.out, QUICK if chosen.quick else Size(), chosen.rounds), Console())


if __name__ == "__main__":
    main()
