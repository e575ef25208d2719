"""The simulation frame by frame."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from support.small_block import CORNER, block_mesh, block_simulation, pose_of, tool_at
from support.split_edit import split_at
from tissue_sim.elastic import registry
from tissue_sim.frame import Answer, Budget, Command, FrameInputs, ToolSample
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

NOTHING = FrameInputs()
ONE = Budget(steps=1)
GRAB = Command("grab", {"tool": "grasper", "radius": 0.02})


def command(simulation: Simulation, kind: str, /, **arguments: Any) -> Answer:
    frame = simulation.advance(FrameInputs((Command(kind, arguments, "r"),)), ONE)
    return frame.answers[0]


def pull(simulation: Simulation, *way: float, steps: int = 5) -> None:
    sample = ToolSample("grasper", pose_of(np.add(CORNER, way)), 1)
    simulation.advance(FrameInputs(tools=(sample,)), Budget(steps=steps))


@pytest.mark.parametrize("model", registry.names())
def test_an_untouched_organ_stays_where_it_is(model: str) -> None:
    simulation = block_simulation(model=model)
    rest = simulation.mesh.rest[: simulation.mesh.node_rows].astype(np.float32)
    for _ in range(5):
        frame = simulation.advance(NOTHING, Budget(steps=3))
    np.testing.assert_array_equal(frame.positions, rest)
    assert not frame.lost


def test_frames_count_up_and_time_passes_by_the_rate() -> None:
    simulation = block_simulation(rate_hz=50.0)
    frames = [simulation.advance(NOTHING, ONE).journal for _ in range(3)]
    assert [entry.frame for entry in frames] == [1, 2, 3]
    assert [entry.sim_time for entry in frames] == pytest.approx([0.02, 0.04, 0.06])
    assert [entry.steps for entry in frames] == [1, 1, 1]


def test_only_the_first_frame_of_an_epoch_carries_its_start() -> None:
    simulation = block_simulation()
    first = simulation.advance(FrameInputs((GRAB,)), ONE).journal.inputs.commands
    assert [c.kind for c in first] == ["start", "grab"]
    assert Scene.from_arguments(first[0].arguments) == simulation.scene
    assert simulation.advance(NOTHING, ONE).journal.inputs.commands == ()


def test_dynamic_models_make_exactly_the_steps_of_a_frame() -> None:
    simulation = block_simulation(model="spring_mass")
    time_step = simulation.model.time_step
    assert time_step is not None
    steps = sum(simulation.advance(NOTHING, Budget(seconds=1e-9)).journal.steps for _ in range(30))
    assert steps == round(30 / (60 * time_step))
    assert simulation.sim_time == pytest.approx(0.5)


def test_time_steps_that_do_not_divide_a_frame_are_caught_up() -> None:
    simulation = block_simulation(model="spring_mass", rate_hz=59.0)
    time_step = simulation.model.time_step
    assert time_step is not None
    steps = [simulation.advance(NOTHING, Budget()).journal.steps for _ in range(118)]
    assert sum(steps) == pytest.approx(2.0 / time_step, abs=1)
    assert max(steps) - min(steps) <= 1


def test_a_budget_of_no_time_is_one_step() -> None:
    frame = block_simulation().advance(NOTHING, Budget(seconds=0.0))
    assert frame.journal.steps == len(frame.step_seconds) == 1


def test_while_paused_nothing_moves_and_no_time_passes() -> None:
    simulation = block_simulation(model="quasi_static")
    simulation.advance(FrameInputs((GRAB,)), ONE)
    pull(simulation, 0, 0.01, 0)
    before, time = simulation.state.displacement.copy(), simulation.sim_time
    assert command(simulation, "pause", on=True).success
    pull(simulation, 0, 0.02, 0)
    np.testing.assert_array_equal(simulation.state.displacement, before)
    assert simulation.sim_time == time
    assert simulation.advance(NOTHING, ONE).wrenches == {}
    command(simulation, "pause", on=False)
    assert simulation.sim_time > time


def test_grabbing_answers_with_the_hold() -> None:
    simulation = block_simulation()
    answer = command(simulation, "grab", tool="grasper", radius=0.0)
    assert answer.success
    assert answer.values["nodes"] == len(simulation.holds.rows) > 0
    again = command(simulation, "grab", tool="grasper", radius=0.02)
    assert again.values == {"hold_id": 2, "nodes": 0, "taken": answer.values["nodes"]}


@pytest.mark.parametrize(
    ("kind", "arguments", "error", "said"),
    [
        ("grab", {"tool": "nobody"}, "UNKNOWN_TOOL", "known tools: grasper"),
        ("grab", {"tool": "grasper", "radius": -1.0}, "OUT_OF_RANGE", "allowed: up to"),
        ("grab", {"tool": "grasper", "radius": float("nan")}, "OUT_OF_RANGE", "allowed: up to"),
        ("grab", {"tool": "grasper", "radius": 1e-5}, "NOTHING_THERE", "no free node"),
        ("release", {"hold_id": 7}, "UNKNOWN_HOLD", "holds: none"),
        ("release", {"tool": "nobody"}, "UNKNOWN_HOLD", "nobody"),
        ("set_model", {"model": "jelly"}, "UNKNOWN_MODEL", "spring_mass"),
        ("set_model", {"model": "lr", "parameters": {"levels": 0}}, "OUT_OF_RANGE", "levels"),
        ("set_model", {"model": "lr", "parameters": {"x": 1}}, "OUT_OF_RANGE", "'x'"),
        ("set_tool", {"id": "a", "kind": "saw"}, "OUT_OF_RANGE", "grab, cut"),
        ("remove_tool", {"tool": "nobody"}, "UNKNOWN_TOOL", "known tools: grasper"),
        ("dance", {}, "INVALID", "allowed: grab"),
    ],
)
def test_a_wrong_command_changes_nothing_and_says_what_is_wrong(
    kind: str, arguments: dict[str, Any], error: str, said: str
) -> None:
    simulation = block_simulation(tool_at((0.061, 0.061, 0.061)))
    answer = command(simulation, kind, **arguments)
    assert (answer.success, answer.error) == (False, error)
    assert said in answer.message
    assert list(simulation.tools) == ["grasper"]
    assert len(simulation.holds) == 0


def test_tools_come_and_go_with_what_they_hold() -> None:
    simulation = block_simulation()
    new = tool_at(CORNER, "forceps")
    frame = simulation.advance(FrameInputs((Command("set_tool", new.as_arguments()),)), ONE)
    assert frame.tools_changed
    assert command(simulation, "grab", tool="forceps", radius=0.02).success
    assert command(simulation, "remove_tool", tool="forceps").success
    assert list(simulation.tools) == ["grasper"]
    assert len(simulation.holds.rows) == 0


def test_another_model_takes_over_where_the_tissue_is() -> None:
    simulation = block_simulation(model="quasi_static")
    simulation.advance(FrameInputs((GRAB,)), ONE)
    pull(simulation, 0, 0.01, 0)
    before = simulation.state.displacement.copy()
    held = simulation.holds.rows
    inputs = FrameInputs((Command("set_model", {"model": "spring_mass", "parameters": {}}),))
    frame = simulation.advance(inputs, Budget(steps=0))
    assert frame.answers[0].success
    assert simulation.model.name == "spring_mass"
    np.testing.assert_array_equal(simulation.state.displacement, before)
    np.testing.assert_array_equal(simulation.state.previous, before)
    np.testing.assert_array_equal(simulation.holds.rows, held)


def test_a_split_moves_nothing_in_its_frame_when_the_organ_is_at_rest() -> None:
    simulation = block_simulation(model="quasi_static")
    frame = simulation.advance(FrameInputs(edits=(split_at(simulation.mesh, 0.03),)), ONE)
    change = frame.edits[0].change
    assert frame.answers[0].values["applied"].change.edit.version == 2
    assert frame.journal.version == 2
    np.testing.assert_array_equal(
        frame.positions[change.copied_nodes], frame.positions[change.copy_parents]
    )


def test_an_edit_planned_on_what_has_changed_is_stale() -> None:
    simulation = block_simulation()
    plan = split_at(simulation.mesh, 0.03)
    frame = simulation.advance(FrameInputs(edits=(plan, plan)), ONE)
    assert [answer.error for answer in frame.answers] == ["NONE", "STALE"]
    assert len(frame.edits) == len(frame.journal.inputs.edits) == 1
    assert simulation.mesh.version == 2


def wrong_edits() -> list[tuple[str, TopologyEdit]]:
    mesh = block_mesh(3)
    plan = split_at(mesh, 0.03)
    node = np.array([26], dtype=np.uint32)
    moved = replace(
        plan,
        moved_nodes=node,
        moved_rest=mesh.rest[node] + 1e-4,
        moved_anchors=np.array([[26, 25, 23, 17]], dtype=np.uint32),
        moved_weights=np.array([[1.0, 0.0, 0.0, 0.0]]),
    )
    return [
        ("not finite", replace(moved, moved_weights=np.array([[np.nan, 0, 0, 1]]))),
        ("not finite", replace(moved, moved_rest=np.array([[np.inf, 0, 0]]))),
        ("add up to 1", replace(moved, moved_weights=np.array([[1.0, 1, 0, 0]]))),
        ("far outside", replace(moved, moved_weights=np.array([[1e6, 1 - 1e6, 0, 0]]))),
        ("no positive rest volume", replace(moved, moved_rest=np.array([[-5.0, -5, -5]]))),
        ("not there", replace(plan, removed_elements=np.array([10**6], dtype=np.uint32))),
    ]


@pytest.mark.parametrize(("said", "edit"), wrong_edits())
def test_a_wrong_edit_is_refused_and_changes_nothing(said: str, edit: TopologyEdit) -> None:
    simulation = block_simulation(nodes=3)
    rest = simulation.mesh.rest.copy()
    frame = simulation.advance(FrameInputs(edits=(edit,)), ONE)
    assert frame.answers[0].error == "INVALID"
    assert said in frame.answers[0].message
    assert simulation.mesh.version == 1
    np.testing.assert_array_equal(simulation.mesh.rest, rest)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e6])
def test_a_lost_state_is_restored_reported_and_the_session_goes_on(wrong: float) -> None:
    simulation = block_simulation(model="quasi_static")
    simulation.advance(FrameInputs((GRAB,)), ONE)
    pull(simulation, 0, 0.005, 0)
    good = simulation.state.displacement.copy()
    step = simulation.model.step

    def explode(state: Any) -> None:
        step(state)
        state.displacement[40] = wrong

    simulation.model.step = explode  # type: ignore[method-assign]
    frame = simulation.advance(NOTHING, ONE)
    assert "restored" in frame.lost
    assert frame.wrenches == {}
    np.testing.assert_array_equal(simulation.state.displacement, good)
    assert np.isfinite(frame.positions).all()
    simulation.model.step = step  # type: ignore[method-assign]
    frame = simulation.advance(NOTHING, ONE)
    assert not frame.lost
    assert simulation.lost_states == 1


def test_a_cutting_tool_used_makes_a_sweep() -> None:
    knife = tool_at(CORNER, "knife", kind="cut", shape="rectangle", size=(0.05, 0.02))
    simulation = block_simulation(knife)
    pose = pose_of([0.03, 0.03, 0.06])
    press = ToolSample("knife", pose, 5, True, 1)
    frame = simulation.advance(FrameInputs(tools=(press,)), ONE)
    (cut,) = frame.cuts
    np.testing.assert_allclose(cut.vertices.mean(axis=0), pose[:3])
    assert (cut.tool, cut.stamp) == ("knife", 5)
    assert simulation.advance(FrameInputs(tools=(replace(press, edge=0),)), ONE).cuts == ()


def test_positions_of_the_last_frame_stay_valid_for_one_more() -> None:
    simulation = block_simulation(model="quasi_static")
    simulation.advance(FrameInputs((GRAB,)), ONE)
    frame = simulation.advance(NOTHING, ONE)
    kept = frame.positions.copy()
    pull(simulation, 0, 0.01, 0)
    np.testing.assert_array_equal(frame.positions, kept)


@pytest.mark.parametrize("rate", [0.0, float("nan"), 1e6])
def test_a_wrong_rate_is_refused(rate: float) -> None:
    with pytest.raises(ValueError, match="1 to 1000"):
        block_simulation(rate_hz=rate)
