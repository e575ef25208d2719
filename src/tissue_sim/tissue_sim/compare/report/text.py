"""What a comparison found, in a terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from tissue_sim.compare.comparison import Comparison, Target

_HEADINGS = (
    ("mean\nmm", 6), ("of\nworst", 6), ("p95\nmm", 6), ("largest\nmm", 7),
    ("volume\nerror", 7), ("ms a\nframe", 6), ("steps a\nframe", 7),
)  # fmt: skip
"""Headings with the width they get at least: 80 columns leave 20 for the names."""


def print_comparison(comparison: Comparison, console: Console | None = None) -> None:
    """Print the targets, the closest first, one line of numbers each."""
    console = console or Console()
    for line in head_lines(comparison):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    console.print()
    console.print(_table(comparison))
    console.print()
    for line in notes(comparison):
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def print_summary(comparisons: Sequence[Comparison], console: Console | None = None) -> None:
    """Print the mean share of the worst of each target over several interactions."""
    console = console or Console()
    console.print(f"of the worst, over {len(comparisons)} interactions:", highlight=False)
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column("target", overflow="fold")
    for heading in ("mean", "least", "most"):
        table.add_column(heading, justify="right", no_wrap=True, min_width=6)
    for name, shares in summary_rows(comparisons):
        values = (sum(shares) / len(shares), min(shares), max(shares))
        table.add_row(name, *(share(value) for value in values))
    console.print(table)


def summary_rows(comparisons: Sequence[Comparison]) -> list[tuple[str, list[float]]]:
    """Each target with its shares of the worst in the order of the interactions, closest first."""
    names = [target.subject.name for target in comparisons[0].targets]
    shares = zip(*([t.relative for t in one.targets] for one in comparisons), strict=True)
    rows = [(name, list(values)) for name, values in zip(names, shares, strict=True)]
    return sorted(rows, key=lambda row: sum(row[1]))


def head_lines(comparison: Comparison) -> list[str]:
    """What was compared, in two lines."""
    mesh, interaction = comparison.organ.mesh, comparison.interaction
    elements = int(mesh.element_alive[: mesh.element_rows].sum())
    kind = "tetrahedra" if mesh.sheet is None else "triangles"
    return [
        f"{comparison.organ.name}: {mesh.node_rows:,} nodes, {elements:,} {kind}; "
        f"{interaction.name}: {len(interaction.nodes)} nodes held, "
        f"{1e3 * interaction.amplitude:.3g} mm, {interaction.seconds:.3g} s at "
        f"{interaction.rate_hz:g} Hz",
        f"reference: {reference_words(comparison)}",
    ]


def reference_words(comparison: Comparison) -> str:
    """What the reference is, in words."""
    subject, rows = comparison.reference_subject, comparison.reference.rows
    if subject is not None:
        model = f"{subject.model}, " if subject.label else ""
        return f"{subject.name} ({model}{subject.effort})"
    part = "" if rows is None else f", {len(rows):,} nodes of it"
    return f"{comparison.reference.label}{part}"


def notes(comparison: Comparison) -> list[str]:
    """What the table does not say: the worst, and who was lost."""
    worst = figure(1e3 * comparison.worst.mean)
    lines = [
        f"the worst is tissue that does not follow at all: {worst} mm",
        *(lost_words(target) for target in comparison.ranking if not target.trajectory.is_stable),
    ]
    timed = [t.subject.name for t in comparison.targets if not t.subject.effort.reproducible]
    if timed:
        lines.append(f"not reproducible, given time instead of steps: {', '.join(timed)}")
    return lines


def lost_words(target: Target) -> str:
    """When a model was lost, in words."""
    trajectory = target.trajectory
    return (
        f"{target.subject.name} is unstable: lost in frame {trajectory.stable + 1} of "
        f"{trajectory.frames} ({trajectory.stable / trajectory.rate_hz:.2f} s); from there on "
        "nothing of it follows"
    )


def cells(target: Target) -> list[str]:
    """The numbers of a target in the order of the table's columns."""
    apart, trajectory = target.difference, target.trajectory
    return [
        figure(1e3 * apart.mean), share(target.relative), figure(1e3 * apart.p95),
        figure(1e3 * apart.largest), percent(apart.largest_volume_error),
        figure(trajectory.ms_per_frame), figure(trajectory.steps_per_frame),
    ]  # fmt: skip


def figure(value: float) -> str:
    """A number with about three significant digits, never in powers of ten; nothing for nan."""
    if math.isnan(value):
        return ""
    return f"{value:,.{3 if abs(value) < 1.0 else 2 if abs(value) < 100.0 else 0}f}"


def share(value: float) -> str:
    """A share of the worst."""
    return f"{value:.3f}" if value >= 0.001 or value == 0.0 else f"{value:.0e}"


def percent(value: float) -> str:
    """A share in percent; nothing where there is none."""
    return "" if math.isnan(value) else f"{value:.2%}"


def _table(comparison: Comparison) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column("target", overflow="fold", vertical="top")
    for heading, least in _HEADINGS:
        table.add_column(heading, justify="right", no_wrap=True, min_width=least)
    for target in comparison.ranking:
        lost = not target.trajectory.is_stable
        table.add_row(
            target.subject.name + (", lost" if lost else ""), *cells(target),
            style="red" if lost else "",
        )  # fmt: skip
    return table
