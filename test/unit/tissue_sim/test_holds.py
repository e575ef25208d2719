"""Holds: who has a node, and where it is put."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from support.small_block import CORNER, block_mesh, block_simulation, pose_of, tool_at
from support.split_edit import split_at
from tissue_sim.frame import Budget, Command, FrameInputs, ToolSample
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction import rigid
from tissue_sim.interaction.holds import Holds

ONE = Budget(steps=1)


def rows(*numbers: int) -> np.ndarray:
    return np.array(numbers, dtype=np.int32)


def places(mesh: Mesh, held: np.ndarray) -> np.ndarray:
    return mesh.rest[held].copy()


def test_a_node_belongs_to_the_first_hold_that_took_it() -> None:
    mesh = block_mesh(3)
    holds = Holds(mesh)
    first = holds.grab(rows(20, 21), places(mesh, rows(20, 21)), "a", pose_of([0, 0, 0]), False)
    wanted = rows(21, 22)
    second = holds.grab(wanted, places(mesh, wanted), "b", pose_of([0, 0, 0]), False)
    assert first.rows.tolist() == [20, 21]
    assert second.rows.tolist() == [22]
    assert second.waiting.tolist() == [21]


def test_a_later_hold_takes_over_on_release_from_where_the_node_is() -> None:
    mesh = block_mesh(3)
    holds = Holds(mesh)
    poses = {"a": pose_of([0, 0, 0]), "b": pose_of([0, 0, 0])}
    first = holds.grab(rows(20), places(mesh, rows(20)), "a", poses["a"], False)
    holds.grab(rows(20), places(mesh, rows(20)), "b", poses["b"], False)
    displacement = np.zeros((mesh.node_capacity, 3), dtype=np.float32)
    poses["a"], poses["b"] = pose_of([0.01, 0, 0]), pose_of([0, 0.5, 0])
    holds.place(mesh, displacement, poses)
    np.testing.assert_allclose(displacement[20], [0.01, 0, 0], atol=1e-7)
    freed = holds.release(first, mesh.rest[first.rows] + displacement[first.rows], poses)
    assert len(freed) == 0
    holds.place(mesh, displacement, poses)
    np.testing.assert_allclose(displacement[20], [0.01, 0, 0], atol=1e-7)
    poses["b"] = pose_of([0, 0.5, 0.02])
    holds.place(mesh, displacement, poses)
    np.testing.assert_allclose(displacement[20], [0.01, 0, 0.02], atol=1e-7)


def test_of_several_that_wait_the_oldest_takes_over() -> None:
    mesh = block_mesh(3)
    holds = Holds(mesh)
    poses = {tool: pose_of([0, 0, 0]) for tool in "abc"}
    made = [holds.grab(rows(5), places(mesh, rows(5)), tool, poses[tool], False) for tool in "abc"]
    holds.release(made[0], places(mesh, made[0].rows), poses)
    assert holds.owner[5] == made[1].id
    assert made[2].waiting.tolist() == [5]


unit_quaternions = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)


@settings(max_examples=40, deadline=None)
@given(st.tuples(*[st.floats(-0.1, 0.1)] * 3), unit_quaternions, unit_quaternions)
def test_held_nodes_follow_the_rigid_motion_since_the_grab(
    move: tuple[float, float, float], before: np.ndarray, after: np.ndarray
) -> None:
    mesh = block_mesh(3)
    holds = Holds(mesh)
    held = rows(18, 19, 20, 26)
    start, end = pose_of([0.01, 0.02, 0.0], before), pose_of(move, after)
    holds.grab(held, places(mesh, held), "a", start, False)
    displacement = np.zeros((mesh.node_capacity, 3), dtype=np.float64)
    holds.place(mesh, displacement, {"a": end})
    motion = rigid.compose(end, rigid.inverse(start))
    np.testing.assert_allclose(
        mesh.rest[held] + displacement[held], rigid.to_world(motion, mesh.rest[held]), atol=1e-12
    )


def test_fixed_nodes_are_never_held() -> None:
    simulation = block_simulation(tool_at((0.0, 0.0, 0.0), size=(0.04,)))
    hold = simulation.grab("grasper", 0.04, by_use=False)
    assert hold is not None
    assert not simulation.mesh.fixed[hold.rows].any()


def pressed(pose: np.ndarray, edge: int) -> ToolSample:
    return ToolSample("grasper", pose, 1, edge > 0, 1 if edge > 0 else -1 if edge < 0 else 0)


def test_pressing_use_holds_and_releasing_it_lets_go() -> None:
    simulation = block_simulation()
    pose = pose_of(CORNER)
    simulation.advance(FrameInputs(tools=(pressed(pose, 1),)), ONE)
    held = simulation.holds.rows
    assert len(held) > 3
    assert simulation.state.prescribed[held].all()
    moved = pose_of(np.add(CORNER, [0, 0.01, 0]))
    frame = simulation.advance(FrameInputs(tools=(pressed(moved, 0),)), ONE)
    expected = simulation.mesh.rest[held] + [0, 0.01, 0]
    np.testing.assert_allclose(frame.positions[held], expected, atol=1e-7)
    simulation.advance(FrameInputs(tools=(pressed(moved, -1),)), ONE)
    assert len(simulation.holds) == 0
    assert np.array_equal(simulation.state.prescribed, simulation.mesh.fixed)


def test_pressing_in_the_air_holds_nothing_and_says_so() -> None:
    simulation = block_simulation()
    frame = simulation.advance(FrameInputs(tools=(pressed(pose_of([1, 1, 1]), 1),)), ONE)
    assert "no free node" in frame.events[0]
    assert len(simulation.holds) == 0


def test_both_lips_of_a_cut_between_the_jaws_stay_held() -> None:
    simulation = block_simulation(tool_at((0.03, 0.06, 0.03)))
    command = Command("grab", {"tool": "grasper", "radius": 0.02})
    simulation.advance(FrameInputs((command,)), ONE)
    (hold,) = simulation.holds.by_id.values()
    before = set(hold.rows.tolist())
    frame = simulation.advance(FrameInputs(edits=(split_at(simulation.mesh, 0.03),)), ONE)
    (applied,) = frame.edits
    parents, copies = applied.change.copy_parents, applied.change.copied_nodes
    of_held = np.isin(parents, list(before))
    assert of_held.any()
    assert not of_held.all()
    assert set(hold.rows.tolist()) == before | set(copies[of_held].tolist())
    assert len(hold.rows) == len(hold.local) == len(np.unique(hold.rows))
    assert (simulation.holds.owner[copies[of_held]] == hold.id).all()
    np.testing.assert_array_equal(frame.positions[copies], frame.positions[parents])
    # What is not between the jaws is free to open.
    assert not simulation.state.prescribed[copies[~of_held & ~simulation.mesh.fixed[parents]]].any()


def test_a_hold_whose_nodes_vanish_is_released_and_reported() -> None:
    simulation = block_simulation()
    simulation.advance(FrameInputs((Command("grab", {"tool": "grasper", "radius": 0.001}),)), ONE)
    mesh = simulation.mesh
    (held,) = simulation.holds.rows
    gone = mesh.element_ids[mesh.incident.of(int(held))]
    edit = split_at(mesh, -1.0)
    removal = type(edit)(base_version=mesh.version, removed_elements=gone.astype(np.uint32))
    frame = simulation.advance(FrameInputs(edits=(removal,)), ONE)
    assert frame.answers[0].success
    assert "vanished" in frame.events[0]
    assert len(simulation.holds) == 0
