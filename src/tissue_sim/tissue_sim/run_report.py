"""What came of a headless run, for people."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tissue_sim.operation_report import OperationReport, operation_report
from tissue_sim.session import SessionPlan
from tissue_sim.session_bag import read_epochs


@dataclass
class RunReport:
    """What came of a run.

    Attributes:
        operation: What was done to the tissue; None without a bag.
        monitor: What the monitor counted; empty if it did not write anything.
        requests: What the services answered to the script.
        problems: What went wrong, for people.
    """

    operation: OperationReport | None = None
    monitor: dict[str, Any] = field(default_factory=dict)
    requests: list[dict[str, Any]] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Whether nothing went wrong."""
        return not self.problems


def read_report(plan: SessionPlan) -> RunReport:
    """Gather what the processes of a session left behind."""
    report = RunReport(monitor=read_json(plan.monitor_file))
    script = read_json(plan.script_file)
    report.requests = script.get("requests", [])
    report.problems += [
        f"{entry['action']} at {entry['time']:g} s failed: {entry['message']}"
        for entry in report.requests
        if not entry["success"]
    ]
    if plan.bag:
        epoch = read_epochs(plan.bag_folder)[-1]
        holes = tuple(epoch.holes.values())
        report.operation = operation_report(epoch.entries, epoch.start, holes=holes)
        if not report.operation.finite:
            report.problems.append("positions are not finite")
        if report.operation.mismatches:
            report.problems.append(
                f"replaying the journal gave other positions from frame "
                f"{report.operation.mismatches[0]} on"
            )
    return report


def print_report(console: Console, plan: SessionPlan, report: RunReport) -> None:
    """Print the summary of a run."""
    table = Table(title=f"{plan.scene.name}", show_header=False)
    operation = report.operation
    for name in ("published_hz", "frames", "late_frames"):
        if name in report.monitor:
            table.add_row(name.replace("_", " "), _text(report.monitor[name]))
    if operation is not None:
        table.add_row("frames in the journal", str(operation.frames))
        table.add_row("model steps", str(operation.steps))
        for grab in operation.grabs:
            table.add_row(
                f"grab by {grab.tool}", f"{grab.nodes} nodes, moved {grab.moved_mm:.1f} mm"
            )
        if not operation.grabs:
            table.add_row("grabs", "none")
    for entry in report.requests:
        if entry["action"] == "cut" and entry["success"]:
            table.add_row(
                "cut",
                f"{entry['faces_split']} faces split, {entry['nodes_added']} nodes added, "
                f"planned in {entry['plan_ms']:.0f} ms, applied in {entry['apply_ms']:.2f} ms",
            )
    if operation is not None:
        for patch in operation.patches:
            table.add_row("patch", str(patch))
        for cut in operation.cuts:
            table.add_row("opening", f"{cut.opening_mm:.1f} mm")
        for hole in operation.holes:
            table.add_row(f"hole {hole.hole.name} at the end", str(hole))
        table.add_row("finite", "yes" if operation.finite else "NO")
        table.add_row("replays bit for bit", "NO" if operation.mismatches else "yes")
    console.print(table)
    for problem in report.problems:
        console.print(f"problem: {problem}", markup=False)


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object from a file; empty where there is none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _text(value: object) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value)
