"""Sutures in edits: refused, undone, replayed, released, saved, followed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time

from support.sewn_blocks import sew_edit, tighten_edit, two_blocks
from support.split_edit import split_at
from tissue_sim import conversions, edit_messages, snapshot
from tissue_sim.frame import Answer, Budget, Command, Frame, FrameInputs, JournalEntry
from tissue_sim.geometry.edit import PROVISIONAL, EditError, StaleEditError, TopologyEdit
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sutures import Sutures, checked_sutures, is_surface_node, tensions
from tissue_sim.journal import replay
from tissue_sim.replica import Replica
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation


def equal(one: Sutures, other: Sutures) -> bool:
    return all(
        np.array_equal(getattr(one, item.name), getattr(other, item.name))
        for item in fields(Sutures)
    )


def ids(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.uint32)


def sewn() -> tuple[Mesh, EditHistory]:
    mesh, left, right = two_blocks()
    history = EditHistory()
    history.record(mesh.apply(sew_edit(mesh, left, right, 0.001)))
    return mesh, history


def test_stitches_get_ids_that_are_never_used_again() -> None:
    mesh, left, right = two_blocks()
    mesh.apply(sew_edit(mesh, left[:2], right[:2]))
    assert mesh.sutures.ids.tolist() == [1, 2]
    mesh.apply(TopologyEdit(mesh.version, kind="unsuture", removed_sutures=ids(1, 2)))
    assert len(mesh.sutures) == 0
    change = mesh.apply(sew_edit(mesh, left[:1], right[:1]))
    assert mesh.sutures.ids.tolist() == [3]
    assert change.edit.added_sutures.tolist() == [3]
    assert change.edit.suture_groups.tolist() == [3]
    assert change.nodes.tolist() == [left[0], right[0]]


def test_an_applied_edit_does_the_same_to_a_replica() -> None:
    mesh, left, right = two_blocks()
    other, _, _ = two_blocks()
    for plan in (sew_edit(mesh, left, right), tighten_edit(mesh, 0.0)):
        plan = replace(plan, base_version=mesh.version)
        if plan.kind == "tighten":
            plan = tighten_edit(mesh, 0.0002)
        other.apply(mesh.apply(plan).edit)
    assert equal(mesh.sutures, other.sutures)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"suture_nodes": [[0, 60_000]]}, "names a node that is not there"),
        ({"suture_nodes": [[7, 7]]}, "both ends of a suture would be at one node"),
        ({"suture_nodes": [[0, 60], [1, 61]]}, "suture_nodes has shape"),
        ({"suture_lengths": [np.nan]}, "rest length of a suture is not allowed; allowed: 0 to 10"),
        ({"suture_lengths": [-1e-3]}, "rest length of a suture is not allowed"),
        ({"suture_stiffness": [0.0]}, "stiffness of a suture is not allowed"),
        ({"suture_stiffness": [np.inf]}, "stiffness of a suture is not allowed"),
        ({"suture_groups": [0]}, "a suture's group is no suture's id"),
        ({"added_sutures": [PROVISIONAL + 1]}, "new suture ids must count up from"),
        ({"removed_sutures": [99]}, "names a removed suture that is not there"),
        ({"removed_sutures": [1, 1]}, "a suture is removed twice"),
        ({"changed_sutures": [1], "changed_lengths": [np.inf]}, "rest length of a suture"),
        ({"changed_sutures": [1]}, "changed_lengths has shape"),
        ({"changed_sutures": [55], "changed_lengths": [0.1]}, "names a changed suture"),
        (
            {"changed_sutures": [1], "changed_lengths": [0.1], "removed_sutures": [1]},
            "is removed and changed",
        ),
    ],
)
def test_bad_stitches_are_refused_and_nothing_changes(
    changed: dict[str, list[Any]], message: str
) -> None:
    mesh, _ = sewn()
    before, version = mesh.sutures, mesh.version
    plan = sew_edit(mesh, np.array([0]), np.array([60]))
    kinds = {
        item.name: getattr(plan, item.name).dtype
        for item in fields(plan)
        if "sutur" in item.name or item.name == "changed_lengths"
    }
    arrays: dict[str, Any] = {
        name: np.array(values, dtype=kinds[name]) for name, values in changed.items()
    }
    with pytest.raises(EditError, match=message):
        mesh.apply(replace(plan, **arrays))
    assert mesh.sutures is before
    assert mesh.version == version


def test_a_plan_is_stale_if_its_nodes_changed_and_only_then() -> None:
    mesh, left, right = two_blocks()
    plan = sew_edit(mesh, left[:1], right[:1])
    plan = replace(plan, read_nodes=ids(left[0], right[0]))
    mesh.apply(split_at(mesh, 0.003))
    assert mesh.check(plan).version == mesh.version
    one = mesh.incident.of(left[0])[:1].astype(np.uint32)
    mesh.apply(TopologyEdit(mesh.version, removed_elements=one))
    with pytest.raises(StaleEditError, match="that the plan has read"):
        mesh.apply(plan)


def test_undo_and_redo_bring_back_every_table_bit_for_bit() -> None:
    mesh, left, right = two_blocks()
    history, tables = EditHistory(), [mesh.sutures]
    makers: tuple[Callable[[], TopologyEdit], ...] = (
        lambda: sew_edit(mesh, left[:8], right[:8], 0.001),
        lambda: tighten_edit(mesh, 0.0003),
        lambda: TopologyEdit(mesh.version, kind="unsuture", removed_sutures=ids(2, 5)),
        lambda: sew_edit(mesh, left[8:], right[8:], 0.0005, 300.0),
        lambda: TopologyEdit(
            mesh.version, removed_elements=mesh.incident.of(int(left[3])).astype(np.uint32)
        ),
    )
    for make in makers:
        history.record(mesh.apply(make()))
        tables.append(mesh.sutures)
    assert len(tables[-1]) == len(tables[-2]) - 1
    for table in tables[-2::-1]:
        history.record(mesh.apply(history.undo(mesh)))
        assert equal(replace(mesh.sutures, next_id=table.next_id), table)
    for table in tables[1:]:
        history.record(mesh.apply(history.redo(mesh)))
        assert equal(replace(mesh.sutures, next_id=table.next_id), table)


def test_a_cut_through_a_sewn_lip_leaves_the_stitch_at_the_parent() -> None:
    mesh, history = sewn()
    node = int(mesh.sutures.nodes[5, 0])
    y = float(mesh.rest[node, 1])
    beyond = mesh.rest[mesh.tets[: mesh.element_rows]].mean(axis=1)[:, 1] > y
    touched = np.flatnonzero(beyond & (mesh.tets[: mesh.element_rows] == node).any(axis=1))
    new = mesh.tets[touched].astype(np.int64)
    new[new == node] = PROVISIONAL
    split = TopologyEdit(
        mesh.version, copied_nodes=ids(PROVISIONAL), copy_parents=ids(node),
        rewritten_elements=touched.astype(np.uint32), rewritten_nodes=new.astype(np.uint32),
    )  # fmt: skip
    before = mesh.sutures
    history.record(mesh.apply(split))
    assert equal(mesh.sutures, before)
    history.record(mesh.apply(history.undo(mesh)))
    assert equal(mesh.sutures, before)


def advance(simulation: Simulation, *edits: TopologyEdit, ask: str = "", steps: int = 12) -> Frame:
    commands = (Command(ask, {}, f"{ask}-{simulation.frame}"),) if ask else ()
    return simulation.advance(FrameInputs(commands, edits), Budget(steps=steps))


def test_a_stitch_whose_node_vanishes_is_released_and_reported() -> None:
    mesh, left, right = two_blocks()
    simulation = Simulation(mesh, Scene(model="lr"))
    advance(simulation, sew_edit(mesh, left, right))
    around = mesh.incident.of(int(left[0])).astype(np.uint32)
    frame = advance(simulation, TopologyEdit(mesh.version, removed_elements=around))
    assert "suture 1 is released: a node of it vanished" in frame.events
    assert 1 not in mesh.sutures.ids
    assert frame.edits[0].change.released.tolist() == [1]
    # The node at its other end is told, which nothing else touches.
    assert right[0] in frame.edits[0].change.nodes
    assert advance(simulation, ask="undo").answers[0].success
    assert 1 in mesh.sutures.ids


@pytest.mark.parametrize(
    ("model", "parameters"),
    [
        ("lr", {}),
        ("finite_element", {}),
        ("finite_element", {"corotated": 1.0}),
        ("vertex_block_descent", {}),
        ("relaxation", {}),
        ("chain_mail", {}),
    ],
)
def test_a_session_with_stitches_replays_bit_for_bit(
    model: str, parameters: dict[str, float]
) -> None:
    mesh, left, right = two_blocks()
    simulation = Simulation(mesh, Scene(model=model, parameters={model: parameters}))
    entries: list[JournalEntry] = []
    answers: list[Answer] = []

    def frame(*edits: TopologyEdit, ask: str = "") -> None:
        made = advance(simulation, *edits, ask=ask)
        entries.append(made.journal)
        answers.extend(made.answers)

    frame(sew_edit(mesh, left, right, request_id="sew"))
    frame(tighten_edit(mesh, 0.0002, "tighten"))
    frame()
    around = mesh.incident.of(int(left[0])).astype(np.uint32)
    frame(TopologyEdit(mesh.version, removed_elements=around, request_id="cut"))
    for ask in ("", "undo", "undo", "", "redo", ""):
        frame(ask=ask)
    assert all(answer.success for answer in answers), answers
    last = simulation.state.displacement[: mesh.node_rows]
    assert np.abs(last).max() > 1e-4
    fresh, _, _ = two_blocks()
    again = replay(entries, fresh)
    assert again.mismatches == ()
    assert equal(again.simulation.mesh.sutures, mesh.sutures)
    np.testing.assert_array_equal(again.simulation.state.displacement[: mesh.node_rows], last)


def test_a_model_with_a_region_of_interest_refuses_stitches_and_nothing_changes() -> None:
    mesh, left, right = two_blocks()
    values = {"interest_radius": 0.004, "interest_x": 0.012, "interest_y": 0.0045}
    simulation = Simulation(
        mesh, Scene(model="finite_element", parameters={"finite_element": values})
    )
    answer = advance(simulation, sew_edit(mesh, left, right, request_id="s")).answers[0]
    assert not answer.success
    assert "interest_radius knows no stitches" in answer.message
    assert mesh.version == 1


def test_a_snapshot_keeps_stitches_between_the_nodes_that_are_left(tmp_path: Path) -> None:
    mesh, _ = sewn()
    mesh.apply(TopologyEdit(mesh.version, removed_elements=mesh.incident.of(0).astype(np.uint32)))
    mesh.apply(TopologyEdit(mesh.version, kind="unsuture", removed_sutures=ids(3)))
    displacement = np.random.default_rng(1).normal(size=(mesh.node_capacity, 3)) * 1e-4
    snapshot.save(snapshot.take(mesh, displacement), tmp_path, "sewn")
    loaded = snapshot.load(tmp_path, "sewn")
    back = loaded.mesh()
    assert back.node_rows < mesh.node_rows
    assert back.sutures.ids.tolist() == mesh.sutures.ids.tolist()
    assert back.sutures.next_id == mesh.sutures.next_id
    moved = loaded.displacement.astype(np.float64)
    before = tensions(mesh.sutures, mesh.rest, displacement.astype(np.float32))
    np.testing.assert_array_equal(tensions(back.sutures, back.rest, moved), before)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"nodes": [[0, 5], [1, 900]]}, "at a node that is not there"),
        ({"nodes": [[0, 5], [4, 4]]}, "both ends"),
        ({"lengths": [0.1, -0.1]}, "rest length"),
        ({"ids": [2, 2]}, "not ascending"),
        ({"next_id": 2}, "not ascending"),
    ],
)
def test_a_damaged_table_is_refused(changed: dict[str, Any], message: str) -> None:
    table = Sutures(
        ids(1, 2), np.array([[0, 5], [1, 6]], dtype=np.int32), np.zeros(2), np.ones(2), ids(1, 2), 3
    )
    alive = np.ones(10, dtype=np.bool_)
    assert checked_sutures(table, alive) is table
    values: dict[str, Any] = {
        name: value if name == "next_id" else np.array(value) for name, value in changed.items()
    }
    with pytest.raises(ValueError, match=message):
        checked_sutures(replace(table, **values), alive)


def test_a_late_joiner_knows_the_stitches_and_follows_the_next_ones() -> None:
    mesh, left, right = two_blocks()
    epoch = bytes(range(16))
    mesh.apply(sew_edit(mesh, left[:6], right[:6], 0.0004))
    mesh.apply(TopologyEdit(mesh.version, kind="unsuture", removed_sutures=ids(6)))
    message = conversions.mesh_to_topology(mesh, epoch, "organ", Time())
    replica = Replica()
    replica.take_keyframe(epoch, conversions.topology_to_mesh(message))
    assert replica.mesh is not None
    assert equal(replica.mesh.sutures, mesh.sutures)
    for number in (0, 1):
        plan = tighten_edit(mesh, 0.0) if number else sew_edit(mesh, left[6:], right[6:])
        applied = mesh.apply(plan).edit
        sent = edit_messages.edit_to_msg(applied, epoch, "organ", Time())
        replica.take_edit(epoch, edit_messages.edit_from_msg(sent))
    assert replica.gaps == 0
    assert equal(replica.mesh.sutures, mesh.sutures)


def test_nodes_inside_are_not_of_the_surface() -> None:
    mesh, _, _ = two_blocks()
    points = mesh.rest[: mesh.node_rows]
    size = [0.012, 0.009, 0.006]
    block = points[points[:, 0] < 0.0121]
    inside = ((block > 1e-9) & (block < np.array(size) - 1e-9)).all(axis=1)
    found = [is_surface_node(mesh, node) for node in range(len(block))]
    np.testing.assert_array_equal(found, ~inside)
    assert inside.sum() == 6
