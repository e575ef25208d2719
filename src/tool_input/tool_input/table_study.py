"""How fast the operating table is: frames a second, their size, and from the mouse to the picture.

A session as `tissue run` starts it, a browser that opens its page, and a hand that pulls: first
back and forth without a rest, then in single moves. Everything on one machine; without a graphics
card the browser draws on the processor, so the figures of its drawing say little about another. How
much of them is drawing is seen by leaving it out. Run it with `python3 -m tool_input.table_study`.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.free_domain import choose_domain
from tissue_sim.launcher import Launcher
from tissue_sim.loop_study import machine
from tissue_sim.runner import empty_folder, page_addresses
from tissue_sim.scene_file import find_scene
from tissue_sim.session import SessionPlan, end_session, start_session
from tissue_sim.whole_files import write_json
from tool_input.browser.chromium import ARGUMENTS, chromium
from tool_input.browser.window import Window
from tool_input.table_latency import PARTS, PageNotes, ToolNotes, photons, quantiles

SCENES = ("wall", "heart")
SIZE = (960, 540)
"""Of the window [pixels]."""
GRIP = {"wall": (0.5, 0.8, 1.0), "heart": (0.3, 0.2, 0.6)}
"""Where the hand takes hold, as shares of the organ's extent: nothing is fixed there."""
WAY = np.array([24.0, -18.0])
"""How far it pulls [pixels]: 30 to the upper right."""
MARGIN = 60
"""Half the width of the region about the grip whose pixels are compared."""
FEWEST = 40
"""Pixels that must have changed for a frame to count as another picture."""
LEAST = 0.25
"""Share of the way that the tissue must have gone to count as moved."""
MOUSE_MS = 16.0
"""Between two moves of the hand that pulls back and forth."""
SETTLE_MS = 4000.0
"""After which tissue that was let go of is at rest, about."""
PATIENCE = 600.0
"""Longest wait for the simulation and the page [s]: kernels may have to be compiled."""
PERSON = "hand"


def run_study(
    out: Path, scenes: tuple[str, ...], seconds: float, moves: int, rest: float
) -> dict[str, Any]:
    """Measure every scene and write what was found.

    Args:
        out: Folder to write; `table.json` is the result.
        scenes: Names of scenes.
        seconds: How long frames are counted, with and without drawing.
        moves: Single moves of the mouse.
        rest: Between two of them [s]; longer than a picture takes.
    """
    print(f"ROS domain {choose_domain()}")
    rows = []
    with chromium() as browser:
        for scene in scenes:
            rows.append(measure(browser, out / scene, scene, seconds, moves, rest))
            print(as_markdown({"rows": rows[-1:]}), flush=True)
        version = browser.version
    result = {
        "machine": machine(),
        "browser": f"chromium {version} {' '.join(ARGUMENTS[1:])}",
        "window": list(SIZE),
        "seconds": seconds,
        "rows": rows,
    }
    write_json(out / "table.json", result)
    return result


def measure(
    browser: Any, out: Path, scene: str, seconds: float, moves: int, rest: float
) -> dict[str, Any]:
    """One scene: a session of its own."""
    plan = SessionPlan(
        find_scene(scene), empty_folder(out), recording=False, page=True, monitor=False,
        readings=True,
    )  # fmt: skip
    load = os.getloadavg()[0]
    with Launcher(plan.out / "logs") as launcher:
        start_session(launcher, plan)
        window = Window(browser, SIZE)
        address = page_addresses(launcher, plan)[0].replace("/?", f"/as/{PERSON}?")
        window.open(address)
        window.wait_drawn(PATIENCE)
        hand = Hand(window, GRIP[scene])
        drawn = hand.count(seconds)
        hand.blindfold(True)
        blind = hand.count(seconds)
        hand.blindfold(False)
        least, moved, page = hand.single_moves(moves, rest)
        triangles = sum(len(part.faces) for part in window.organ())
        window.close()
        end_session(launcher)
    tool, frames = recorded(plan.bag_folder)
    found = photons(moved, page, tool, least)
    return {
        "scene": scene,
        "load_before": round(load, 1),
        "triangles": triangles,
        "kb_per_frame": drawn["kb_per_frame"],
        "simulated_hz": frames,
        "drawn": drawn,
        "without_drawing": blind,
        "moves": len(moved),
        "seen": len(found),
        "latency_ms": quantiles(found),
    }


class Hand:
    """A hand with a mouse on one window."""

    def __init__(self, window: Window, grip: tuple[float, ...]) -> None:
        """Go to where it takes hold.

        Args:
            window: The window.
            grip: Where, as shares of the organ's extent.
        """
        self._window = window
        # What is done for the first time takes longer, in the page and in the simulation.
        start = window.tissue_at(grip)
        window.drag(start, start + WAY)
        window.page.wait_for_timeout(SETTLE_MS)
        self._start = window.tissue_at(grip)
        camera = window.camera
        # The vertex in sight there, whichever mesh shows it.
        depth, self._name, self._row = min(
            (float((part.vertices[row] - camera.position) @ camera.axes[:, 2]), part.name, int(row))
            for part in window.organ()
            for row in np.flatnonzero(
                np.linalg.norm(camera.pixels(part.vertices) - self._start, axis=1) < 0.5
            )
        )
        self._way = float(np.linalg.norm(WAY)) * depth / camera.focal

    def blindfold(self, blind: bool) -> None:
        """Leave drawing out, or draw again."""
        self._window.page.evaluate("(blind) => { watch.blind = blind; }", blind)

    def count(self, seconds: float) -> dict[str, float]:
        """Pull back and forth for some seconds; what comes and is drawn a second, and KB of one."""
        page = self._window.page
        self._window.press(self._start)
        self._forget()
        before = page.evaluate("() => performance.now()")
        end = before + seconds * 1e3
        while (now := page.evaluate("() => performance.now()")) < end:
            for share in (0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0):
                self._window.move(self._start + share * WAY)
                page.wait_for_timeout(MOUSE_MS)
        notes = page.evaluate("() => ({batches: watch.batches, frames: watch.frames})")
        self._window.release()
        took = (now - before) / 1e3
        bytes_each = [size for _, size, _ in notes["batches"] if size]
        return {
            "received_hz": round(len(bytes_each) / took, 1),
            "frames_hz": round(len(notes["frames"]) / took, 1),
            "kb_per_frame": round(float(np.median(bytes_each or [0])) / 1e3, 1),
        }

    def single_moves(self, count: int, rest: float) -> tuple[float, list[float], PageNotes]:
        """Move back and forth with a rest after each.

        Returns:
            How far the tissue must have gone to have moved in the page's units, when the mouse was
            moved in seconds since 1970, and what the page noted.
        """
        page = self._window.page
        x, y = np.round(self._start).astype(int)
        page.evaluate(
            "([mesh, row, region]) => { watch.follow = {mesh, vertices: [row]};"
            " watch.region = region; }",
            [
                self._name, self._row,
                [int(x) - MARGIN, int(y) - MARGIN, 2 * MARGIN, 2 * MARGIN],
            ],
        )  # fmt: skip
        self._window.press(self._start)
        # The first move of a drag only begins it.
        self._window.pull(self._start, self._start + WAY, 2)
        self._window.move(self._start)
        page.wait_for_timeout(2e3 * rest)
        self._forget()
        for move in range(count):
            self._window.move(self._start + (WAY if move % 2 == 0 else 0.0))
            page.wait_for_timeout(1e3 * rest)
        notes = page.evaluate(
            "() => ({origin: performance.timeOrigin, moves: watch.pointer, sent: watch.sent,"
            " batches: watch.batches, frames: watch.frames})"
        )
        self._window.release()
        moved = [(notes["origin"] + at) / 1e3 for at in notes["moves"]]
        return LEAST * self._way, moved, PageNotes.read(notes, FEWEST)

    def _forget(self) -> None:
        self._window.page.evaluate(
            "() => { for (const list of ['pointer', 'sent', 'batches', 'frames'])"
            " watch[list].length = 0; }"
        )


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
        "| scene | triangles | KB a frame | simulated a second | received | drawn "
        "| without drawing: received |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['scene']} | {row['triangles']:,} | {row['kb_per_frame']:.0f} "
        f"| {row['simulated_hz']:.0f} | {row['drawn']['received_hz']:.1f} "
        f"| {row['drawn']['frames_hz']:.1f} | {row['without_drawing']['received_hz']:.1f} |"
        for row in result["rows"]
    ]
    lines += ["", "| | " + " | ".join(row["scene"] for row in result["rows"]) + " |"]
    lines.append("|---|" + "---|" * len(result["rows"]))
    names: dict[str, str] = {"whole": "**from the mouse to changed pixels**", **PARTS}
    for name, words in names.items():
        cells = [row["latency_ms"][name] for row in result["rows"]]
        told = " | ".join(f"{cell['p50']:.0f} ({cell['p95']:.0f})" for cell in cells)
        lines.append(f"| {words} | {told} |")
    return "\n".join(lines)


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--moves", type=int, default=12)
    parser.add_argument("--rest", type=float, default=4.0)
    parser.add_argument("--out", type=Path, default=Path("out/table"))
    given = parser.parse_args()
    run_study(given.out, tuple(given.scenes), given.seconds, given.moves, given.rest)


if __name__ == "__main__":
    main()
