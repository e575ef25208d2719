"""Messages carry the core's types exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from tissue_interfaces.msg import Journal, TissueState, Topology, TopologyEdit

from support.small_block import CORNER, block_mesh, block_simulation, pose_of
from support.split_edit import split_at
from tissue_sim import conversions, edit_messages, journal_messages
from tissue_sim.frame import Budget, Command, FrameInputs, ToolSample
from tissue_sim.geometry.edit import TopologyEdit as PlannedEdit
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh

EPOCH = bytes(range(16))
STAMP = conversions.stamp_of(12_000_000_034)


def through_cdr(message: object) -> object:
    return deserialize_message(serialize_message(message), type(message))


def keyframe(mesh: Mesh) -> Topology:
    message = through_cdr(conversions.mesh_to_topology(mesh, EPOCH, "organ", STAMP))
    assert isinstance(message, Topology)
    return message


def assert_same(one: Mesh, other: Mesh) -> None:
    assert one.version == other.version
    nodes, elements = one.node_rows, one.element_rows
    assert (nodes, elements) == (other.node_rows, other.element_rows)
    for name in ("rest", "fixed", "node_alive", "node_parents", "node_file_ids"):
        np.testing.assert_array_equal(getattr(one, name)[:nodes], getattr(other, name)[:nodes])
    for name in ("tets", "element_alive", "regions", "element_file_ids"):
        np.testing.assert_array_equal(
            getattr(one, name)[:elements], getattr(other, name)[:elements]
        )


def test_a_keyframe_is_the_mesh_and_follows_later_edits() -> None:
    mesh = block_mesh()
    mesh.apply(split_at(mesh, 0.03, top=0.05))
    removal = two_removed(mesh)
    mesh.apply(removal)
    replica = conversions.topology_to_mesh(keyframe(mesh))
    assert_same(mesh, replica)
    change = mesh.apply(split_at(mesh, 0.015))
    message = through_cdr(edit_messages.edit_to_msg(change.edit, EPOCH, "organ", STAMP))
    assert isinstance(message, TopologyEdit)
    replica.apply(edit_messages.edit_from_msg(message))
    assert_same(mesh, replica)


def test_a_keyframe_taken_after_an_undo_follows_a_redo() -> None:
    mesh, history = block_mesh(), EditHistory()
    for edit in (split_at(mesh, 0.03, top=0.05), two_removed(mesh)):
        history.record(mesh.apply(replace(edit, base_version=mesh.version)))
    for _ in range(2):
        history.record(mesh.apply(history.undo(mesh)))
    replica = conversions.topology_to_mesh(keyframe(mesh))
    for step in (history.redo, history.redo, history.undo):
        change = mesh.apply(step(mesh))
        history.record(change)
        message = through_cdr(edit_messages.edit_to_msg(change.edit, EPOCH, "organ", STAMP))
        again = edit_messages.edit_from_msg(message)
        assert (again.kind, again.reverts) == (change.edit.kind, change.edit.reverts)
        replica.apply(again)
        assert_same(mesh, replica)


def two_removed(mesh: Mesh) -> PlannedEdit:
    plan = split_at(mesh, -1.0)
    return type(plan)(
        base_version=mesh.version, removed_elements=mesh.element_ids[3:5].astype(np.uint32)
    )


def test_a_keyframe_shows_the_surface_with_normals_outward() -> None:
    mesh = block_mesh()
    message = keyframe(mesh)
    triangles = np.frombuffer(message.surface_triangles, dtype=np.uint32).reshape(-1, 3)
    corners = mesh.rest[mesh.node_rows_of(triangles)]
    # Divergence theorem: the volume from the surface alone.
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert volume == pytest.approx(0.06**3)
    assert conversions.epoch_of(message) == EPOCH
    assert conversions.nanoseconds_of(message.header.stamp) == 12_000_000_034


def test_a_journal_entry_comes_back_as_it_was() -> None:
    simulation = block_simulation()
    commands = (Command("grab", {"tool": "grasper", "radius": 0.1 + 0.2}, "id"),)
    sample = ToolSample("grasper", pose_of(np.add(CORNER, 0.1)), 3_000_000_001, True, -1)
    plan = split_at(simulation.mesh, 0.03)
    entry = simulation.advance(FrameInputs(commands, (plan,), (sample,)), Budget(steps=2)).journal
    edits = [edit_messages.edit_to_msg(e, entry.epoch, "organ", STAMP) for e in entry.inputs.edits]
    message = through_cdr(journal_messages.entry_to_msg(entry, edits, "organ", STAMP))
    assert isinstance(message, Journal)
    again = journal_messages.entry_from_msg(message)
    assert again.inputs.commands == entry.inputs.commands
    assert (again.epoch, again.frame, again.steps) == (entry.epoch, entry.frame, entry.steps)
    assert (again.crc32, again.sim_time) == (entry.crc32, entry.sim_time)
    (tool,) = again.inputs.tools
    np.testing.assert_array_equal(tool.pose, sample.pose)
    assert (tool.tool, tool.stamp, tool.use, tool.edge) == ("grasper", 3_000_000_001, True, -1)
    (edit,) = again.inputs.edits
    np.testing.assert_array_equal(edit.rewritten_nodes, entry.inputs.edits[0].rewritten_nodes)
    assert edit.version == 2


def test_positions_cross_exactly_and_without_a_loop() -> None:
    positions = np.random.default_rng(0).normal(size=(1000, 3)).astype(np.float32)
    message = TissueState()
    conversions.fill_state(message, positions)
    again = through_cdr(message)
    assert isinstance(again, TissueState)
    np.testing.assert_array_equal(conversions.positions_from_state(again), positions)


@pytest.mark.parametrize(
    ("field", "values", "said"),
    [
        ("moved_rest", [0.0, 1.0], "multiple of 3"),
        ("copied_nodes", [1, 2], "copy_parents has 0 items, copied_nodes 2"),
        ("rewritten_nodes", [1, 2, 3, 4], "rewritten_nodes has 1 items"),
    ],
)
def test_lists_of_different_lengths_are_refused(field: str, values: list, said: str) -> None:
    message = TopologyEdit()
    getattr(message, field).extend(values)
    with pytest.raises(ValueError, match=said):
        edit_messages.edit_from_msg(message)
