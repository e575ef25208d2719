"""What a cut costs the loop: the demo's operation with and without its cuts, in pairs.

The machine is shared, so a single run says little: both variants take turns, the order of each pair
alternating, and what counts is the difference within the pairs. How late an empty loop is on the
same machine just before stands beside each run.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.table import Table

from tissue_sim.demo import operate
from tissue_sim.free_domain import choose_domain
from tissue_sim.run_report import read_json
from tissue_sim.runner import empty_folder
from tissue_sim.scene_file import SceneFile, config_folder, find_scene
from tissue_sim.session import SessionPlan

WITH, WITHOUT = "with cuts", "without cuts"
MACHINE_FRAMES = 300
"""Frames of the empty loop before each run."""


@dataclass(frozen=True)
class LoopRow:
    """One run.

    Attributes:
        pair: Number of the pair.
        variant: With or without cuts.
        frames: Frames due.
        hz: Frames published a second.
        late: Late frames, skipped ones included.
        late_share: Share of late frames.
        pose_to_state_p50: Median latency [ms].
        pose_to_state_p99: 99th percentile [ms].
        apply_ms: Time of each cut inside the loop [ms].
        plan_ms: Time of each cut in the cutting service [ms].
        load: Load average before the run.
        machine_late_share: Share of late frames of an empty loop just before the run.
    """

    pair: int
    variant: str
    frames: int
    hz: float
    late: int
    late_share: float
    pose_to_state_p50: float
    pose_to_state_p99: float
    apply_ms: tuple[float, ...]
    plan_ms: tuple[float, ...]
    load: float
    machine_late_share: float


def run_study(out: Path, repeats: int, scene: str = "heart") -> dict[str, Any]:
    """Run the pairs and write what was counted.

    Args:
        out: Folder to write; `loop.json` is the result.
        repeats: Number of pairs.
        scene: Scene to operate on.
    """
    console = Console(highlight=False, soft_wrap=True)
    console.print(f"{2 * repeats} runs in ROS domain {choose_domain()}")
    procedures = {WITH: config_folder() / "procedures" / "demo.yaml"}
    procedures[WITHOUT] = without_cuts(procedures[WITH], empty_folder(out) / "without_cuts.yaml")
    rows = []
    for pair in range(repeats):
        order = (WITH, WITHOUT) if pair % 2 == 0 else (WITHOUT, WITH)
        for variant in order:
            rows.append(run_once(out / "run", scene, procedures[variant], pair, variant))
            console.print(in_words(rows[-1]), markup=False)
    result = {"machine": machine(), "rows": [asdict(row) for row in rows], **judge(rows)}
    (out / "loop.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    _print(console, result)
    return result


def run_once(
    out: Path, scene: str | SceneFile, procedure: Path, pair: int, variant: str
) -> LoopRow:
    """Run one session and count."""
    load, empty_loop = os.getloadavg()[0], machine_late_share()
    found = find_scene(scene) if isinstance(scene, str) else scene
    plan = SessionPlan(scene=found, out=empty_folder(out), procedure=procedure)
    operate(plan, quiet=True)
    seen = read_json(plan.monitor_file)
    requests = read_json(plan.script_file).get("requests", [])
    cuts = [entry for entry in requests if entry["action"] == "cut" and entry["success"]]
    due = int(seen["frames"]) + int(seen["lost_states"]) + int(seen["skipped_frames"])
    latency = seen["pose_to_state_ms"]
    return LoopRow(
        pair=pair,
        variant=variant,
        frames=due,
        hz=float(seen["published_hz"]),
        late=int(seen["late_frames"]),
        late_share=int(seen["late_frames"]) / max(due, 1),
        pose_to_state_p50=float(latency["p50"]),
        pose_to_state_p99=float(latency["p99"]),
        apply_ms=tuple(float(cut["apply_ms"]) for cut in cuts),
        plan_ms=tuple(float(cut["plan_ms"]) for cut in cuts),
        load=load,
        machine_late_share=empty_loop,
    )


def machine_late_share() -> float:
    """Share of late frames of an empty loop on this machine now."""
    # A process of its own: the priority ends with it.
    command = [sys.executable, "-m", "tissue_sim.machine_lateness", str(MACHINE_FRAMES)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def without_cuts(procedure: Path, target: Path) -> Path:
    """The procedure without its cuts, written to a file."""
    content = yaml.safe_load(procedure.read_text(encoding="utf-8"))
    content["timeline"] = [event for event in content["timeline"] if "cut" not in event]
    target.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return target


def judge(rows: list[LoopRow]) -> dict[str, Any]:
    """Medians of both variants, and the median difference of late frames within the pairs."""
    by = {variant: [row for row in rows if row.variant == variant] for variant in (WITH, WITHOUT)}
    late = {v: {row.pair: row.late for row in of} for v, of in by.items()}
    differences = [late[WITH][pair] - late[WITHOUT][pair] for pair in sorted(late[WITH])]
    applied = [ms for row in by[WITH] for ms in row.apply_ms]
    return {
        "late_difference": differences,
        "late_difference_median": statistics.median(differences),
        "late_share_median": statistics.median(row.late_share for row in rows),
        "machine_late_share_median": statistics.median(row.machine_late_share for row in rows),
        "hz_median": statistics.median(row.hz for row in rows),
        "pose_to_state_p99_median": statistics.median(row.pose_to_state_p99 for row in rows),
        "apply_ms_median": statistics.median(applied) if applied else None,
    }


def machine() -> dict[str, Any]:
    """What the runs were made on."""
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
    }


def in_words(row: LoopRow) -> str:
    """One run in a line."""
    return (
        f"pair {row.pair + 1} {row.variant}: {row.hz:.2f} Hz, {row.late} of {row.frames} late, "
        f"pose to state p99 {row.pose_to_state_p99:.1f} ms, load before {row.load:.1f}, "
        f"an empty loop {row.machine_late_share:.1%} late"
    )


def as_markdown(result: dict[str, Any]) -> str:
    """The runs as a table, with the medians in its last line."""
    lines = [
        "| pair | | late | an empty loop before | pose to state p99 [ms] | cut in the loop [ms] |",
        "|---|---|---|---|---|---|",
    ]
    for row in result["rows"]:
        cuts = ", ".join(f"{ms:.2f}" for ms in row["apply_ms"])
        lines.append(
            f"| {row['pair'] + 1} | {row['variant']} | {row['late']} of {row['frames']} "
            f"({row['late_share']:.2%}) | {row['machine_late_share']:.2%} "
            f"| {row['pose_to_state_p99']:.1f} | {cuts} |"
        )
    lines.append(
        f"| **medians** | | {result['late_share_median']:.2%} "
        f"| {result['machine_late_share_median']:.2%} "
        f"| {result['pose_to_state_p99_median']:.1f} | {result['apply_ms_median']:.2f} |"
    )
    return "\n".join(lines)


def _print(console: Console, result: dict[str, Any]) -> None:
    table = Table(title="the loop, with and without cuts (medians)", show_header=False)
    table.add_row("frames a second", f"{result['hz_median']:.2f}")
    table.add_row("late frames", f"{100 * result['late_share_median']:.2f} %")
    empty_loop = f"{100 * result['machine_late_share_median']:.2f} %"
    table.add_row("late frames of an empty loop", empty_loop)
    differences = ", ".join(map(str, result["late_difference"]))
    table.add_row(
        "late with minus late without", f"{result['late_difference_median']:g} ({differences})"
    )
    table.add_row("pose to state, p99, ms", f"{result['pose_to_state_p99_median']:.1f}")
    if result["apply_ms_median"] is not None:
        table.add_row("cut applied inside the loop, ms", f"{result['apply_ms_median']:.2f}")
    console.print(table)
