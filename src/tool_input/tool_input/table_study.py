"""How fast the operating table is: frames a second, their size, and from the mouse to the picture.

A session as `tissue run` starts it, a browser that opens its page, and a hand that pulls: first
back and forth without a rest, then in single moves. Everything on one machine; without a graphics
card the browser draws on the processor, so the figures of its drawing say little about another. How
much of them is drawing is seen by leaving it out. Run it with `python3 -m tool_input.table_study`.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.models.table import into_page
from tissue_sim.free_domain import choose_domain
from tissue_sim.launcher import Launcher
from tissue_sim.loop_study import machine
from tissue_sim.runner import empty_folder, page_addresses
from tissue_sim.scene_file import find_scene
from tissue_sim.session import SessionPlan, end_session, start_session
from tissue_sim.whole_files import write_json, write_text
from tool_input.browser.chromium import ARGUMENTS, chromium
from tool_input.browser.hand import Hand
from tool_input.browser.window import Window
from tool_input.table_latency import PARTS, ToolNotes, photons, quantiles

SCENES = ("wall", "heart")
SIZE = (960, 540)
"""Of the window [pixels]."""
GRIP = {"wall": (0.5, 0.8, 1.0), "heart": (0.62, 0.09, 0.66)}
"""Where the hand takes hold, as shares of the organ's extent: tissue that faces the eye and that
nothing is fixed near to. At an edge of what is seen a drag may take what is behind."""
PATIENCE = 600.0
"""Longest wait for the simulation and the page [s]: kernels may have to be compiled."""
PERSON = "hand"
BEGIN = "<!-- results: docs/results/table.json -->"
"""Mark on the page of the documentation after which the tables are."""


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        size: Width and height of the window [pixels].
        seconds: How long frames are counted, with and without drawing.
        moves: Single moves of the mouse.
        rest: For how long the tissue is left alone after each [s].
        patience: How long a move may take to be seen [s].
    """

    size: tuple[int, int] = SIZE
    seconds: float = 8.0
    moves: int = 12
    rest: float = 2.0
    patience: float = 60.0


def run_study(out: Path, scenes: tuple[str, ...], effort: Effort) -> dict[str, Any]:
    """Measure every scene.

    Args:
        out: Folder for the sessions.
        scenes: Names of scenes.
        effort: How much is measured.
    """
    print(f"ROS domain {choose_domain()}")
    rows = []
    with chromium() as browser:
        for scene in scenes:
            rows.append(measure(browser, out / scene, scene, effort))
            print(as_markdown({"rows": rows[-1:]}), flush=True)
        version = browser.version
    return {
        "machine": machine(),
        "browser": f"chromium {version} {' '.join(ARGUMENTS[1:])}",
        "seconds": effort.seconds,
        "rows": rows,
    }


def measure(browser: Any, out: Path, scene: str, effort: Effort) -> dict[str, Any]:
    """One scene, in a session of its own; see `run_study`."""
    plan = SessionPlan(
        find_scene(scene), empty_folder(out), recording=False, page=True, monitor=False,
        readings=True,
    )  # fmt: skip
    load = os.getloadavg()[0]
    with Launcher(plan.out / "logs") as launcher:
        start_session(launcher, plan)
        window = Window(browser, effort.size)
        address = page_addresses(launcher, plan)[0].replace("/?", f"/as/{PERSON}?")
        window.open(address)
        window.wait_drawn(PATIENCE)
        hand = Hand(window, GRIP[scene])
        drawn = hand.count(effort.seconds)
        hand.blindfold(True)
        blind = hand.count(effort.seconds)
        hand.blindfold(False)
        single = hand.single_moves(effort.moves, effort.rest, effort.patience)
        triangles = sum(len(part.faces) for part in window.organ())
        window.close()
        end_session(launcher)
    tool, simulated_hz = recorded(plan.bag_folder)
    found = photons(single.made, single.page, tool, single.least)
    return {
        "scene": scene,
        "load_before": round(load, 1),
        "window": list(effort.size),
        "triangles": triangles,
        "simulated_hz": simulated_hz,
        "drawn": drawn,
        "without_drawing": blind,
        "moves": len(single.made),
        "seen": len(found),
        "latency_ms": quantiles(found),
    }


def recorded(bag: Path) -> tuple[ToolNotes, float]:
    """What a bag says of the hand's tool, and how many frames a second were simulated."""
    # Here, because viz_bridge comes after this package.
    from viz_bridge.bag_reader import read_bag, topic_counts

    pose_topic = next(
        topic for topic in topic_counts(bag)
        if PERSON in topic and topic.endswith("/servo_cp")
    )  # fmt: skip
    poses: list[tuple[float, NDArray[np.float64]]] = []
    frames: list[tuple[float, float]] = []
    published = []
    for item in read_bag(bag, (pose_topic, "/tissue/journal")):
        message = item.message
        if item.topic == pose_topic:
            place = message.pose.position
            poses.append((_seconds(message.header.stamp), np.array([place.x, place.y, place.z])))
            continue
        published.append(item.publish_time / 1e9)
        frames += [
            (_seconds(sample.stamp), published[-1])
            for sample in message.tools
            if f"/{sample.id}/" in pose_topic
        ]
    return ToolNotes(poses, frames), round(len(published) / (published[-1] - published[0]), 1)


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + float(stamp.nanosec) / 1e9


def as_markdown(result: dict[str, Any]) -> str:
    """The result as two tables."""
    lines = [
        "| scene | load before | window | triangles | KB a frame | simulated a second | received "
        "| drawn | without drawing: received | got through |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in result["rows"]:
        drawn, blind = row["drawn"], row["without_drawing"]
        width, height = row["window"]
        lines.append(
            f"| {row['scene']} | {row['load_before']} | {width} x {height} | {row['triangles']:,} "
            f"| {drawn['kb_per_frame']:.0f} | {row['simulated_hz']:.0f} "
            f"| {drawn['received_hz']:.1f} | {drawn['drawn_hz']:.1f} "
            f"| {blind['received_hz']:.1f} | {blind['drawn_hz']:.1f} |"
        )
    lines += ["", "| ms, median (95 %) | " + " | ".join(r["scene"] for r in result["rows"]) + " |"]
    lines.append("|---|" + "---|" * len(result["rows"]))
    names: dict[str, str] = {"whole": "**from the mouse to changed pixels**", **PARTS}
    for name, words in names.items():
        cells = [row["latency_ms"][name] for row in result["rows"]]
        told = " | ".join(f"{cell['p50']:.0f} ({cell['p95']:.0f})" for cell in cells)
        lines.append(f"| {words} | {told} |")
    seen = [f"{row['seen']} of {row['moves']}" for row in result["rows"]]
    lines.append("| moves seen | " + " | ".join(seen) + " |")
    return "\n".join(lines)


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    usual = Effort()
    parser.add_argument(
        "--size", nargs=2, type=int, default=list(usual.size), metavar=("WIDTH", "HEIGHT"),
        help="of the window [pixels]: software draws a small one sooner",
    )  # fmt: skip
    parser.add_argument("--seconds", type=float, default=usual.seconds, help="to count frames")
    parser.add_argument("--moves", type=int, default=usual.moves, help="single moves of the mouse")
    parser.add_argument("--rest", type=float, default=usual.rest, help="after each [s]")
    parser.add_argument(
        "--patience", type=float, default=usual.patience, help="for a move to be seen [s]"
    )
    parser.add_argument("--sessions", type=Path, default=Path("out/table"), help="their folder")
    parser.add_argument("--out", type=Path, help="file of the result")
    parser.add_argument("--page", type=Path, help="page whose tables are replaced")
    given = parser.parse_args()
    width, height = given.size
    effort = Effort((width, height), given.seconds, given.moves, given.rest, given.patience)
    result = run_study(given.sessions, tuple(given.scenes), effort)
    if given.out is not None:
        write_json(given.out, result)
    if given.page is not None:
        text = into_page(given.page.read_text(encoding="utf-8"), as_markdown(result), BEGIN)
        write_text(given.page, text)
    print(as_markdown(result))


if __name__ == "__main__":
    main()
