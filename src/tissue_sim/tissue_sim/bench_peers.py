"""Other simulators on the same mesh and material: time until the tissue is where it belongs."""

from __future__ import annotations

import importlib.util
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tissue_sim.bench import machine
from tissue_sim.elastic import registry
from tissue_sim.peers import bullet_soft, mujoco_flex, newton_soft, own_models
from tissue_sim.peers.measure import TARGET, Entry, measure
from tissue_sim.peers.task import Task, task_of

GEOMETRIES = ("wall", "block")

LOCK = "requirements/bench-py{}{}.lock".format(*sys.version_info)
INSTALL = f".venv/bin/pip install --requirement {LOCK}"


HEADINGS = (
    "geometry", "simulator", "settings", f"ms until within {TARGET:.0%}", "steps", "ms a step",
    "mean error at the end", "largest",
)  # fmt: skip

OWN = (
    *(
        Entry(name, settings, partial(own_models.OwnModel, name))
        for name, settings in own_models.SETTINGS.items()
    ),
    Entry("finite_element, motion known", ({},), own_models.KnownMotion),
)
PEERS = (
    Entry("MuJoCo flex", mujoco_flex.SETTINGS, mujoco_flex.MujocoFlex, "mujoco", "Apache-2.0"),
    Entry("newton VBD", newton_soft.VBD_SETTINGS, newton_soft.NewtonVbd, "newton", "Apache-2.0"),
    Entry("newton XPBD", newton_soft.XPBD_SETTINGS, newton_soft.NewtonXpbd, "newton", "Apache-2.0"),
    Entry("PyBullet", bullet_soft.SETTINGS, bullet_soft.BulletSoft, "pybullet", "zlib"),
)


def run_peers(
    out: Path | None = Path("out/bench_peers.json"),
    seconds: float = 5.0,
    geometries: tuple[str, ...] = GEOMETRIES,
    entries: tuple[Entry, ...] = OWN + PEERS,
    report: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Pull the same tissue with every simulator that is installed.

    Args:
        out: File to write; None writes nothing.
        seconds: Most time of steps in a run that does not arrive [s].
        geometries: What to pull.
        entries: Simulators.
        report: Told what goes on.

    Returns:
        Machine, packages, tasks, rows and what is missing, as in the file.
    """
    missing = {entry.label: line for entry in entries if (line := missing_line(entry))}
    for label, line in missing.items():
        report(f"{label} {line}")
    registry.warm_up()
    present = [entry for entry in entries if entry.label not in missing]
    rows, tasks = [], []
    before = machine()
    for geometry in geometries:
        task = task_of(geometry)
        tasks.append(_described(task))
        for entry in present:
            report(f"{geometry}: {entry.label}")
            rows.append(measure(entry, task, seconds))
    result = {
        "machine": before | {"load_average_after": machine()["load_average"]},
        "packages": _packages(present),
        "target": TARGET,
        "seconds": seconds,
        "tasks": tasks,
        "rows": rows,
        "missing": missing,
    }
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return result


def missing_line(entry: Entry) -> str:
    """How to install what an entry needs, or "" where it is installed."""
    if entry.package and importlib.util.find_spec(entry.package) is None:
        return f"not installed: {INSTALL}"
    return ""


def _described(task: Task) -> dict[str, Any]:
    return {
        "geometry": task.geometry,
        "nodes": len(task.points),
        "elements": len(task.tets),
        "free_nodes": int(task.free.sum()),
        "held_nodes": len(task.held),
        "pull_mm": (1e3 * task.vector).tolist(),
        **asdict(task.material),
    }


def _packages(entries: list[Entry]) -> dict[str, dict[str, str]]:
    licences = {entry.package: entry.licence for entry in entries if entry.package}
    if "newton" in licences:
        licences["warp-lang"] = "Apache-2.0"
    return {
        name: {"version": metadata.version(name), "licence": licence}
        for name, licence in licences.items()
    }


def _lines(result: dict[str, Any]) -> list[list[str]]:
    """Rows of the table: by geometry, the soonest first."""
    order = {task["geometry"]: place for place, task in enumerate(result["tasks"])}

    def key(row: dict[str, Any]) -> tuple[float, ...]:
        arrived = row["arrived_ms"]
        return (order[row["geometry"]], np.inf if arrived is None else arrived, row["error"])

    return [_line(row) for row in sorted(result["rows"], key=key)]


def _line(row: dict[str, Any]) -> list[str]:
    settings = ", ".join(f"{name} {_number(value)}" for name, value in row["settings"].items())
    arrived = row["arrived_ms"]
    return [
        row["geometry"],
        row["simulator"],
        settings or "defaults",
        _time(arrived) if arrived is not None else _never(row),
        f"{row['steps']:,}",
        _time(row["step_ms"]),
        f"{row['error']:.1%}",
        f"{row['largest']:.1%}",
    ]


def _never(row: dict[str, Any]) -> str:
    if row["end"] == "lost":
        return "never: lost"
    if row["end"] == "at rest":
        return f"never: rests at {row['error']:.0%}"
    return f"not in {1e-3 * row['steps'] * row['step_ms']:.0f} s: at {row['error']:.0%}"


def _time(ms: float) -> str:
    return f"{ms:.3g}" if ms < 100 else f"{ms:,.0f}"


def _number(value: float | str) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def as_markdown(result: dict[str, Any]) -> str:
    """The rows of a result as a table for a page; peers in bold."""
    peers = {row["simulator"] for row in result["rows"] if row["peer"]}
    lines = [f"| {' | '.join(HEADINGS)} |", "|---" * len(HEADINGS) + "|"]
    for line in _lines(result):
        name = f"**{line[1]}**" if line[1] in peers else line[1]
        lines.append(f"| {' | '.join([line[0], name, *line[2:]])} |")
    return "\n".join(lines)


def print_table(result: dict[str, Any], console: Console | None = None) -> None:
    """Print the rows of a result, without the settings, and what is missing."""
    console = console or Console()
    table = Table(title=f"{result['machine']['processor']}, one thread each")
    shown = [place for place, heading in enumerate(HEADINGS) if heading != "settings"]
    for place in shown:
        table.add_column(HEADINGS[place], justify="left" if place < shown[2] else "right")
    for line in _lines(result):
        table.add_row(*(line[place] for place in shown))
    console.print(table)
    for label, line in result["missing"].items():
        console.print(f"{label}: {line}", soft_wrap=True, highlight=False)
