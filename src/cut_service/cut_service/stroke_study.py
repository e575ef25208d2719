"""What a stroke costs, strip by strip: `python3 -m cut_service.stroke_study`.

One process, so that times of the processor can be counted: they hardly depend on what else the
machine does.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cut_service.one_process import Operation, knife, line
from cut_service.warm_up import warm_up
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.scene_geometry import load
from tissue_sim.geometry.shapes import block

VENTRICLE = ([0.0254, -0.0037, -0.0279], [0.0303, -0.0044, -0.0024])
"""From below to above a place on the front of the heart's right ventricle [m]."""

UPRIGHT = (0.7702, -0.0564, 0.6336, 0.0470)
"""The blade goes from inside the chamber out to the air."""

ACROSS = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
CELL = 0.002
"""Edge of the blocks' cells [m]."""

FRAMES = 180
LATENCY = 2
"""Frames from the plan to its edit."""


def on_heart() -> tuple[Mesh, Any, list[NDArray[np.float64]]]:
    """The heart, a blade, and its way of 26 mm in three seconds."""
    mesh = load("heart", fixed="auto").mesh
    return mesh, knife((0.004, 0.025)), line(*VENTRICLE, FRAMES, UPRIGHT)


def on_block(nodes: int) -> tuple[Mesh, Any, list[NDArray[np.float64]]]:
    """A block with so many nodes along each edge, cut 10 mm deep along 26 mm from its side."""
    size = CELL * (nodes - 1)
    raw = block(nodes, nodes, nodes, size, size, size)
    mesh = Mesh(raw, raw.points[:, 2] < 1e-9)
    x, z = 0.5 * size + 0.0003, size - 0.0101 + 0.01
    return mesh, knife((0.004, 0.02)), line([x, -0.004, z], [x, 0.022, z], FRAMES, ACROSS)


def measure(mesh: Mesh, blade: Any, poses: list[NDArray[np.float64]]) -> dict[str, Any]:
    """Figures of one stroke, and of the same motion of a blade that is not pressed."""
    nodes, elements = mesh.node_rows, mesh.element_rows
    cutting = Operation(mesh, blade, LATENCY)
    cutting.go(poses)
    # Half of the frames and more have no edit.
    quiet = float(np.median(cutting.frame_seconds))
    still = Operation(cutting.first, blade, LATENCY)
    for pose in poses:
        still.frame(pose, use=False)
    return {
        "organ": mesh.name,
        "nodes": nodes,
        "elements": elements,
        "strips": len(cutting.cuts),
        "plans": len(cutting.plans) + len(cutting.empty_seconds),
        "parted_nothing": len(cutting.empty_seconds),
        "faces": sum(made.report.faces_split for made in cutting.plans),
        "plan_ms": _spread(cutting.plan_seconds),
        "empty_plan_ms": _spread(cutting.empty_seconds),
        "edit_ms": _spread([s - quiet for s in cutting.edit_frame_seconds]),
        "frame_ms": _spread(cutting.frame_seconds),
        "frame_ms_not_pressed": _spread(still.frame_seconds),
    }


def _spread(seconds: list[float]) -> dict[str, float]:
    values = 1e3 * np.array(seconds)
    return {
        "median": round(float(np.median(values)), 3),
        "p95": round(float(np.percentile(values, 95)), 3),
        "most": round(float(values.max()), 3),
    }


def as_markdown(rows: list[dict[str, Any]]) -> str:
    """The figures as a table: medians, and 95th percentiles in brackets."""
    columns = (
        ("plan_ms", "planning a strip [ms]"),
        ("edit_ms", "what its edit adds to a frame [ms]"),
        ("frame_ms", "a frame while cutting [ms]"),
        ("frame_ms_not_pressed", "a frame, not pressed [ms]"),
    )
    lines = [
        "| | elements | strips, plans (parted nothing) | faces | "
        + " | ".join(words for _, words in columns)
        + " |",
        "|---|---|---|---|" + "---|" * len(columns),
    ]
    for row in rows:
        figures = [f"{row[name]['median']:.3g} ({row[name]['p95']:.3g})" for name, _ in columns]
        counts = f"{row['strips']}, {row['plans']} ({row['parted_nothing']})"
        cells = [row["organ"], str(row["elements"]), counts, str(row["faces"]), *figures]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def run(out: Path | None) -> list[dict[str, Any]]:
    """Measure all, and write it to a file."""
    warm_up()
    measure(*on_block(12))  # Compiles what is left.
    rows = [measure(*on_heart()), measure(*on_block(22)), measure(*on_block(46))]
    if out is not None:
        out.write_text(json.dumps({"rows": rows}, indent=1) + "\n", encoding="utf-8")
    return rows


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    print(as_markdown(run(parser.parse_args().out)))


if __name__ == "__main__":
    main()
