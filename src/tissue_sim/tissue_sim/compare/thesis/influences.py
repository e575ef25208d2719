"""What each thing that the thesis' text leaves open does to its table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from tissue_sim.compare.thesis.conditions import Conditions
from tissue_sim.compare.thesis.experiment import Say, Search, measure, range_of
from tissue_sim.compare.thesis.rows import ROWS, Row

USUAL = Conditions(amplitudes=(0.008,), per_element=(1.0,))
"""What is varied: the three pulls at the middle amplitude, springs repeated for each element."""

INFLUENCES: Mapping[str, Conditions] = {
    "as it is": USUAL,
    "one spring for each edge": replace(USUAL, per_element=(0.0,)),
    "pull of 2 mm": replace(USUAL, amplitudes=(0.002,)),
    "pull of 16 mm": replace(USUAL, amplitudes=(0.016,)),
    "machine of half the speed": replace(USUAL, speed=0.5),
    "machine of twice the speed": replace(USUAL, speed=2.0),
    "machine of four times the speed": replace(USUAL, speed=4.0),
    "reference with nu = 0": replace(USUAL, poisson_ratio=0.0),
    "reference with nu = 0.3": replace(USUAL, poisson_ratio=0.3),
    "reference with nu = 0.3, corotated": replace(USUAL, poisson_ratio=0.3, corotated=1.0),
    "nu = 0.3 and four times the speed": replace(USUAL, poisson_ratio=0.3, speed=4.0),
    "middle of the free side held, 2 nodes": replace(USUAL, hold=0.0),
    "whole free side held, 30 nodes": replace(USUAL, hold=1.0),
    "trembling hand": replace(USUAL, tremor=1.0),
    "sweeps cut off at level 12": replace(USUAL, levels=12),
    "relaxation by the whole excess": replace(USUAL, full_excess=1.0),
}
"""By name: one thing is changed in each, or two."""

COLUMNS: Mapping[str, str] = {
    "quasi-static, tetrahedra": "quasi-static", "dynamic, tetrahedra": "dynamic",
    "relaxation only": "relaxation",
    "quasi-static + relaxation, up to 15 passes": "up to 15 passes",
    "quasi-static + relaxation, up to 3 passes": "up to 3 passes",
    "quasi-static at full equilibrium": "equilibrium",
}  # fmt: skip
"""Rows of the thesis' table that are looked at, and their short names."""


def rows_looked_at() -> tuple[Row, ...]:
    """The rows of `COLUMNS`."""
    return tuple(row for row in ROWS if row.name in COLUMNS)


def measure_influences(
    search: Search,
    processes: int | None = None,
    folder: Path | None = None,
    say: Say | None = None,
) -> dict[str, Any]:
    """Fit the rows of `COLUMNS` under each of `INFLUENCES`.

    Args:
        search: How long is searched.
        processes: Processes on this machine; None: one for each processor.
        folder: Folder of checkpoints, to go on from after an interruption.
        say: Told how far it is.

    Returns:
        Plain JSON values: "influences", one entry for each, with "ranges" by row.
    """
    entries, checkpoints = [], []
    for which, (name, conditions) in enumerate(INFLUENCES.items()):
        checkpoint = folder and folder / f"influence_{which}.json"
        checkpoints.append(checkpoint)
        outcomes = measure(
            conditions, search, rows_looked_at(), processes, checkpoint, say and _told(name, say)
        )
        ranges = {
            row: range_of([one["relative"] for one in outcomes if one["row"] == row])
            for row in COLUMNS
        }
        by_pull = {
            row: {one["pull"]: one["relative"] for one in outcomes if one["row"] == row}
            for row in COLUMNS
        }
        entries.append({
            "name": name, "conditions": conditions.to_json(), "ranges": ranges, "by_pull": by_pull,
        })  # fmt: skip
    for checkpoint in checkpoints:
        if checkpoint:
            checkpoint.unlink(missing_ok=True)
    return {"search": {"population": search.population, "generations": list(search.generations)},
            "influences": entries}  # fmt: skip


def _told(name: str, say: Say) -> Say:
    return lambda _what, done, total: say(name, done, total)


def as_markdown(result: dict[str, Any]) -> str:
    """The table for the page; in bold where the thesis' value lies inside the range."""
    theirs = {row.name: row.thesis for row in rows_looked_at()}
    lines = [
        "| changed | " + " | ".join(COLUMNS.values()) + " |",
        "|---" * (1 + len(COLUMNS)) + "|",
        "| the thesis | " + " | ".join(f"{theirs[row]:.3f}" for row in COLUMNS) + " |",
    ]
    for entry in result["influences"]:
        cells = [_cell(entry["ranges"][row], theirs[row]) for row in COLUMNS]
        lines.append(f"| {entry['name']} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(spread: list[float] | None, thesis: float | None) -> str:
    if spread is None:
        return "lost"
    text = f"{spread[0]:.3f} to {spread[1]:.3f}"
    inside = thesis is not None and spread[0] <= thesis <= spread[1]
    return f"**{text}**" if inside else text
