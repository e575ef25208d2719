"""The repair of an atrial septal defect, played in real time with several models and looked at.

Each run is a session of its own: all processes, recorded. What happened to the tissue is found by
replaying its journal, in which every frame is there. Run it with
`python3 -m tissue_sim.repair_study`; the figures are in docs/asd_repair.md.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tissue_sim.demo import operate
from tissue_sim.free_domain import choose_domain
from tissue_sim.loop_study import machine, machine_late_share
from tissue_sim.repair_report import repair_report
from tissue_sim.run_report import read_json
from tissue_sim.runner import empty_folder
from tissue_sim.scene_file import config_folder, find_scene
from tissue_sim.session import SessionPlan
from tissue_sim.session_bag import read_epochs

MODELS = ("lr", "vertex_block_descent", "finite_element")
PROCEDURE = "asd_repair.yaml"
PARAMETERS: Mapping[str, Mapping[str, Any]] = {"lr": {"lr.sweeps": 2}}
"""Of some models, for this operation: where few steps fit in a frame, one sweep in each leaves the
closed atrium ajar."""


def run_study(
    out: Path, models: Sequence[str] = MODELS, changes: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Play the procedure with each model and write what came of it.

    Args:
        out: Folder to write: a folder for each model, and `asd_repair.json`.
        models: Names of elastic models.
        changes: Other parameters of the simulation, such as a coarser `shape.cell`.
    """
    print(f"{len(models)} runs in ROS domain {choose_domain()}")
    rows = []
    for model in models:
        rows.append(run_once(out / model, model, changes or {}))
        print(in_words(rows[-1]))
    result = {"machine": machine(), "rows": rows}
    (out / "asd_repair.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def run_once(out: Path, model: str, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Play the procedure once; its figures, as plain JSON values.

    Raises:
        LaunchError: A step of the procedure failed, or a process ended.
    """
    load, empty_loop = os.getloadavg()[0], machine_late_share()
    procedure = config_folder() / "procedures" / PROCEDURE
    plan = SessionPlan(
        scene=find_scene("heart").with_simulation(
            {"model": model, **PARAMETERS.get(model, {}), **changes}
        ),
        out=empty_folder(out),
        procedure=procedure,
    )
    operate(plan, quiet=True)
    return {
        "model": model,
        "load": load,
        "machine_late_share": empty_loop,
        **_loop(read_json(plan.monitor_file)),
        "steps": requests_of(plan.script_file),
        **tissue_figures(plan.bag_folder, procedure),
    }


def tissue_figures(bag: Path, procedure: Path) -> dict[str, Any]:
    """What the procedure did to the tissue, from the journal in a session's bag."""
    from tool_input.procedure import load_procedure

    epoch = read_epochs(bag)[-1]
    return repair_report(epoch.entries, epoch.start, load_procedure(procedure))


def _loop(seen: Mapping[str, Any]) -> dict[str, Any]:
    frames, lost = int(seen["frames"]), int(seen["lost_states"])
    due = frames + lost + int(seen["skipped_frames"])
    return {
        "received": frames,
        "hz": float(seen["published_hz"]),
        "late": int(seen["late_frames"]),
        "late_share": int(seen["late_frames"]) / max(due, 1),
        "pose_to_state_p99": float(seen["pose_to_state_ms"]["p99"]),
    }


def requests_of(script: Path) -> list[dict[str, Any]]:
    """What the services answered to each request of a session's script."""
    kept = (
        "time", "action", "target", "success", "milliseconds", "version", "plan_ms", "apply_ms",
        "covered", "gap", "nodes", "elements",
    )  # fmt: skip
    return [
        {name: request[name] for name in kept if name in request}
        | ({"stitches": len(request["sutures"])} if "sutures" in request else {})
        for request in read_json(script).get("requests", [])
    ]


def in_words(row: Mapping[str, Any]) -> str:
    """One run in a line."""
    faults = [fault for edit in row["edits"] for fault in edit["faults"]]
    return (
        f"{row['model']}: {row['hz']:.1f} Hz, {row['late']} of {row['received']} late; "
        f"opened {row['opening_mm']:.1f} mm, {row['seen_open']:.0%} of the hole in view; "
        f"covered {row['before']['covered']:.1%} before and {row['after']['covered']:.1%} after; "
        f"{faults or 'valid after every edit'}; "
        f"{'replays' if row['replayed'] else 'DOES NOT REPLAY'}; "
        f"{'undone' if row['undone'] else 'NOT UNDONE'}"
    )


def problems(row: Mapping[str, Any]) -> list[str]:
    """What a run shows that must not be; empty if nothing."""
    wrong = [f"{s['action']} {s['target']} failed" for s in row["steps"] if not s["success"]]
    wrong += [f"{edit['kind']}: {fault}" for edit in row["edits"] for fault in edit["faults"]]
    wanted = ["split", "patch", "suture", "tighten", "suture", "tighten"]
    kinds = [edit["kind"] for edit in row["edits"]]
    checks = {
        f"edits are {kinds}": kinds == wanted,
        "the state was lost": not row["lost"],
        "the journal does not replay bit for bit": row["replayed"],
        "undoing everything does not bring back the mesh": row["undone"],
        "the hole is not in view": row["seen_before"] == 0.0 and row["seen_open"] > 0.75,
        "the hole is not open at first": row["before"]["covered"] < 0.1,
        "the hole is not closed": row["after"]["covered"] > 0.98,
        "a gap is left": row["after"]["gap_mm"] < 0.5,
        "the atrium was not opened": row["opening_mm"] > 10.0,
        "the atrium is not closed": row["lips_end_mm"]["median"] < 0.6,
    }
    return wrong + [what for what, fine in checks.items() if not fine]


def as_markdown(result: Mapping[str, Any]) -> str:
    """The runs as a table, a column for each model."""
    rows = result["rows"]
    lines = ["| | " + " | ".join(f"`{row['model']}`" for row in rows) + " |"]
    lines.append("|---" * (len(rows) + 1) + "|")

    def line(title: str, *cells: str) -> None:
        lines.append(f"| {title} | " + " | ".join(cells) + " |")

    line(
        "frames made, a second",
        *(f"{row['frames']}, {row['hz']:.1f}" for row in rows),
    )
    line(
        "late frames (an empty loop just before)",
        *(f"{row['late_share']:.1%} ({row['machine_late_share']:.1%})" for row in rows),
    )
    line("model steps in a frame", *(f"{row['steps_per_frame']:.1f}" for row in rows))
    line("requests made, refused", *(_requests(row) for row in rows))
    line(
        "edits, faults of the mesh after any of them",
        *(f"{len(row['edits'])}, {sum(len(e['faults']) for e in row['edits'])}" for row in rows),
    )
    line("applying an edit in the replay, median, most [ms]", *(_apply(row) for row in rows))
    line("atrium open, at most [mm]", *(f"{row['opening_mm']:.1f}" for row in rows))
    line("of the hole in view before, when open", *(_seen(row) for row in rows))
    line(
        "patch: nodes, elements",
        *(f"{row['patch_nodes']}, {row['patch_elements']}" for row in rows),
    )
    for title, when in (("before", "before"), ("when sewn", "sewn"), ("at the end", "after")):
        line(f"hole covered {title}, widest gap [mm]", *(_closure(row[when]) for row in rows))
    for name, title in (("rim", "the patch's stitches"), ("atrium", "the atrium's thread")):
        line(f"{title} at the end: sum, most [N]", *(_forces(row["forces"][name]) for row in rows))
    line(
        "edges of the atrium apart at the end: median, most [mm]",
        *(f"{r['lips_end_mm']['median']:.2f}, {r['lips_end_mm']['most']:.2f}" for r in rows),
    )
    line("the journal replays bit for bit", *(_yes(row["replayed"]) for row in rows))
    line(
        "undoing all edits brings back the mesh bit for bit", *(_yes(row["undone"]) for row in rows)
    )
    return "\n".join(lines)


def _requests(row: Mapping[str, Any]) -> str:
    return f"{len(row['steps'])}, {sum(not step['success'] for step in row['steps'])}"


def _apply(row: Mapping[str, Any]) -> str:
    times = [edit["apply_ms"] for edit in row["edits"]]
    return f"{statistics.median(times):.1f}, {max(times):.1f}"


def _seen(row: Mapping[str, Any]) -> str:
    return f"{row['seen_before']:.0%}, {row['seen_open']:.0%}"


def _closure(figures: Mapping[str, float]) -> str:
    return f"{figures['covered']:.1%}, {figures['gap_mm']:.2f}"


def _forces(figures: Mapping[str, float]) -> str:
    return f"{figures['sum']:.2f}, {figures['most']:.2f}"


def _yes(fine: bool) -> str:
    return "yes" if fine else "no"


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", nargs="+", default=list(MODELS))
    parser.add_argument("--out", type=Path, default=Path("out/asd_repair"))
    chosen = parser.parse_args()
    result = run_study(chosen.out, chosen.models)
    print(as_markdown(result))
    for row in result["rows"]:
        for problem in problems(row):
            print(f"{row['model']}: {problem}")


if __name__ == "__main__":
    main()
