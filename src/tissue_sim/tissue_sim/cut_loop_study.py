"""What many cuts cost the loop: the same operation with thirteen cuts and without, in pairs.

As in `loop_study`, the machine is shared: both take turns, and what counts is the difference within
the pairs. Here a cut comes every second, so that they are a larger part of the frames, and there
are enough of them to tell the longest. Run it with `python3 -m tissue_sim.cut_loop_study`.
"""

from __future__ import annotations

import argparse
import json
import statistics
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tissue_sim.free_domain import choose_domain
from tissue_sim.loop_study import (
    WITH,
    WITHOUT,
    LoopRow,
    in_words,
    judge,
    machine,
    run_once,
    without_cuts,
)
from tissue_sim.runner import empty_folder
from tissue_sim.scene_file import config_folder

PROCEDURE = "many_cuts.yaml"


def run_study(out: Path, repeats: int, scene: str = "heart") -> dict[str, Any]:
    """Run the pairs and write what was counted.

    Args:
        out: Folder to write; `cut_loop.json` is the result.
        repeats: Number of pairs.
        scene: Scene to operate on.
    """
    print(f"{2 * repeats} runs in ROS domain {choose_domain()}")
    procedures = {WITH: config_folder() / "procedures" / PROCEDURE}
    procedures[WITHOUT] = without_cuts(procedures[WITH], empty_folder(out) / "without_cuts.yaml")
    rows: list[LoopRow] = []
    for pair in range(repeats):
        for variant in (WITH, WITHOUT) if pair % 2 == 0 else (WITHOUT, WITH):
            rows.append(run_once(out / "run", scene, procedures[variant], pair, variant))
            print(in_words(rows[-1]), flush=True)
    result = {"machine": machine(), "rows": [asdict(row) for row in rows], **judged(rows)}
    (out / "cut_loop.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def judged(rows: list[LoopRow]) -> dict[str, Any]:
    """What `loop_study` says of the pairs, late shares of both variants, and times of the cuts."""
    applied = np.array([ms for row in rows for ms in row.apply_ms])
    planned = np.array([ms for row in rows for ms in row.plan_ms])
    shares = {
        variant: statistics.median(row.late_share for row in rows if row.variant == variant)
        for variant in (WITH, WITHOUT)
    }
    return {
        **judge(rows),
        "late_share_with": shares[WITH],
        "late_share_without": shares[WITHOUT],
        "cuts": len(applied),
        "apply_ms": _spread(applied),
        "plan_ms": _spread(planned),
    }


def _spread(values: np.ndarray) -> dict[str, float]:
    return {
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "most": float(values.max()),
    }


def as_markdown(result: dict[str, Any]) -> str:
    """The runs as a table, with the medians in its last line."""
    lines = ["| pair | | late | an empty loop before | cuts | in the loop, median (most) [ms] |"]
    lines.append("|---" * 6 + "|")
    for row in result["rows"]:
        cuts = row["apply_ms"]
        times = f"{statistics.median(cuts):.2f} ({max(cuts):.2f})" if cuts else ""
        lines.append(
            f"| {row['pair'] + 1} | {row['variant']} | {row['late']} of {row['frames']} "
            f"({row['late_share']:.2%}) | {row['machine_late_share']:.2%} | {len(cuts) or ''} "
            f"| {times} |"
        )
    applied = result["apply_ms"]
    lines.append(
        f"| **medians** | | {result['late_share_with']:.2%} with, "
        f"{result['late_share_without']:.2%} without | {result['machine_late_share_median']:.2%} "
        f"| {result['cuts']} in all | {applied['median']:.2f} ({applied['most']:.2f}) |"
    )
    return "\n".join(lines)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--scene", default="heart")
    parser.add_argument("--out", type=Path, default=Path("out/cut_loop"))
    chosen = parser.parse_args()
    print(as_markdown(run_study(chosen.out, chosen.repeats, chosen.scene)))


if __name__ == "__main__":
    main()
