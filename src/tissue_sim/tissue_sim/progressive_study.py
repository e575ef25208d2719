"""What a progressive cut costs the loop: an operation with it and the same motion without it.

As in `loop_study`, the machine is shared: both take turns, and what counts is the difference within
the pairs. Run it with `python3 -m tissue_sim.progressive_study`.
"""

from __future__ import annotations

import argparse
import json
import statistics
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tissue_sim.free_domain import choose_domain
from tissue_sim.loop_study import LoopRow, machine, run_once
from tissue_sim.runner import empty_folder
from tissue_sim.scene_file import config_folder

WITH, WITHOUT = "cutting", "same motion, not pressed"
PROCEDURE = "progressive_cut.yaml"


def run_study(out: Path, repeats: int, scene: str = "heart") -> dict[str, Any]:
    """Run the pairs and write what was counted.

    Args:
        out: Folder to write; `progressive.json` is the result.
        repeats: Number of pairs.
        scene: Scene to operate on.
    """
    print(f"{2 * repeats} runs in ROS domain {choose_domain()}")
    procedures = {WITH: config_folder() / "procedures" / PROCEDURE}
    procedures[WITHOUT] = _not_pressed(procedures[WITH], empty_folder(out) / "not_pressed.yaml")
    rows: list[LoopRow] = []
    strokes: list[dict[str, Any]] = []
    for pair in range(repeats):
        for variant in (WITH, WITHOUT) if pair % 2 == 0 else (WITHOUT, WITH):
            rows.append(run_once(out / "run", scene, procedures[variant], pair, variant))
            if variant == WITH:
                strokes.append(_stroke_in(out / "run" / "session"))
            print(
                f"pair {pair + 1} {variant}: {rows[-1].late} of {rows[-1].frames} late, "
                f"{rows[-1].hz:.2f} Hz"
            )
    result = {
        "machine": machine(),
        "rows": [asdict(row) for row in rows],
        "strokes": strokes,
        **_judged(rows, strokes),
    }
    (out / "progressive.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def _not_pressed(procedure: Path, target: Path) -> Path:
    content = yaml.safe_load(procedure.read_text(encoding="utf-8"))
    blades = [name for name, tool in content["tools"].items() if tool["kind"] == "cut"]
    content["timeline"] = [
        event
        for event in content["timeline"]
        if not {event.get("press"), event.get("release")} & set(blades)
    ]
    target.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return target


def _stroke_in(bag: Path) -> dict[str, Any]:
    """Figures of the stroke, as the cutting service published them last."""
    from viz_bridge.bag_reader import read_bag

    figures: dict[str, Any] = {}
    for recorded in read_bag(bag, ["/diagnostics"]):
        for status in recorded.message.status:
            for value in status.values:
                if value.key == "last stroke in figures" and value.value:
                    figures = json.loads(value.value)
    if not figures:
        raise ValueError(f"{bag} has no stroke: the blade cut nothing")
    return figures


def _judged(rows: list[LoopRow], strokes: list[dict[str, Any]]) -> dict[str, Any]:
    late = {v: {r.pair: r.late for r in rows if r.variant == v} for v in (WITH, WITHOUT)}
    differences = [late[WITH][pair] - late[WITHOUT][pair] for pair in sorted(late[WITH])]

    def spread(name: str) -> dict[str, float]:
        values = np.concatenate([np.array(stroke[name], dtype=float) for stroke in strokes])
        return {
            "median": float(np.median(values)),
            "p95": float(np.percentile(values, 95)),
            "most": float(values.max()),
        }

    return {
        "late_difference": differences,
        "late_difference_median": statistics.median(differences),
        "late_share_median": statistics.median(row.late_share for row in rows),
        "machine_late_share_median": statistics.median(row.machine_late_share for row in rows),
        "hz_median": statistics.median(row.hz for row in rows if row.variant == WITH),
        "plan_ms": spread("plan_ms"),
        "apply_ms": spread("apply_ms"),
        "lag_frames": spread("lag"),
    }


def as_markdown(result: dict[str, Any]) -> str:
    """The figures as a table."""
    lines = ["| | median | 95 % | most |", "|---|---|---|---|"]
    for name, words in (
        ("plan_ms", "planning a strip, or those joined [ms]"),
        ("apply_ms", "applying it, inside the loop [ms]"),
        ("lag_frames", "from the blade's pose to the tissue open behind it [frames]"),
    ):
        spread = result[name]
        lines.append(
            f"| {words} | {spread['median']:.3g} | {spread['p95']:.3g} | {spread['most']:.3g} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--scene", default="heart")
    parser.add_argument("--out", type=Path, default=Path("out/progressive"))
    chosen = parser.parse_args()
    print(as_markdown(run_study(chosen.out, chosen.repeats, chosen.scene)))


if __name__ == "__main__":
    main()
