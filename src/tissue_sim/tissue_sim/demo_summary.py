"""summary.json: what a session amounted to, from its bag, the monitor, the script and a replay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tissue_sim.operation_report import OperationReport, operation_report
from tissue_sim.run_report import read_json
from tissue_sim.session import SessionPlan
from tissue_sim.session_bag import read_epochs


def demo_summary(
    plan: SessionPlan, cpu_share: dict[str, float], load_before: float
) -> dict[str, Any]:
    """Gather the summary of a session that has ended.

    Args:
        plan: What took part.
        cpu_share: Share of one core each process used, by name.
        load_before: Load average of the machine before the start.

    Raises:
        ValueError: The bag cannot be read.
    """
    from viz_bridge.summary import summarise

    summary = summarise(plan.bag_folder, plan.monitor_file if plan.monitor else None)
    epoch = read_epochs(plan.bag_folder)[-1]
    replayed = operation_report(epoch.entries, epoch.start, holes=tuple(epoch.holes.values()))
    summary["session_seconds"] = summary.pop("wall_seconds")
    summary["cpu_share"] = {name: round(share, 3) for name, share in cpu_share.items()}
    summary["load_average_before"] = load_before
    summary["replayed_bit_for_bit"] = not replayed.mismatches
    summary["finite"] = replayed.finite
    summary["grabs"] = [
        {"tool": grab.tool, "frame": grab.frame, "nodes": grab.nodes, "moved_mm": grab.moved_mm}
        for grab in replayed.grabs
    ]
    for hole in replayed.holes:
        for told in summary["holes"]:
            if told["name"] == hole.hole.name:
                told["at_end"] = hole.document()
    _complete_cuts(summary["cuts"], replayed, read_json(plan.script_file).get("requests", []))
    return summary


def _complete_cuts(
    cuts: list[dict[str, Any]], replayed: OperationReport, requests: list[dict[str, Any]]
) -> None:
    """Add what every frame of the replay and the service's answers say about each cut."""
    openings = {cut.version: cut for cut in replayed.cuts}
    answers = {entry["version"]: entry for entry in requests if entry.get("version")}
    for cut in cuts:
        if cut["version"] in openings:
            exact = openings[cut["version"]]
            cut["opening_mm"], cut["frame"] = exact.opening_mm, exact.frame
        answer = answers.get(cut["version"])
        if answer is not None:
            for name in ("faces_split", "nodes_added", "nodes_moved", "plan_ms", "apply_ms"):
                cut[name] = answer[name]


def write_summary(path: Path, summary: dict[str, Any]) -> None:
    """Write summary.json."""
    path.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")


def print_summary(console: Console, summary: dict[str, Any]) -> None:
    """Print the summary as a table."""
    geometry = summary["geometry"]
    table = Table(title="summary", show_header=False)
    kind = "triangles" if "triangles" in geometry else "tetrahedra"
    table.add_row(
        str(geometry.get("name", "")),
        f"{geometry.get('nodes', 0):,} nodes, {geometry.get(kind, 0):,} {kind}, "
        f"model {summary['model']}",
    )
    late = summary.get("late_frames") or 0
    share = 100.0 * late / max(summary["frames"], 1)
    table.add_row(
        "frames",
        f"{summary['frames']} at {summary.get('published_hz') or 0.0:.2f} Hz, "
        f"{late} late ({share:.2f} %), {summary.get('lost_states') or 0} not received",
    )
    for name, title in (("step_ms", "model step, ms"), ("pose_to_state_ms", "pose to state, ms")):
        table.add_row(title, _quantiles(summary.get(name)))
    table.add_row("model steps per second", f"{summary['model_steps_per_second']:.0f}")
    for grab in summary["grabs"]:
        table.add_row(
            f"grab by {grab['tool']}", f"{grab['nodes']} nodes, moved {grab['moved_mm']:.1f} mm"
        )
    for patch in summary["patches"]:
        carried = f", carried by {patch['carried_by']}" if patch["carried_by"] else ""
        text = f"{patch['name']}: {patch['nodes']} nodes, {patch['area_cm2']:.3g} cm2{carried}"
        table.add_row("patch", text)
    for cut in summary["cuts"]:
        table.add_row("cut", _cut_in_words(cut))
    for hole in summary["holes"]:
        table.add_row(f"hole {hole['name']} at the end", _hole_in_words(hole))
    shares = ", ".join(f"{name} {100 * cpu:.0f}" for name, cpu in summary["cpu_share"].items())
    table.add_row("processor time, % of a core", shares)
    table.add_row("load average before", f"{summary['load_average_before']:.2f}")
    table.add_row("replays bit for bit", "yes" if summary["replayed_bit_for_bit"] else "NO")
    table.add_row("whole demo, s", f"{summary['wall_seconds']:.1f}")
    console.print(table)


def _quantiles(values: object) -> str:
    if not isinstance(values, dict):
        return "not counted"
    return ", ".join(
        f"{name} {value:.2f}" if isinstance(value, float) else f"{name} {value:,}"
        for name, value in values.items()
        if isinstance(value, int | float)
    )


def _hole_in_words(hole: dict[str, Any]) -> str:
    end = hole.get("at_end", hole)
    if "covered" not in end:
        return str(end.get("problem") or "not measured")
    return (
        f"{100 * end['covered']:.1f} % of {end['area_mm2']:.0f} mm^2 covered, "
        f"widest gap {end['gap_mm']:.2f} mm"
    )


def _cut_in_words(cut: dict[str, Any]) -> str:
    text = f"{cut['faces_split']} faces split, {cut['nodes_added']} nodes added"
    if cut.get("plan_ms") is not None:
        text += f", planned in {cut['plan_ms']:.0f} ms, applied in {cut['apply_ms']:.2f} ms"
    return f"{text}, opened {cut['opening_mm']:.1f} mm"
