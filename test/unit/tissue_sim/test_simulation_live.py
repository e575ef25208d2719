"""Requests at any time, work beside the loop, and new epochs between frames."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.small_block import CORNER, block_mesh, block_simulation, pose_of, tool_at
from support.split_edit import split_at
from tissue_sim import snapshot
from tissue_sim.frame import Answer, Frame, JournalEntry
from tissue_sim.interaction.tracker import ToolLimits
from tissue_sim.journal import epochs_of, replay
from tissue_sim.live import LiveSimulation
from tissue_sim.requests import PlannedEdit, Request

PATIENCE = 60.0


@dataclass
class Operation:
    """A live simulation, and the loop around it."""

    live: LiveSimulation
    now: float = 0.0
    journal: list[JournalEntry] = field(default_factory=list)

    def frame(self) -> Frame:
        self.now += 1 / 60
        frame, answer = self.live.next_frame(self.now)
        self.journal.append(frame.journal)
        answer()
        return frame

    def ask(self, kind: str, /, **arguments: Any) -> list[Answer]:
        answers: list[Answer] = []
        self.live.post(Request(kind, arguments, "r", answers.append))
        return answers

    def ask_edit(self, edit: Any, epoch: bytes) -> list[Answer]:
        return self.ask("edit", planned=PlannedEdit(edit, epoch))

    def until(self, done: Callable[[], Any]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not done():
            assert time.monotonic() < deadline
            self.frame()
            time.sleep(0.001)

    def answer_to(self, kind: str, /, **arguments: Any) -> Answer:
        answers = self.ask(kind, **arguments)
        self.until(lambda: answers)
        return answers[0]


@pytest.fixture
def operation(tmp_path: Path) -> Operation:
    simulation = block_simulation(tool_at(CORNER), model="quasi_static")
    return Operation(LiveSimulation(simulation, ToolLimits(), tmp_path, steps_per_frame=3))


def poke(operation: Operation, way: float) -> None:
    pose = pose_of(np.add(CORNER, [0, way, 0]))
    operation.live.post_pose("grasper", pose, 1, operation.now)


def test_a_request_is_answered_in_the_next_frame(operation: Operation) -> None:
    answers = operation.ask("grab", tool="grasper", radius=0.02)
    assert not answers
    operation.frame()
    assert answers[0].success
    assert answers[0].values["nodes"] > 0


def test_poses_of_unknown_tools_are_nothing(operation: Operation) -> None:
    operation.live.post_pose("nobody", pose_of([0, 0, 0]), 1, 0.0)
    operation.live.post_use("nobody", True)
    assert not operation.frame().lost


def test_a_source_that_vanishes_lets_go_of_holds_made_by_service(operation: Operation) -> None:
    poke(operation, 0.0)
    assert operation.answer_to("grab", tool="grasper", radius=0.02).success
    assert len(operation.live.simulation.holds) == 1
    operation.now += 3.0
    frame = operation.frame()
    assert [command.kind for command in frame.journal.inputs.commands] == ["release"]
    assert len(operation.live.simulation.holds) == 0


def test_an_edit_of_another_epoch_is_stale(operation: Operation) -> None:
    simulation = operation.live.simulation
    plan = split_at(simulation.mesh, 0.03)
    (old,) = (operation.ask_edit(plan, b"x" * 16),)
    operation.frame()
    assert old[0].error == "STALE"
    assert b"x".hex() * 16 in old[0].message
    assert simulation.mesh.version == 1
    new = operation.ask_edit(plan, simulation.epoch)
    operation.frame()
    assert new[0].success


def test_a_new_model_is_built_beside_the_loop(operation: Operation) -> None:
    poke(operation, 0.0)
    operation.answer_to("grab", tool="grasper", radius=0.02)
    answers = operation.ask("set_model", model="spring_mass", parameters={"damping": 0.1})
    busy = operation.ask("set_model", model="lr", parameters={})
    operation.frame()
    assert busy[0].error == "BUSY"
    operation.until(lambda: answers)
    assert answers[0].success
    assert operation.live.simulation.model.name == "spring_mass"
    assert operation.live.simulation.model_parameters == {"damping": 0.1}


def test_edits_wait_while_a_model_is_built_and_lose_nothing(operation: Operation) -> None:
    simulation = operation.live.simulation
    build = simulation.build_model
    started: list[int] = []

    def slowly(name: str, parameters: Any) -> Any:
        started.append(simulation.mesh.version)
        time.sleep(0.1)
        assert simulation.mesh.version == started[0]
        return build(name, parameters)

    simulation.build_model = slowly  # type: ignore[method-assign]
    model = operation.ask("set_model", model="lr", parameters={})
    operation.frame()
    edit = operation.ask_edit(split_at(simulation.mesh, 0.03), simulation.epoch)
    operation.frame()
    assert not edit
    operation.until(lambda: edit)
    assert model[0].success
    assert edit[0].success


@pytest.mark.parametrize(
    ("kind", "arguments", "error"),
    [
        ("set_model", {"model": "jelly", "parameters": {}}, "UNKNOWN_MODEL"),
        ("set_model", {"model": "lr", "parameters": {"levels": -1.0}}, "OUT_OF_RANGE"),
        ("set_model", {"model": "spring_mass", "parameters": {"time_step": 0.016}}, "OUT_OF_RANGE"),
        ("save", {"name": "../x"}, "BAD_NAME"),
        ("load", {"name": "/etc/passwd"}, "BAD_NAME"),
        ("load", {"name": "nothing"}, "FAILED"),
    ],
)
def test_a_request_that_cannot_be_met_says_why(
    operation: Operation, kind: str, arguments: dict[str, Any], error: str
) -> None:
    answer = operation.answer_to(kind, **arguments)
    assert (answer.success, answer.error) == (False, error)
    assert answer.message
    assert operation.answer_to("grab", tool="grasper", radius=0.02).success


def test_save_and_load_bring_the_organ_back_in_a_new_epoch(operation: Operation) -> None:
    live = operation.live
    poke(operation, 0.0)
    operation.answer_to("grab", tool="grasper", radius=0.02)
    for number in range(10):
        poke(operation, 0.001 * number)
        operation.frame()
    answer = operation.ask_edit(
        split_at(live.simulation.mesh, 0.03, top=0.05), live.simulation.epoch
    )
    operation.frame()
    assert answer[0].success
    saved = operation.ask("save", name="opened")
    epoch, shape = live.simulation.epoch, live.simulation.state.positions(live.simulation.mesh)
    operation.until(lambda: saved)
    assert saved[0].success
    loaded = operation.answer_to("load", name="opened")
    assert loaded.success
    assert live.simulation.epoch != epoch
    assert live.switched == 1
    assert live.simulation.mesh.version == 1
    assert live.simulation.frame == 1
    assert len(live.simulation.holds) == 0
    assert len(live.simulation.mesh.rest[: live.simulation.mesh.node_rows]) == len(shape)
    assert list(live.simulation.tools) == ["grasper"]
    start = live.simulation.scene.displacement
    assert start is not None
    now = live.simulation.mesh.rest[: len(start)] + start
    np.testing.assert_allclose(now, shape, atol=1e-7)


def test_reset_goes_back_to_the_start_with_the_model_and_tools_of_now(operation: Operation) -> None:
    live = operation.live
    operation.ask_edit(split_at(live.simulation.mesh, 0.03), live.simulation.epoch)
    operation.answer_to("set_model", model="relaxation", parameters={})
    operation.answer_to("set_tool", **tool_at((0, 0, 0), "forceps").as_arguments())
    nodes = block_mesh().node_rows
    assert live.simulation.mesh.node_rows > nodes
    assert operation.answer_to("reset").success
    assert live.simulation.mesh.node_rows == nodes
    assert live.simulation.model.name == "relaxation"
    assert list(live.trackers) == ["grasper", "forceps"]
    assert operation.answer_to("reset").success
    assert live.switched == 2


def test_while_an_organ_is_loaded_all_else_is_busy_and_frames_go_on(operation: Operation) -> None:
    live = operation.live
    reset = operation.ask("reset")
    operation.frame()
    if not reset:
        assert live.loading
        busy = operation.ask("grab", tool="grasper", radius=0.02)
        edit = operation.ask_edit(split_at(block_mesh(), 0.03), live.simulation.epoch)
        switched = live.switched
        operation.frame()
        if live.switched == switched:
            assert busy[0].error == edit[0].error == "BUSY"
    operation.until(lambda: reset)


def test_every_epoch_of_a_session_is_repeated(operation: Operation, tmp_path: Path) -> None:
    live = operation.live
    first = block_mesh()
    for number in range(12):
        poke(operation, 0.0005 * number)
        if number == 2:
            operation.ask("grab", tool="grasper", radius=0.02)
        if number == 6:
            operation.ask_edit(
                split_at(live.simulation.mesh, 0.03, top=0.05), live.simulation.epoch
            )
        operation.frame()
    assert operation.answer_to("save", name="organ").success
    assert operation.answer_to("load", name="organ").success
    for number in range(10):
        poke(operation, 0.0005 * number)
        if number == 2:
            operation.ask("grab", tool="grasper", radius=0.03)
        operation.frame()
    epochs = list(epochs_of(operation.journal).values())
    assert len(epochs) == 2
    for entries, mesh in zip(epochs, (first, snapshot.load(tmp_path, "organ").mesh()), strict=True):
        result = replay(entries, mesh)
        assert result.mismatches == ()
        assert result.frames == len(entries)


def test_what_is_prepared_of_an_epoch_is_there_when_it_begins(tmp_path: Path) -> None:
    operation = Operation(
        LiveSimulation(
            block_simulation(), ToolLimits(), tmp_path, prepare=lambda simulation: simulation.epoch
        )
    )
    assert operation.live.prepared == operation.live.simulation.epoch
    operation.answer_to("reset")
    assert operation.live.prepared == operation.live.simulation.epoch


def test_a_failure_beside_the_loop_is_answered(
    operation: Operation, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any) -> None:
        raise RuntimeError("no more memory")

    monkeypatch.setattr(snapshot, "save", broken)
    answer = operation.answer_to("save", name="organ")
    assert (answer.error, answer.message) == ("FAILED", "RuntimeError: no more memory")
