"""The rows of the bench as tables for a terminal and for the README."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

WIDE = 110
"""Columns of a terminal from which on the nodes and springs of a step are shown too."""

_ALWAYS = (("ms a step", 9), ("steps/s", 7), ("of limit", 15), ("thesis", 6))
_IF_WIDE = (("nodes", 8), ("springs", 10))
"""Headings with the width they get at least: with the longest names 77 columns, or 99."""


IN_SHORT = (
    ("wall", "quasi_static, all nodes"), ("wall", "spring_mass"), ("wall", "relaxation, one pass"),
    ("wall", "lr, L = 4, one pass"), ("wall", "finite_element, motions known"),
    ("wall", "vertex_block_descent, all nodes"), ("heart", "quasi_static, L = 4"),
    ("heart", "spring_mass"), ("heart", "relaxation, one pass"), ("heart", "lr, L = 4, one pass"),
    ("heart", "finite_element, iterating"), ("heart", "finite_element, motions known"),
    ("heart", "vertex_block_descent, L = 4"), ("fine heart", "lr, L = 4, one pass"),
    ("fine heart", "finite_element, iterating"),
)  # fmt: skip
"""Rows of the README's table."""


def in_short(result: dict[str, Any]) -> str:
    """Some rows of a result as a table for a page."""
    rows = {(row["geometry"], row["model"]): row for row in result["rows"]}
    lines = [
        "| geometry | nodes | model | ms a step | steps a second | thesis |",
        "|---|---|---|---|---|---|",
    ]
    for geometry, model in IN_SHORT:
        row = rows[geometry, model]
        thesis = f"{row['thesis_fps']:.0f}" if row["thesis_fps"] else ""
        lines.append(
            f"| {geometry} | {row['nodes']:,} | {model} | {row['ms_per_step']:.3f} "
            f"| {row['steps_per_second']:,.0f} | {thesis} |"
        )
    return "\n".join(lines)


def print_table(result: dict[str, Any], console: Console | None = None) -> None:
    """Print the rows of a result, a table for each geometry, one line a row.

    A terminal below 110 columns gets fewer columns rather than cells of several lines.
    """
    console = console or Console()
    machine = result["machine"]["processor"]
    console.print(f"{machine}, triad {result['triad_GBps']:.1f} GB/s, one thread", highlight=False)
    rows = result["rows"]
    longest = max(len(row["model"]) for row in rows)
    for name in dict.fromkeys(row["geometry"] for row in rows):
        console.print()
        console.print(
            _table([row for row in rows if row["geometry"] == name], longest, console.width)
        )
    console.print()
    notes = [
        "of limit: share of what memory or arithmetic allow one thread",
        "thesis: steps a second on a desktop of 2003",
    ]
    if console.width < WIDE:
        notes.append(f"from {WIDE} columns on: nodes and springs of a step too")
    for note in notes:
        console.print(note, highlight=False)


def _table(rows: list[dict[str, Any]], longest: int, width: int) -> Table:
    first = rows[0]
    elements = f", {first['elements']:,} tetrahedra" if first["elements"] else ""
    title = f"{first['geometry']}: {first['nodes']:,} nodes{elements}"
    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=None,
        padding=(0, 2, 0, 0),
        pad_edge=False,
    )
    columns = (*_IF_WIDE, *_ALWAYS) if width >= WIDE else _ALWAYS
    table.add_column("model", no_wrap=True, min_width=longest)
    for heading, least in columns:
        table.add_column(heading, justify="right", no_wrap=True, min_width=least)
    for row in rows:
        cells = _cells(row)
        table.add_row(row["model"], *(cells[heading] for heading, _ in columns))
    return table


def _cells(row: dict[str, Any]) -> dict[str, str]:
    return {
        "nodes": f"{row['active_nodes']:,}",
        "springs": f"{row['springs_visited']:,}",
        "ms a step": f"{row['ms_per_step']:.3f}",
        "steps/s": f"{row['steps_per_second']:,.0f}",
        "of limit": f"{row['limit_share']:.0%} {row['limit']}",
        "thesis": f"{row['thesis_fps']:.0f}/s" if row["thesis_fps"] else "",
    }
