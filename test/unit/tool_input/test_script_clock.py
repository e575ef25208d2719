"""The organ's time as a procedure's clock: frames, pauses of others and of the procedure's own."""

from __future__ import annotations

import numpy as np
import pytest
from tissue_interfaces.msg import Journal

from tool_input.motion import Pose
from tool_input.player import Player
from tool_input.procedure import Event, parse_procedure
from tool_input.script_clock import SimulationClock

FRAME = 0.02
PROCEDURE = """
units: mm
tools: {}
timeline:
  - {at: 0.1, pause: true}
  - {at: 2.1, pause: false}
  - {at: 2.2, label: over}
"""


class Organ:
    """A simulation whose frames and whose wall time go on as the test says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.wall, self.sim_time, self.paused = 1000.0, 5.0, False
        monkeypatch.setattr("tool_input.script_clock.time.monotonic", lambda: self.wall)
        self.clock = SimulationClock()
        self.frame()
        self.clock.start()

    def frame(self, seconds: float = FRAME, epoch: int = 1) -> None:
        """A frame that takes some wall time [s]."""
        self.wall += seconds
        self.sim_time += 0.0 if self.paused else FRAME
        self.clock.hear(Journal(epoch=np.full(16, epoch, dtype=np.uint8), sim_time=self.sim_time))


@pytest.fixture
def organ(monkeypatch: pytest.MonkeyPatch) -> Organ:
    return Organ(monkeypatch)


def test_a_slow_simulation_slows_the_clock(organ: Organ) -> None:
    for _ in range(10):
        organ.frame(0.5)
    assert organ.clock.now() == pytest.approx(10 * FRAME)
    organ.wall += 0.01
    assert organ.clock.now() == pytest.approx(10 * FRAME + 0.01)


def test_a_pause_of_somebody_else_stops_the_clock(organ: Organ) -> None:
    organ.frame()
    organ.paused = True
    for _ in range(100):
        organ.frame()
    assert organ.clock.now() == pytest.approx(FRAME)


def test_a_reset_does_not_turn_the_clock_back(organ: Organ) -> None:
    organ.frame()
    organ.sim_time = 0.0
    organ.frame(epoch=2)
    organ.frame(epoch=2)
    assert organ.clock.now() == pytest.approx(2 * FRAME)


class Stage:
    """Where the procedure is played: it pauses the organ a few frames after it was asked."""

    LATE = 3

    def __init__(self, organ: Organ) -> None:
        self._organ = organ
        self._asked: list[tuple[int, bool]] = []
        self.done: list[tuple[str, float]] = []

    def pose(self, tool: str, pose: Pose) -> None:
        """It has no tools."""

    def use(self, tool: str, pressed: bool) -> None:
        """It has no tools."""

    def act(self, event: Event) -> None:
        self.done.append((str(event), self._organ.wall))
        if event.action == "pause":
            self._organ.clock.pause(bool(event.value))
            self._asked.append((self.LATE, bool(event.value)))

    def frame(self) -> None:
        self._asked = [(left - 1, paused) for left, paused in self._asked]
        for left, paused in self._asked:
            if left == 0:
                self._organ.paused = paused
        self._organ.frame()


def test_a_pause_of_its_own_is_as_long_as_the_procedure_says(organ: Organ) -> None:
    """In real seconds, whenever the simulation follows; and after it the organ's count again."""
    stage = Stage(organ)
    player = Player(parse_procedure(PROCEDURE), stage)
    for _ in range(1000):
        if player.over:
            break
        stage.frame()
        player.advance(organ.clock.now())
    (pause, began), (goes_on, ended), (label, over) = stage.done
    assert (pause, goes_on, label) == ("pause", "continue", "label over")
    assert ended - began == pytest.approx(2.0, abs=2 * FRAME)
    # The simulation goes on some frames late, and 0.1 s of its time are left to play.
    assert over - ended == pytest.approx(0.1 + (Stage.LATE - 1) * FRAME, abs=2 * FRAME)


def test_a_procedure_that_leaves_the_organ_paused_comes_to_its_end(organ: Organ) -> None:
    text = PROCEDURE.replace("  - {at: 2.1, pause: false}\n", "")
    stage = Stage(organ)
    player = Player(parse_procedure(text), stage)
    for _ in range(1000):
        stage.frame()
        player.advance(organ.clock.now())
    assert player.over
    assert organ.paused
