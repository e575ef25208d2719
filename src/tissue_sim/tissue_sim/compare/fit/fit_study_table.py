"""The figures of `fit_study` as tables for a terminal and for a page."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table


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
    wanted = {row["strategy"]: row["wanted"] for row in result["self"]}
    for line in (
        "reached: below "
        + ", ".join(f"{error:g} with {strategy}" for strategy, error in wanted.items()),
        f"{timed['candidates']} candidates x {timed['generations']} generations to "
        f"{result['reference']}: {timed['serial_s']:.1f} s in one process, "
        f"{timed['pool_s']:.1f} s in {timed['processes']}",
        f"the same seed gives the same result: {_yes(timed['same_seed_same_result'])}",
        f"interrupted and resumed gives the same: {_yes(timed['resumed_same_result'])}",
    ):
        console.print(line, highlight=False, soft_wrap=True)


def as_markdown(result: dict[str, Any]) -> str:
    """The models fitted to themselves as a table."""
    lines = [
        "| fitted to itself | by | seed | error, of the worst | wanted | reached after | product |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in result["self"]:
        after, product = row["wanted_after"], row["product"]
        lines.append(
            f"| {row['name']} | `{row['strategy']}` | {row['seed']} | {row['error']:.1e} "
            f"| {row['wanted']:g} | "
            + ("not" if after is None else f"{after} of {row['evaluations']} evaluations")
            + f" | {'' if product is None else f'{product:.6f}'} |"
        )
    return "\n".join(lines)


def _yes(true: bool) -> str:
    return "yes" if true else "no"
