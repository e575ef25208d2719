"""The report of sessions in a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tissue_sim.report.document import Reported
from tissue_sim.report.session import Missing
from tissue_sim.report.summary import was_moved
from tissue_sim.report.words import NONE, shown, with_unit

_COLUMNS = (
    ("path", "path", "m"), ("active", "seconds", "s"), ("idle", "idle_seconds", "s"),
    ("SPARC", "sparc", ""), ("peak force", "peak_force", "N"),
)  # fmt: skip
"""Heading, figure and unit of each column."""


def print_report(reported: Sequence[Reported], console: Console | None = None) -> None:
    """Print each session with its tools, one line each, and what a reader should know."""
    console = console or Console(highlight=False)
    for one in reported:
        session = one.session
        role = f" ({one.entry.role})" if one.entry.role else ""
        cuts = "" if isinstance(session.cuts, Missing) else f", {len(session.cuts)} cuts"
        organ = session.organ or "an organ that is not recorded"
        line = f"{session.name}{role}: {organ}, {session.seconds:.1f} s{cuts}"
        console.print(line, markup=False, soft_wrap=True)
        for note in session.notes:
            console.print(f"  {note}", markup=False, soft_wrap=True)
        tools = [tool for tool, track in session.tools.items() if was_moved(track)]
        console.print(_table(one, tools) if tools else "  no tool was moved")


def _table(one: Reported, tools: Sequence[str]) -> Table:
    by_key = {figure.key: figure for figure in one.figures}
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column("  tool", overflow="fold")
    for heading, _, unit in _COLUMNS:
        table.add_column(escape(with_unit(heading, unit)), justify="right", no_wrap=True)
    for tool in tools:
        figures = [by_key[f"tool.{tool}.{name}"] for _, name, _ in _COLUMNS]
        cells = [NONE if figure.why else shown(figure.value, figure.unit) for figure in figures]
        table.add_row(f"  {tool}", *cells)
    return table
