"""A patch carried by a tool: held from the frame it appears in, let go of, undone, replayed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.patches import patch_edit
from support.sewn_blocks import two_blocks
from tissue_sim.frame import Budget, Command, Frame, FrameInputs, ToolSample
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.operation_report import operation_report
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

PLACE = (0.0, 0.0, 0.02)
FORCEPS = ToolSpec("forceps", size=(0.004,), pose=(0.006, 0.004, 0.03, 0, 0, 0, 1)).checked()


def scene(model: str = "quasi_static") -> Scene:
    return Scene(model=model, tools=(FORCEPS,))


class Session:
    """A simulation whose tool is moved; keeps the journal."""

    def __init__(self, model: str = "quasi_static") -> None:
        self.simulation = Simulation(two_blocks()[0], scene(model))
        self.frames: list[Frame] = []
        self.pose = np.array(FORCEPS.pose)

    def frame(
        self, *commands: Command, edits: tuple[TopologyEdit, ...] = (), edge: int = 0
    ) -> Frame:
        sample = ToolSample("forceps", self.pose.copy(), use=edge > 0, edge=edge)  # type: ignore[arg-type]
        frame = self.simulation.advance(FrameInputs(commands, edits, (sample,)), Budget(steps=3))
        self.frames.append(replace(frame, positions=frame.positions.copy()))
        return self.frames[-1]

    def add(self, tool: str = "forceps") -> Frame:
        edit = patch_edit(self.simulation.mesh, PLACE, request_id="patch")
        return self.frame(edits=(replace(edit, held_by=tool),))

    @property
    def rows(self) -> np.ndarray:
        mesh = self.simulation.mesh
        own = mesh.regions[: mesh.element_rows] == next(iter(mesh.patches)).label
        return np.unique(mesh.tets[: mesh.element_rows][own])

    def places(self) -> np.ndarray:
        return np.asarray(self.frames[-1].positions[self.rows], dtype=np.float64)


def turned(pose: np.ndarray) -> np.ndarray:
    """A centimetre further, a quarter of a turn about z."""
    half = np.sqrt(0.5)
    return np.array([*(pose[:3] + np.array([0.01, 0.0, 0.005])), 0.0, 0.0, half, half])


def test_it_follows_the_tool_rigidly_from_the_frame_it_appears_in() -> None:
    session = Session()
    added = session.add()
    hold_id = added.answers[0].values["hold_id"]
    hold = session.simulation.holds.by_id[hold_id]
    assert hold.tool == "forceps"
    assert np.array_equal(np.sort(hold.rows), session.rows)
    before = session.places()
    session.pose = turned(session.pose)
    session.frame()
    offset = before - np.array(FORCEPS.pose[:3])
    quarter = np.stack([-offset[:, 1], offset[:, 0], offset[:, 2]], axis=1)
    np.testing.assert_allclose(session.places(), session.pose[:3] + quarter, atol=1e-7)


@pytest.mark.parametrize("how", ["service", "use"])
def test_it_is_let_go_of_as_anything_that_is_held(how: str) -> None:
    session = Session()
    session.add()
    session.pose = turned(session.pose)
    if how == "service":
        session.frame(Command("release", {"tool": "forceps"}))
    else:
        session.frame(edge=-1)
    assert not len(session.simulation.holds)
    session.frame()
    there = session.places()
    session.pose = np.array(FORCEPS.pose)
    session.frame()
    # It stays where it was left, and not at the tool.
    assert np.abs(session.places() - there).max() < 0.001


def test_undo_takes_the_hold_away_and_redo_brings_the_patch_back_free() -> None:
    session = Session()
    session.add()
    session.frame(Command("undo", {}))
    assert not len(session.simulation.holds)
    assert any("vanished" in event for event in session.frames[-1].events)
    session.frame(Command("redo", {}))
    assert len(session.simulation.mesh.patches) == 1
    assert not len(session.simulation.holds)


@pytest.mark.parametrize("model", ["quasi_static", "vertex_block_descent"])
def test_a_session_with_a_carried_patch_replays_bit_for_bit(model: str) -> None:
    first: Mesh = two_blocks()[0]
    session = Session(model)
    session.frame()
    session.add()
    for _ in range(4):
        session.pose = session.pose + np.array([0.002, 0.0, -0.001, 0, 0, 0, 0])
        session.frame()
    session.frame(Command("undo", {}))
    session.frame(Command("redo", {}))
    session.frame()
    again = operation_report([frame.journal for frame in session.frames], first)
    assert again.mismatches == ()
    assert np.array_equal(again.positions, session.frames[-1].positions)
    assert [str(patch) for patch in again.patches] == [
        "patch 1: 40 nodes, 1.08 cm2, carried by forceps"
    ]
    assert again.cuts == []


def test_an_unknown_tool_and_a_hold_of_nothing_are_refused() -> None:
    session = Session()
    before = session.simulation.mesh.version
    answer = session.add(tool="tweezers").answers[0]
    assert not answer.success
    assert "forceps" in answer.message
    nothing = TopologyEdit(before, held_by="forceps", request_id="nothing")
    assert not session.frame(edits=(nothing,)).answers[0].success
    assert session.simulation.mesh.version == before
    assert not len(session.simulation.holds)


def test_a_patch_tool_that_was_released_meanwhile_carries_nothing() -> None:
    session = Session()
    layer = ToolSpec("layer", "patch", "rectangle", (0.02, 0.01)).checked()
    session.frame(Command("set_tool", layer.as_arguments()))
    for pressed in (True, False):
        edit = replace(patch_edit(session.simulation.mesh, PLACE), held_by="layer")
        pose = np.array(layer.pose)
        sample = ToolSample("layer", pose, use=pressed, edge=1 if pressed else -1)
        session.simulation.advance(FrameInputs(tools=(sample,)), Budget(steps=1))
        frame = session.frame(edits=(edit,))
        assert frame.answers[0].success
        assert (frame.answers[0].values["hold_id"] > 0) == pressed
        assert any("released before" in event for event in frame.events) != pressed
