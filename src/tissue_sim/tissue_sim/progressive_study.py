"""What a progressive cut costs the loop: an operation with it and the same motion without it.

As in `loop_study`, the machine is shared: both take turns, and what counts is the difference within
the pairs. It is done alone, and while a second tool pulls at another place until the tissue tears.
Run it with `python3 -m tissue_sim.progressive_study`.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tissue_sim.free_domain import choose_domain
from tissue_sim.loop_study import LoopRow, machine, run_once
from tissue_sim.runner import empty_folder
from tissue_sim.scene_file import SceneFile, config_folder, find_scene

WITH, WITHOUT = "cutting", "same motion, not pressed"
PULLER = "puller"
TEARS_AT = 6e4
"""Largest principal stress that the tissue bears while a second tool tears it [Pa]."""
CUTTING_SERVICE = "/**/cut_service"


@dataclass(frozen=True)
class Case:
    """What is measured.

    Attributes:
        procedure: File in the folder of procedures.
        tears: Whether a second tool tears meanwhile; without the cut nothing tears.
    """

    procedure: str
    tears: bool = False


CASES = {
    "alone": Case("progressive_cut.yaml"),
    "second tool tears": Case("progressive_two_tools.yaml", tears=True),
}


def run_study(
    out: Path, repeats: int, scene: str = "heart", cases: Iterable[str] = CASES
) -> dict[str, Any]:
    """Run the pairs and write what was counted.

    Args:
        out: Folder to write; `progressive.json` is the result.
        repeats: Number of pairs of each case.
        scene: Scene to operate on.
        cases: Which of `CASES`.
    """
    print(f"ROS domain {choose_domain()}")
    empty_folder(out)
    result: dict[str, Any] = {"machine": machine(), "cases": {}}
    for name in cases:
        result["cases"][name] = _run_case(out, repeats, scene, name)
    (out / "progressive.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def _run_case(out: Path, repeats: int, scene: str, name: str) -> dict[str, Any]:
    case = CASES[name]
    procedures = {WITH: config_folder() / "procedures" / case.procedure}
    procedures[WITHOUT] = _not_pressed(procedures[WITH], out / f"not_pressed_{case.procedure}")
    rows: list[LoopRow] = []
    strokes: list[dict[str, Any]] = []
    edits: list[dict[str, int]] = []
    for pair in range(repeats):
        for variant in (WITH, WITHOUT) if pair % 2 == 0 else (WITHOUT, WITH):
            found = _scene(scene, case, variant)
            rows.append(run_once(out / "run", found, procedures[variant], pair, variant))
            if variant == WITH:
                stroke, kinds = _seen_in(out / "run" / "session")
                strokes.append(stroke)
                edits.append(kinds)
            print(
                f"{name}, pair {pair + 1}, {variant}: {rows[-1].late} of {rows[-1].frames} late, "
                f"{rows[-1].hz:.2f} Hz {edits[-1] if variant == WITH else ''}",
                flush=True,
            )
    return {
        "rows": [asdict(row) for row in rows],
        "strokes": strokes,
        "edits": edits,
        **judged(rows, strokes),
    }


def _scene(scene: str, case: Case, variant: str) -> SceneFile:
    """The scene with the second tool, and with tissue that tears in one of the variants."""
    found = find_scene(scene)
    if not case.tears:
        return found
    tools = [*found.simulation.get("tools", []), PULLER]
    found = found.with_simulation({"tools": tools})
    service = dict(found.parameters.get(CUTTING_SERVICE, {}))
    service["tear.threshold"] = TEARS_AT if variant == WITH else 0.0
    return replace(found, parameters={**found.parameters, CUTTING_SERVICE: service})


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


def _seen_in(bag: Path) -> tuple[dict[str, Any], dict[str, int]]:
    """Figures of the stroke, as the cutting service published them last; edits of each kind."""
    from viz_bridge.bag_reader import read_bag

    figures: dict[str, Any] = {}
    kinds: dict[str, int] = {}
    for recorded in read_bag(bag, ["/diagnostics", "/tissue/edits"]):
        if hasattr(recorded.message, "kind"):
            kinds[recorded.message.kind] = kinds.get(recorded.message.kind, 0) + 1
            continue
        for status in recorded.message.status:
            for value in status.values:
                if value.key == "last stroke in figures" and value.value:
                    figures = json.loads(value.value)
    if not figures:
        raise ValueError(f"{bag} has no stroke: the blade cut nothing")
    return figures, kinds


def judged(rows: list[LoopRow], strokes: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians of both variants, differences within the pairs, and spreads of the strokes."""
    late = {v: {r.pair: r.late for r in rows if r.variant == v} for v in (WITH, WITHOUT)}
    differences = [late[WITH][pair] - late[WITHOUT][pair] for pair in sorted(late[WITH])]
    cutting = [row for row in rows if row.variant == WITH]

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
        "late_share_with": statistics.median(row.late_share for row in cutting),
        "late_share_without": statistics.median(r.late_share for r in rows if r.variant == WITHOUT),
        "machine_late_share_median": statistics.median(row.machine_late_share for row in rows),
        "hz_median": statistics.median(row.hz for row in cutting),
        "hz_least": min(row.hz for row in cutting),
        "plan_ms": spread("plan_ms"),
        "apply_ms": spread("apply_ms"),
        "lag_frames": spread("lag"),
    }


def as_markdown(result: dict[str, Any]) -> str:
    """The figures of all cases as a table: medians, and in brackets the most or the least."""
    cases = result["cases"]
    lines = ["| | " + " | ".join(cases) + " |", "|---" * (1 + len(cases)) + "|"]

    def row(words: str, figures: list[str]) -> None:
        lines.append(f"| {words} | " + " | ".join(figures) + " |")

    each = list(cases.values())
    row("pairs of runs", [str(len(case["late_difference"])) for case in each])
    row("frames a second while cutting (least)", [
        f"{case['hz_median']:.2f} ({case['hz_least']:.2f})" for case in each
    ])  # fmt: skip
    row("late with the cut, without, an empty loop", [
        f"{case['late_share_with']:.2%}, {case['late_share_without']:.2%}, "
        f"{case['machine_late_share_median']:.2%}" for case in each
    ])  # fmt: skip
    row("late with minus late without, pair by pair", [
        ", ".join(f"{count:+d}" for count in case["late_difference"]) for case in each
    ])  # fmt: skip
    row("edits: strips, tears", [
        "; ".join(
            f"{sum(n for k, n in kinds.items() if k != 'tear')}, {kinds.get('tear', 0)}"
            for kinds in case["edits"]
        )
        for case in each
    ])  # fmt: skip
    for name, words in (
        ("plan_ms", "planning a strip, or those joined [ms] (most)"),
        ("apply_ms", "applying it, inside the loop [ms] (most)"),
        ("lag_frames", "from the blade's pose to the tissue open behind it [frames] (most)"),
    ):
        row(words, [f"{case[name]['median']:.3g} ({case[name]['most']:.3g})" for case in each])
    return "\n".join(lines)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--scene", default="heart")
    parser.add_argument("--case", choices=list(CASES), action="append", help="default: all")
    parser.add_argument("--out", type=Path, default=Path("out/progressive"))
    chosen = parser.parse_args()
    cases = chosen.case or list(CASES)
    print(as_markdown(run_study(chosen.out, chosen.repeats, chosen.scene, cases)))


if __name__ == "__main__":
    main()
