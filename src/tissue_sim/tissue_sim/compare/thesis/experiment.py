"""The experiment: every row of the thesis' table, fitted to every pull of the wall."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissue_sim.compare.difference import mean_distance
from tissue_sim.compare.fit.problem import Case, Evaluation, Problem
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.thesis.conditions import Conditions
from tissue_sim.compare.thesis.rows import ROWS, Row
from tissue_sim.compare.thesis.side_by_side import fit_all
from tissue_sim.compare.thesis.wall import Walls
from tissue_sim.compare.trajectory import simulate

SEED = 1

Say = Callable[[str, int, int], None]
"""Told what is done, how much of it, and of how much."""


@dataclass(frozen=True)
class Search:
    """How long is searched.

    Attributes:
        population: Individuals; 20 to 45 in the thesis.
        generations: Generations of fits of one, two and three values.
    """

    population: int
    generations: tuple[int, int, int]


FULL = Search(20, (8, 12, 15))
SHORT = Search(12, (4, 6, 8))
QUICK = Search(6, (2, 2, 2))


@dataclass(frozen=True)
class Trial:
    """A row under a pull.

    Attributes:
        row: The row.
        pull: Direction of the pull.
        amplitude: How far it goes [m].
        organ: Which of the walls.
        case: The pull and what the reference does.
        subject: The model before it is fitted.
    """

    row: Row
    pull: str
    amplitude: float
    organ: Organ
    case: Case
    subject: Subject

    @property
    def problem(self) -> Problem | None:
        """What is fitted; None: nothing."""
        space = self.row.space
        return None if space is None else Problem(self.organ, self.subject, space, (self.case,))

    def relative(self, values: dict[str, float]) -> tuple[float | None, float, float]:
        """Difference over the worst (None: the model was lost), steps made, and their time [s]."""
        moved = simulate(self.subject.with_values(values), self.organ, self.case.interaction)
        apart = mean_distance(moved, self.case.reference) / self.case.worst
        return (
            apart if moved.is_stable else None, float(moved.steps.sum()),
            float(moved.seconds.sum()),
        )  # fmt: skip


def trials_of(conditions: Conditions, rows: Sequence[Row] = ROWS) -> list[Trial]:
    """All trials of some rows, row by row."""
    walls = Walls.build(conditions)
    cases = {
        (pull, amplitude): walls.case(pull, amplitude, conditions)
        for pull in conditions.pulls
        for amplitude in conditions.amplitudes
    }
    carried = (
        {key: walls.carried(case) for key, case in cases.items()}
        if any(row.connected for row in rows)
        else {}
    )
    trials = []
    for row in rows:
        if not row.model:
            continue
        organ, own = (walls.connected, carried) if row.connected else (walls.tetrahedra, cases)
        subject = row.subject(conditions.speed).with_values(conditions.values(row.model))
        for per_element in conditions.per_element if row.repeats else (None,):
            repeated = {} if per_element is None else {"springs.per_element": per_element}
            for (pull, amplitude), case in own.items():
                trials.append(
                    Trial(row, pull, amplitude, organ, case, subject.with_values(repeated))
                )
    return trials


def measure(
    conditions: Conditions,
    search: Search,
    rows: Sequence[Row] = ROWS,
    processes: int | None = None,
    checkpoint: Path | None = None,
    say: Say | None = None,
) -> list[dict[str, Any]]:
    """Fit and play all trials of some rows.

    Args:
        conditions: What the text leaves open.
        search: How long is searched.
        rows: Rows of the table.
        processes: Processes on this machine; None: one for each processor.
        checkpoint: File to go on from after an interruption.
        say: Told how far it is.

    Returns:
        The outcome of each trial as plain JSON values: "row", "pull", "amplitude_mm",
        "per_element", "relative" (None: no stable values were found), "values",
        "relative_with_thesis_values" (None: lost), "steps_per_second".
    """
    if say:
        say("reference", 0, 1)
    trials = trials_of(conditions, rows)
    problems = {which: trial.problem for which, trial in enumerate(trials)}
    fitted = {which: problem for which, problem in problems.items() if problem}
    best = fit_all(
        list(fitted.values()),
        [search.generations[problem.space.size - 1] for problem in fitted.values()],
        SEED, search.population, processes, checkpoint,
        (lambda done, total: say("fits", done, total)) if say else None,
    )  # fmt: skip
    found: dict[int, Evaluation] = dict(zip(fitted, best, strict=True))
    outcomes = []
    for which, trial in enumerate(trials):
        outcomes.append(_outcome(trial, found.get(which)))
        if say:
            say("with the values found", which + 1, len(trials))
    return outcomes


def _outcome(trial: Trial, found: Evaluation | None) -> dict[str, Any]:
    values = dict(found.values) if found else {}
    relative, steps, seconds = trial.relative(values)
    theirs = trial.relative(dict(trial.row.found))[0] if trial.row.found else None
    return {
        "row": trial.row.name,
        "pull": trial.pull,
        "amplitude_mm": round(1e3 * trial.amplitude, 6),
        "per_element": trial.subject.values.get("springs.per_element"),
        "relative": relative,
        "values": values,
        "relative_with_thesis_values": theirs,
        "steps_per_second": steps / seconds,
        "frames_per_second": trial.case.interaction.frames / seconds,
    }


def range_of(values: Sequence[float | None]) -> list[float] | None:
    """Least and largest of those that are there; None: none is."""
    there = [value for value in values if value is not None]
    return [min(there), max(there)] if there else None


def rows_of(outcomes: Sequence[dict[str, Any]], rows: Sequence[Row] = ROWS) -> list[dict[str, Any]]:
    """The table: one entry for each row, as DESIGN.md, section 7, has them, and more."""
    return [_row(row, [one for one in outcomes if one["row"] == row.name]) for row in rows]


def _row(row: Row, outcomes: Sequence[dict[str, Any]]) -> dict[str, Any]:
    if not row.model:
        relative: list[float | None] = [1.0]
    else:
        relative = [one["relative"] for one in outcomes]
    there = [value for value in relative if value is not None]
    spread = range_of(relative)
    agrees = (
        None if row.thesis is None or spread is None
        else bool(spread[0] <= row.thesis <= spread[1])
    )  # fmt: skip
    speeds = [one["steps_per_second" if row.rate else "frames_per_second"] for one in outcomes]
    return {
        "row": row.name,
        "relative_to_worst": float(np.median(there)) if there else None,
        "relative_range": spread,
        "thesis_relative_to_worst": row.thesis,
        "agrees": agrees,
        "parameters": _parameters(row, outcomes),
        "steps_per_frame": row.steps(),
        "frames_per_second": float(np.median(speeds)) if speeds else None,
        "thesis_frames_per_second": row.thesis_fps,
        "with_thesis_values": _with_thesis_values(row, outcomes),
        "note": _note(row, spread, agrees),
    }


def _note(row: Row, spread: list[float] | None, agrees: bool | None) -> str:
    if agrees is not False or row.thesis is None or spread is None:
        return row.note
    side = "below" if row.thesis < spread[0] else "above"
    apart = f"the thesis' figure lies {side} our range: docs/thesis.md says why"
    return "; ".join(part for part in (row.note, apart) if part)


def _parameters(row: Row, outcomes: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Of each fitted value: least, median and largest found, and the thesis' own."""
    space = row.space
    table = {}
    for name in space.names if space else ():
        found = [one["values"][name] for one in outcomes if one["relative"] is not None]
        if found:
            table[name] = {
                "low": min(found), "median": float(np.median(found)), "high": max(found),
                "thesis": row.found[name],
            }  # fmt: skip
    return table


def _with_thesis_values(row: Row, outcomes: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """What the thesis' own values give here, for springs once for each edge and repeated."""
    if not row.found:
        return []
    entries = []
    for variant in dict.fromkeys(one["per_element"] for one in outcomes):
        own = [
            one["relative_with_thesis_values"] for one in outcomes if one["per_element"] == variant
        ]
        entries.append({
            "per_element": variant, "trials": len(own), "lost": sum(one is None for one in own),
            "relative_range": range_of(own),
        })  # fmt: skip
    return entries
