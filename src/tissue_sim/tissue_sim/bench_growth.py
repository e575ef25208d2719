"""How the time of a step grows with the organ, from a thousand nodes to 360,000."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tissue_sim.bench import (
    ALL_NODES,
    Case,
    Limits,
    machine,
    measure,
    measure_operations,
    measure_roots,
    measure_triad,
)
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry import scene_geometry

SIDES = (10, 16, 25, 40, 71)
"""Nodes along each side of the blocks."""

CASES_OF_GROWTH = tuple(
    Case(model, model, "block", parameters, disturbed=True)
    for model, parameters in (
        ("quasi_static", ALL_NODES),
        ("relaxation", ()),
        ("lr", (("linear_factor", 0.00035),)),
        ("spring_mass", ()),
        ("finite_element", ()),
        ("vertex_block_descent", ALL_NODES),
    )
)


def run_growth(out: Path, seconds: float = 1.0) -> dict[str, Any]:
    """Measure a step of every model, every node active, on blocks of growing size.

    Args:
        out: File to write.
        seconds: Time for each measurement [s].

    Returns:
        Machine, rows (model, nodes, ms_per_step) and the log-log slope of every model.
    """
    registry.warm_up()
    limits = Limits(measure_triad(), 1.0 / measure_roots(), measure_operations())
    rows: list[dict[str, Any]] = []
    for side in SIDES:
        shape = {f"nodes_{axis}": side for axis in "xyz"}
        springs = SpringNetwork(scene_geometry.load("block", parameters=shape).mesh, Material())
        for case in CASES_OF_GROWTH:
            row = measure(case, springs, seconds, limits)
            rows.append({key: row[key] for key in ("model", "nodes", "ms_per_step")})
    result = {"machine": machine(), "rows": rows, "slopes": slopes(rows)}
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(result, indent=2) + "\n")
    return result


def slopes(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Slope of log time over log nodes, fitted through all sizes, by model."""
    found = {}
    for label in (case.label for case in CASES_OF_GROWTH):
        of_model = [row for row in rows if row["model"] == label]
        nodes, times = ([row[key] for row in of_model] for key in ("nodes", "ms_per_step"))
        found[label] = float(np.polyfit(np.log(nodes), np.log(times), 1)[0])
    return found


def _lines(result: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of the table: milliseconds a step by model and size."""
    sizes = sorted({row["nodes"] for row in result["rows"]})
    times = {(row["model"], row["nodes"]): row["ms_per_step"] for row in result["rows"]}
    rows = [
        [label, *(f"{times[label, nodes]:.3f}" for nodes in sizes), f"{slope:.2f}"]
        for label, slope in result["slopes"].items()
    ]
    return ["model", *(f"{nodes:,}" for nodes in sizes), "slope"], rows


def as_markdown(result: dict[str, Any]) -> str:
    """A result as a table for a page."""
    headings, rows = _lines(result)
    marks = ["|---" * len(headings) + "|"]
    return "\n".join([*(f"| {' | '.join(line)} |" for line in [headings]), *marks,
                      *(f"| {' | '.join(line)} |" for line in rows)])  # fmt: skip


def print_growth(result: dict[str, Any], console: Console | None = None) -> None:
    """Print milliseconds a step by model and size."""
    headings, rows = _lines(result)
    table = Table(title="milliseconds a step on blocks of so many nodes")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "model" else "right")
    for row in rows:
        table.add_row(*row)
    (console or Console()).print(table)
