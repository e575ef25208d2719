"""The reproduced table for a terminal and for the page."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

VERDICTS = {True: "yes", False: "no", None: ""}


def print_table(result: dict[str, Any], console: Console | None = None) -> None:
    """Print a result beside the thesis, one line a row in 80 columns."""
    console = console or Console()
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("relative to the worst", no_wrap=True, min_width=27)
    for heading, width in (
        ("ours", 5), ("range", 11), ("thesis", 6), ("agrees", 6), ("fps", 6), ("thesis", 6),
    ):  # fmt: skip
        table.add_column(heading, justify="right", no_wrap=True, min_width=width)
    for row in result["rows"]:
        color = {True: "green", False: "red", None: ""}[row["agrees"]]
        verdict = VERDICTS[row["agrees"]]
        table.add_row(
            _short(row["row"]), _number(row["relative_to_worst"]), _spread(row["relative_range"]),
            _number(row["thesis_relative_to_worst"]),
            f"[{color}]{verdict}[/]" if color else verdict,
            _rate(row["frames_per_second"]), _rate(row["thesis_frames_per_second"]),
        )  # fmt: skip
    console.print(table, highlight=False)


def as_markdown(result: dict[str, Any]) -> str:
    """The table for the page."""
    lines = [
        "| model | thesis | ours, median | range | agrees | steps a frame | frames a second "
        "| thesis |",
        "|---" * 8 + "|",
    ]
    for row in result["rows"]:
        steps = "" if row["steps_per_frame"] is None else f"{row['steps_per_frame']:g}"
        cells = [
            row["row"], _number(row["thesis_relative_to_worst"]),
            _number(row["relative_to_worst"]), _spread(row["relative_range"], " to "),
            VERDICTS[row["agrees"]], steps, _rate(row["frames_per_second"]),
            _rate(row["thesis_frames_per_second"]),
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def parameters_as_markdown(result: dict[str, Any]) -> str:
    """What was fitted, beside what the thesis found: medians, and least to largest."""
    lines = [
        "| model | value | thesis | one spring for each edge | repeated for each element |",
        "|---" * 5 + "|",
    ]
    for row in result["rows"]:
        for name, found in row["parameters"].items():
            cells = [
                _found([
                    trial["values"][name]
                    for trial in result["trials"]
                    if trial["row"] == row["row"] and trial["per_element"] in variants
                ])
                for variants in ((0.0, None), (1.0,))
            ]  # fmt: skip
            lines.append(
                f"| {row['row']} | `{name}` | {found['thesis']:.3g} | {' | '.join(cells)} |"
            )
    return "\n".join(lines)


def _found(values: list[float]) -> str:
    if not values:
        return "the same"
    middle = float(np.median(values))
    return f"{middle:.3g} ({min(values):.3g} to {max(values):.3g})"


def thesis_values_as_markdown(result: dict[str, Any]) -> str:
    """What the values that the thesis found give here, by how many springs lie along an edge."""
    lines = [
        "| model, with the thesis' values | thesis | one spring for each edge "
        "| repeated for each element |",
        "|---" * 4 + "|",
    ]
    for row in result["rows"]:
        entries = {entry["per_element"]: entry for entry in row["with_thesis_values"]}
        if not entries:
            continue
        once, repeated = (
            [_of_variant(entries[variant]) for variant in (0.0, 1.0)]
            if 0.0 in entries
            else [_of_variant(entries[None]), "the same"]
        )
        lines.append(
            f"| {row['row']} | {_number(row['thesis_relative_to_worst'])} | {once} | {repeated} |"
        )
    return "\n".join(lines)


def _of_variant(entry: dict[str, Any]) -> str:
    lost = f"lost in {entry['lost']} of {entry['trials']}" if entry["lost"] else ""
    return ", ".join(part for part in (_spread(entry["relative_range"], " to "), lost) if part)


def _short(name: str) -> str:
    """A name that leaves room for the numbers in 80 columns."""
    for long, short in (
        ("quasi-static", "qs"), ("connected surfaces", "surfaces"), ("up to ", "<= "),
        (" passes", ""), ("stiffnesses", "stiffn."), ("at full ", "at "),
    ):  # fmt: skip
        name = name.replace(long, short)
    return name


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _spread(spread: list[float] | None, between: str = "-") -> str:
    return "" if spread is None else f"{spread[0]:.3f}{between}{spread[1]:.3f}"


def _rate(value: float | None) -> str:
    return "" if value is None else f"{value:,.0f}"
