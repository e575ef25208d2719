"""A session on the wall that several processes play and record: a grasper lifts its free side."""

from __future__ import annotations

import signal
from pathlib import Path

from support.bags import wait_for
from support.processes import PLAY_SECONDS, Processes

STEPS = 2
COLUMNS, ROWS = 9, 13
PROCEDURE = """
title: lift
units: mm
tools:
  grasper: {kind: grab, start: {position: [32, 100, 2]}}
timeline:
  - {at: 0.2, press: grasper}
  - {at: 0.3, move: grasper, by: [0, 4, 8], for: 0.8}
  - {at: 1.4, release: grasper}
end: 1.5
"""


def record(world: Processes, repository: Path) -> Path:
    """The bag of a session on the wall in which the procedure is played."""
    (world.folder / "lift.yaml").write_text(PROCEDURE)
    world.start(
        "bag", "viz_bridge.bag_node", "--ros-args", "-p", "bag:=session",
        "-p", "record_state_hz:=60.0", "-p", "min_free_gb:=0.0",
    )  # fmt: skip
    world.start(
        "script", "tool_input.script_node", "--ros-args", "-p", "procedure:=lift.yaml",
        "-p", "clock:=simulation", "-p", "listeners:=2",
    )  # fmt: skip
    world.start(
        "simulation", "tissue_sim.simulation_node", "--ros-args",
        "--params-file", str(repository / "config" / "wall.yaml"),
        "-p", f"shape.columns:={COLUMNS}.0", "-p", f"shape.rows:={ROWS}.0",
        "-p", "model:=quasi_static", "-p", f"steps_per_frame:={STEPS}",
        "-p", "wait_for:=['tissue/journal:2','tissue/state:1','script/event:1']",
        "-p", f"wait_timeout:={PLAY_SECONDS}",
    )  # fmt: skip
    wait_for(lambda: not world.runs("script"), PLAY_SECONDS, "the end of the procedure")
    for name in ("script", "simulation", "bag"):
        assert world.end(name, signal.SIGINT) == 0
    return world.folder / "session"
