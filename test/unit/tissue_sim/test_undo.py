"""Undo and redo in a running simulation: every model, holds, replica and journal follow."""

from __future__ import annotations

import contextlib
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from cut_service.errors import CutError
from cut_service.planner import plan
from support.cut_scenes import square
from support.elastic_scenes import VARIANTS
from support.sheets import connected
from support.small_block import CORNER, block_mesh, block_simulation, pose_of, tool_at
from support.split_edit import split_at
from tissue_sim.elastic import registry
from tissue_sim.frame import Answer, Budget, Command, Frame, FrameInputs, JournalEntry, ToolSample
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.journal import replay
from tissue_sim.replica import Replica
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation


def advance(
    simulation: Simulation,
    *commands: Command,
    edits: tuple[TopologyEdit, ...] = (),
    steps: int = 4,
    pull: float | None = None,
) -> Frame:
    tools: tuple[ToolSample, ...] = ()
    if pull is not None:
        tools = (ToolSample("grasper", pose_of(np.add(CORNER, [0, pull, 0]))),)
    return simulation.advance(FrameInputs(commands, edits, tools), Budget(steps=steps))


def ask(simulation: Simulation, kind: str, **arguments: object) -> Answer:
    return advance(simulation, Command(kind, arguments, f"{kind}-id")).answers[0]


def cut_some(simulation: Simulation, author: str = "alice") -> None:
    """Two splits that meet, with steps in between, so that the lips part."""
    for x, top in ((0.03, 0.05), (0.015, 0.04)):
        split = replace(split_at(simulation.mesh, x, top, f"cut-{x}"), author=author)
        advance(simulation, edits=(split,))
        advance(simulation, steps=20)


def grab(simulation: Simulation, pull: float) -> None:
    advance(simulation, Command("grab", {"tool": "grasper", "radius": 0.02}))
    for part in range(1, 6):
        advance(simulation, pull=pull * part / 5)


@cache
def rest_of(variant: str) -> NDArray[np.floating]:
    """Where a pulled block without cuts comes to rest."""
    simulation = simulation_of(variant)
    grab(simulation, 0.006)
    settle(simulation)
    return simulation.state.displacement[: simulation.mesh.node_rows].copy()


def simulation_of(variant: str) -> Simulation:
    name, parameters = VARIANTS[variant]
    return block_simulation(model=name, parameters={name: dict(parameters)})


def settle(simulation: Simulation) -> None:
    for _ in range(60):
        advance(simulation, steps=10 if simulation.model.time_step is None else 100)


@pytest.mark.parametrize("variant", list(VARIANTS))
def test_after_undo_every_model_goes_on_and_comes_to_the_same_rest(variant: str) -> None:
    simulation, fresh = simulation_of(variant), block_mesh()
    grab(simulation, 0.006)
    cut_some(simulation)
    assert ask(simulation, "undo").success
    assert ask(simulation, "redo").success
    assert ask(simulation, "undo").success
    assert ask(simulation, "undo").success
    rows = fresh.node_rows
    np.testing.assert_array_equal(simulation.mesh.node_alive[:rows], True)
    assert not simulation.mesh.node_alive[rows:].any()
    elements = slice(0, fresh.element_rows)
    np.testing.assert_array_equal(simulation.mesh.tets[elements], fresh.tets[elements])
    settle(simulation)
    assert simulation.lost_states == 0
    now = simulation.state.displacement[:rows]
    assert np.isfinite(simulation.state.displacement).all()
    assert np.abs(now - rest_of(variant)).max() < 1e-3 * np.abs(now).max()


def test_a_region_of_interest_follows_undo_and_redo() -> None:
    region = {
        "interest_radius": 0.046, "interest_x": 0.03, "interest_y": 0.06, "interest_z": 0.03
    }  # fmt: skip
    parameters = {"finite_element": region}
    simulation, other = (
        block_simulation(nodes=7, model="finite_element", parameters=parameters) for _ in range(2)
    )
    grab(simulation, 0.004)
    grab(other, 0.004)
    middle, along_x = np.array([0.031, 0.06, 0.031]), np.array([1.0, 0.0, 0.0])
    positions = simulation.state.positions(simulation.mesh)
    cut = plan(simulation.mesh, positions, square(middle, along_x, 0.02, 0.0)).edit
    assert advance(simulation, edits=(cut,)).answers[0].success
    for kind in ("undo", "redo", "undo", "redo", "undo"):
        advance(simulation, steps=5)
        assert ask(simulation, kind).success
    settle(simulation)
    settle(other)
    rows = other.mesh.node_rows
    now = simulation.state.displacement[:rows]
    np.testing.assert_allclose(now, other.state.displacement[:rows], atol=2e-6)


def test_cuts_of_connected_surfaces_are_undone_too() -> None:
    tool = tool_at((0.0, 0.0, 0.02), size=(0.006,))
    simulation, other = (
        Simulation(connected(fixed=True), Scene(model="lr", tools=(tool,))) for _ in range(2)
    )
    for one in (simulation, other):
        advance(one, Command("grab", {"tool": "grasper", "radius": 0.006}))
        pose = ToolSample("grasper", pose_of([0.0, 0.003, 0.02]))
        one.advance(FrameInputs(tools=(pose,)), Budget(steps=40))
    cuts, random = 0, np.random.default_rng(3)
    while cuts < 4:
        positions = simulation.state.positions(simulation.mesh).astype(np.float64)
        sweep = square(random.choice(positions), random.normal(size=3), 0.01)
        with contextlib.suppress(CutError):
            edit = plan(simulation.mesh, positions, sweep).edit
            cuts += len(advance(simulation, edits=(edit,), steps=20).edits)
    for kind in ("undo", "redo", "undo"):
        for _ in range(cuts):
            assert ask(simulation, kind).success
    elements, rows = other.mesh.element_rows, other.mesh.node_rows
    for name in ("tets", "element_alive"):
        now, then = getattr(simulation.mesh, name), getattr(other.mesh, name)
        np.testing.assert_array_equal(now[:elements], then[:elements])
    # In the same shape tissue that was never cut has the same forces, bit for bit.
    other.state.displacement[:rows] = simulation.state.displacement[:rows]
    nodes = np.arange(rows, dtype=np.int32)
    forces = simulation.model.forces(simulation.state, nodes)
    np.testing.assert_array_equal(forces, other.model.forces(other.state, nodes))
    assert np.abs(forces).max() > 1e-3


def test_undo_names_whose_edit_it_was_and_refuses_politely() -> None:
    simulation = block_simulation()
    for kind, word in (("undo", "no edit to undo"), ("redo", "no undone edit to redo")):
        answer = ask(simulation, kind)
        assert (answer.success, answer.error) == (False, "NOTHING_THERE")
        assert word in answer.message
    cut_some(simulation)
    answer = ask(simulation, "undo", author="bob")
    assert answer.success
    assert answer.message == "undo of the split by alice (cut-0.015): version 4"
    assert answer.values["reverted_author"] == "alice"
    assert (answer.values["can_undo"], answer.values["can_redo"]) == (1, 1)
    # Another edit makes an end of what was undone.
    advance(simulation, edits=(split_at(simulation.mesh, 0.045, 0.05),))
    assert ask(simulation, "redo").error == "NOTHING_THERE"
    assert ask(simulation, "undo").values["version"] == 6


def test_only_the_history_brings_things_back() -> None:
    simulation = block_simulation()
    cut_some(simulation)
    edit = simulation.history.undo(simulation.mesh)
    answer = advance(simulation, edits=(edit,)).answers[0]
    assert answer.error == "INVALID"
    assert "undo and redo only" in answer.message
    assert simulation.mesh.version == 3
    nobody = np.empty((0, 4), dtype=np.uint32)
    half = replace(edit, rewritten_elements=nobody[:, 0], rewritten_nodes=nobody)
    with pytest.raises(ValueError, match="still belong to an element"):
        simulation.mesh.check(half)


def test_merged_nodes_take_the_mean_of_their_copies() -> None:
    simulation = block_simulation()
    grab(simulation, 0.006)
    advance(simulation, edits=(split_at(simulation.mesh, 0.03, 0.05),))
    advance(simulation, steps=30)
    edit = simulation.history.undo(simulation.mesh)
    copies, parents = edit.merged_nodes.astype(int), edit.merged_into.astype(int)
    state = simulation.state
    current = (state.displacement[copies] + state.displacement[parents]) / 2
    previous = (state.previous[copies] + state.previous[parents]) / 2
    assert np.abs(state.displacement[copies] - state.displacement[parents]).max() > 1e-4
    simulation.paused = True
    assert ask(simulation, "undo").success
    np.testing.assert_allclose(state.displacement[parents], current, atol=1e-9)
    np.testing.assert_allclose(state.previous[parents], previous, atol=1e-9)


def test_a_merged_node_stays_held_and_does_not_jump() -> None:
    simulation = block_simulation()
    grab(simulation, 0.004)
    x = np.unique(simulation.mesh.rest[simulation.holds.rows, 0])[0]
    advance(simulation, edits=(split_at(simulation.mesh, float(x)),))
    held = len(simulation.holds.rows)
    edit = simulation.history.undo(simulation.mesh)
    both = np.isin(edit.merged_nodes, simulation.holds.rows)
    assert both.any()
    places = simulation.state.displacement[simulation.holds.rows].copy()
    rows = simulation.holds.rows
    assert ask(simulation, "undo").success
    assert len(simulation.holds.rows) == held - both.sum()
    kept = np.isin(rows, simulation.holds.rows)
    now = simulation.state.displacement[simulation.holds.rows]
    np.testing.assert_allclose(now, places[kept], atol=1e-7)
    assert ask(simulation, "redo").success
    np.testing.assert_array_equal(simulation.holds.rows, rows)


def test_a_replica_follows_undo_and_redo() -> None:
    simulation, replica = block_simulation(), Replica()
    replica.take_keyframe(simulation.epoch, block_mesh())
    grab(simulation, 0.006)

    def follow(frame: Frame, with_state: bool = True) -> None:
        for applied in frame.edits:
            assert replica.take_edit(simulation.epoch, applied.change.edit) is not None
        if with_state:
            replica.take_state(
                simulation.epoch, simulation.mesh.version, simulation.frame, frame.positions.copy()
            )

    follow(advance(simulation))
    follow(advance(simulation, edits=(split_at(simulation.mesh, 0.03, 0.05),)))
    follow(advance(simulation, steps=30))
    simulation.paused = True
    for kind in ("undo", "redo", "undo"):
        # The state of this frame does not come: the replica carries the one before.
        frame = advance(simulation, Command(kind))
        follow(frame, with_state=False)
        shape = replica.shape_at()
        assert shape is not None
        assert replica.mesh is not None
        alive = simulation.mesh.node_alive[: simulation.mesh.node_rows]
        np.testing.assert_allclose(shape.positions[alive], frame.positions[alive], atol=1e-7)
        same(replica.mesh, simulation.mesh)
    assert replica.gaps == 0


def same(one: Mesh, other: Mesh) -> None:
    nodes, elements = one.node_rows, one.element_rows
    assert (nodes, elements, one.version) == (other.node_rows, other.element_rows, other.version)
    for name, rows in (("rest", nodes), ("node_alive", nodes), ("tets", elements)):
        np.testing.assert_array_equal(getattr(one, name)[:rows], getattr(other, name)[:rows])


def through_json(entry: JournalEntry) -> JournalEntry:
    commands = tuple(
        replace(command, arguments=json.loads(json.dumps(command.arguments)))
        for command in entry.inputs.commands
    )
    return replace(entry, inputs=replace(entry.inputs, commands=commands))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_replay_of_a_session_with_undo_is_bit_exact(seed: int) -> None:
    random = np.random.default_rng(seed)
    simulation, entries = block_simulation(), []
    splits = [(0.03, 0.05), (0.015, 0.05), (0.045, 0.04), (0.03, 0.05), (0.045, 0.05)]
    done = {"undo": 0, "redo": 0}
    for number in range(70):
        commands: tuple[Command, ...] = ()
        edits: tuple[TopologyEdit, ...] = ()
        if number == 5:
            commands = (Command("grab", {"tool": "grasper", "radius": 0.02}),)
        elif number % 9 == 8 and splits:
            x, top = splits.pop()
            edits = (split_at(simulation.mesh, x, top),)
        elif number % 23 == 22:
            name = str(random.choice(registry.names()))
            commands = (Command("set_model", {"model": name, "parameters": {}}),)
        elif random.random() < 0.4:
            kinds = random.choice(["undo", "undo", "redo"], size=random.integers(1, 3))
            commands = tuple(Command(str(kind), {"author": "x"}) for kind in kinds)
        pose = pose_of(np.add(CORNER, [0, 0.0001 * number, 0]))
        inputs = FrameInputs(commands, edits, (ToolSample("grasper", pose),))
        frame = simulation.advance(inputs, Budget(seconds=float(random.uniform(0, 3e-4))))
        entries.append(frame.journal)
        for command, answer in zip(commands, frame.answers, strict=False):
            if command.kind in done:
                done[command.kind] += answer.success
    assert min(done.values()) >= 1
    assert done["undo"] >= 3
    result = replay([through_json(entry) for entry in entries], block_mesh())
    assert result.mismatches == ()
    np.testing.assert_array_equal(result.simulation.state.previous, simulation.state.previous)
    same(result.simulation.mesh, simulation.mesh)
