"""A session that several processes played and recorded is an interaction to compare under."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.bags import wait_for
from support.processes import PLAY_SECONDS, Processes, processes
from tissue_sim.compare.comparison import compare
from tissue_sim.compare.effort import Effort
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.sources.choose import interaction_from
from tissue_sim.compare.subject import Subject

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


@pytest.fixture
def world(ros_domain: int, tmp_path: Path) -> Iterator[Processes]:
    with processes(tmp_path) as made:
        yield made


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


def test_a_recorded_session_is_what_its_own_model_does(world: Processes, repository: Path) -> None:
    """Its model with its steps leaves nothing over where every frame is recorded; others do."""
    bag = record(world, repository)
    organ = load_organ("wall", parameters={"columns": COLUMNS, "rows": ROWS})
    found = interaction_from(str(bag), organ, rate_hz=60.0)
    assert found.notes == ()
    held = found.interaction.held.any(axis=1)
    assert held.sum() / 60 == pytest.approx(1.2, abs=0.1)
    assert found.interaction.amplitude == pytest.approx(8.94e-3, rel=1e-2)
    own = Subject("quasi_static", effort=Effort(steps=STEPS))
    other = Subject("quasi_static", effort=Effort(steps=1), label="half as fast")
    result = compare(organ, found.interaction, found.reference(), [own, other])
    assert result.targets[0].difference.largest < 1e-7
    assert result.targets[1].relative > 0.01
