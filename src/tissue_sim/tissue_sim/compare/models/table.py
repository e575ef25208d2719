"""Tables that order models by their error at equal cost per frame."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from tissue_sim.compare.models.trial import Error, Row

FIRST, SECOND = "linear", "corotated"
"""The reference that orders the models, and the one beside it."""

BEGIN, END = "<!-- results: docs/results/model_errors.json -->", "<!-- end of results -->"
"""Marks on the page between which the tables are."""


@dataclass(frozen=True)
class Standing:
    """A model on an organ with a budget, over all interactions.

    Attributes:
        rows: One row for each interaction.
    """

    rows: tuple[Row, ...]

    @property
    def label(self) -> str:
        """Name of the model and its variant."""
        return self.rows[0].label

    def relative(self, reference: str = FIRST) -> float:
        """Mean over the interactions of the error relative to the worst."""
        return statistics.mean(row.errors[reference].relative for row in self.rows)

    def errors(self, reference: str = FIRST) -> list[Error]:
        """The errors under each interaction."""
        return [row.errors[reference] for row in self.rows]

    @property
    def steps(self) -> float:
        """Steps a frame; sweeps of a step count."""
        row = self.rows[0]
        return row.steps * row.values.get("iterations", 1.0)

    @property
    def ms(self) -> float:
        """Time that the steps of a frame took, mean over frames and interactions [ms]."""
        return statistics.mean(row.ms for row in self.rows)

    @property
    def lost(self) -> int:
        """Frames after the model was lost."""
        return sum(row.lost for row in self.rows)


def standings(
    rows: Iterable[Row], organ: str, budget_ms: float, reference: str = FIRST
) -> list[Standing]:
    """Models on an organ with a budget, those with the smallest error first."""
    by_label: dict[str, list[Row]] = {}
    for row in rows:
        if (row.organ, row.budget_ms) == (organ, budget_ms):
            by_label.setdefault(row.label, []).append(row)
    found = [Standing(tuple(each)) for each in by_label.values()]
    return sorted(found, key=lambda standing: standing.relative(reference))


def as_markdown(result: dict[str, Any]) -> str:
    """All tables of a result, one for each organ and budget."""
    rows = [Row.of(values) for values in result["rows"]]
    parts = []
    for organ, about in result["organs"].items():
        parts.append(f"### {organ.capitalize()}, {about['nodes']:,} nodes")
        for budget in sorted({row.budget_ms for row in rows if row.organ == organ}):
            costs = {
                each["label"]: each["cost"]["ms"]
                for each in about["costs"]
                if each["budget_ms"] == budget
            }
            parts += [f"**{budget:g} ms a frame**", _table(rows, organ, budget, costs)]
    return "\n\n".join(parts)


def into_page(page: str, tables: str, begin: str = BEGIN) -> str:
    """A page with the tables between two marks, in place of what was there.

    Args:
        page: The page.
        tables: What shall stand there.
        begin: Mark before them; `END` is the one after.

    Raises:
        ValueError: The page has no such marks.
    """
    before, found, rest = page.partition(begin)
    _, end, after = rest.partition(END)
    if not found or not end:
        raise ValueError(f"the page has no place for tables; it needs {begin} and {END}")
    return f"{before}{begin}\n{tables}\n{END}{after}"


def _table(rows: Sequence[Row], organ: str, budget_ms: float, costs: dict[str, float]) -> str:
    lines = [
        "| | model | relative | from .. to | mean | 95 % | largest [mm] | volume "
        "| corotated | ms a step | steps | ms a frame |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    second = [each.label for each in standings(rows, organ, budget_ms, SECOND)]
    for place, standing in enumerate(standings(rows, organ, budget_ms), 1):
        lines.append(
            f"| {place} | `{standing.label}`{_remarks(standing)} | {_figures(standing)} "
            f"| {standing.relative(SECOND):.3f} ({second.index(standing.label) + 1}) "
            f"| {costs[standing.label]:.3g} | {standing.steps:.3g} | {standing.ms:.3g} |"
        )
    return "\n".join(lines)


def _figures(standing: Standing) -> str:
    errors = standing.errors()
    relative = [error.relative for error in errors]
    mean = statistics.mean(error.mean_mm for error in errors)
    p95 = statistics.mean(error.p95_mm for error in errors)
    largest = max(error.largest_mm for error in errors)
    volume = max(error.volume for error in errors)
    return (
        f"**{standing.relative():.3f}** | {min(relative):.3f} .. {max(relative):.3f} "
        f"| {mean:.2f} | {p95:.2f} | {largest:.1f} | {volume:.1%}"
    )


def _remarks(standing: Standing) -> str:
    remarks = []
    if not standing.rows[0].real_time:
        remarks.append("slower than real time")
    if standing.lost:
        remarks.append(f"{standing.lost} frames lost")
    return f" ({', '.join(remarks)})" if remarks else ""
