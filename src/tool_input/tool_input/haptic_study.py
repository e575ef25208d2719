"""How fast and how stable forces on a hand are; see docs/haptics.md.

python3 -m tool_input.haptic_study --out docs/results/haptics.json
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from tissue_sim.bench import machine
from tissue_sim.free_domain import choose_domain
from tissue_sim.scene_file import find_scene
from tissue_sim.whole_files import write_json
from tool_input.haptics.bounce import RENDERINGS, Wall, restitution
from tool_input.haptics.live_session import measure
from tool_input.haptics.model_cost import model_costs

TOWARDS = {"wall": (0.0, 0.0, -1.0), "heart": (-1.0, 0.0, 0.0)}
"""How each organ is pressed: the wall from above, the heart from the front."""
RUNS = ((500.0, 0), (1000.0, 0), (1000.0, 20))
"""Rates of the haptic node [Hz] and its real-time priorities."""
ARM_HZ = 500.0
"""Poses per second of the arm."""
STIFFNESS = (100.0, 300.0, 1000.0, 2000.0)
DAMPING = (0.0, 2.0, 10.0)
DELAY = (0.002, 0.01, 0.03)


def stability() -> list[dict[str, Any]]:
    """Bounces of a mass off walls: speed after over speed before, by rendering."""
    return [
        {
            "stiffness": stiffness, "damping": damping, "delay": delay,
            **{r: round(restitution(Wall(stiffness, damping, delay), r), 4) for r in RENDERINGS},
        }
        for stiffness in STIFFNESS
        for damping in DAMPING
        for delay in DELAY
    ]  # fmt: skip


def costs(scenes: list[str]) -> list[dict[str, Any]]:
    """What a contact model costs the simulation of each scene."""
    return [
        {"scene": scene, **row}
        for scene in scenes
        for row in model_costs(find_scene(scene), np.array(TOWARDS[scene]))
    ]


def live(scenes: list[str], seconds: float) -> list[dict[str, Any]]:
    """The real node beside the simulation of each scene."""
    rows = []
    for scene in scenes:
        for rate_hz, priority in RUNS:
            towards = np.array(TOWARDS[scene])
            found = measure(find_scene(scene), towards, rate_hz, ARM_HZ, priority, seconds)
            rows.append({"scene": scene, **found})
            latency = found["pose_to_force_ms"]
            print(
                f"{scene} at {rate_hz:g} Hz, priority {priority}: "
                f"{found['forces_per_second']:.0f} forces/s, pose to force "
                f"{latency['p50']:.2f} ms (99 %: {latency['p99']:.2f})",
            )
    return rows


def live_table(result: dict[str, Any]) -> str:
    """Rates and latencies of the real node."""
    lines = [
        "| scene | asked | priority | load | forces/s | between, p99 | pose to force, p50 | p99 "
        "| frames/s | least energy |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in result["live"]:
        between, latency = row["between_forces_ms"], row["pose_to_force_ms"]
        lines.append(
            f"| {row['scene']} | {row['rate_hz']:g} Hz | {row['realtime_priority'] or 'none'} "
            f"| {row['load_average']:.0f} | {row['forces_per_second']:.0f} "
            f"| {between['p99']:.1f} ms | {latency['p50']:.1f} ms | {latency['p99']:.1f} ms "
            f"| {float(row['tissue_sim: loop']['achieved_rate_hz']):.1f} "
            f"| {1e3 * float(row['haptic: force']['energy_lowest_J']):.2f} mJ |"
        )
    return "\n".join(lines)


def cost_table(result: dict[str, Any]) -> str:
    """What a contact model costs the simulation."""
    lines = ["| scene | contact | nodes | a model |", "|---|---|---|---|"]
    lines += [
        f"| {row['scene']} | {row['kind']} | {row['nodes']} | {row['model_us']:.0f} µs |"
        for row in result["models"]
    ]
    return "\n".join(lines)


def stability_table(result: dict[str, Any]) -> str:
    """Bounces off walls without damping."""
    lines = [
        "| stiffness | delay | " + " | ".join(RENDERINGS) + " |",
        "|---|---|---|---|---|",
    ]
    for row in result["stability"]:
        if row["damping"] == 0.0:
            speeds = " | ".join(f"{row[rendering]:.2f}" for rendering in RENDERINGS)
            lines.append(f"| {row['stiffness']:g} N/m | {1e3 * row['delay']:g} ms | {speeds} |")
    return "\n".join(lines)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="how fast and how stable haptic forces are")
    parser.add_argument("--scene", choices=list(TOWARDS), action="append")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each live session")
    parser.add_argument("--no-live", action="store_true", help="only the stability map")
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    rows = []
    if not chosen.no_live:
        print(f"ROS domain {choose_domain()}")
        rows = live(chosen.scene or list(TOWARDS), chosen.seconds)
    result = {
        "machine": machine(),
        "live": rows,
        "models": costs(chosen.scene or list(TOWARDS)),
        "stability": stability(),
    }
    if chosen.out is not None:
        chosen.out.parent.mkdir(parents=True, exist_ok=True)
        write_json(chosen.out, result)
    for table in (live_table, cost_table, stability_table):
        print(table(result))


if __name__ == "__main__":
    main()
