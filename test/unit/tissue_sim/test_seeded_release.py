"""What a hold lets go of starts from rest, blended with distance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from support.small_block import CORNER, block_mesh, block_simulation, pose_of, tool_at
from support.split_edit import split_at
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.frame import Budget, Command, FrameInputs, JournalEntry, ToolSample
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.seeding import Seeding
from tissue_sim.journal import replay
from tissue_sim.release_study import released
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

NONE = Budget(steps=0)
RADIUS = 0.031
LEFT, RIGHT = tool_at(CORNER, "left"), tool_at((0.0, 0.06, 0.06), "right")


def corner_node(mesh: Mesh, place: tuple[float, float, float] = CORNER) -> int:
    return int(np.linalg.norm(mesh.rest[: mesh.node_rows] - place, axis=1).argmin())


def network(mesh: Mesh) -> SpringNetwork:
    return SpringNetwork(mesh, Material())


def displaced(mesh: Mesh) -> State:
    """Every free node somewhere else, with a velocity."""
    state = State(mesh)
    free = np.flatnonzero(mesh.node_alive & ~mesh.fixed)
    state.displacement[free] = np.random.default_rng(1).normal(scale=0.01, size=(len(free), 3))
    return state


def ways(mesh: Mesh, sources: list[int], closed: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Distances along edges without entering closed nodes, by SciPy."""
    tets = mesh.tets[: mesh.element_rows][mesh.element_alive[: mesh.element_rows]]
    pairs = np.concatenate([tets[:, [a, b]] for a in range(4) for b in range(4) if a != b])
    pairs = np.unique(pairs[~closed[pairs].any(axis=1)], axis=0)
    lengths = np.linalg.norm(mesh.rest[pairs[:, 0]] - mesh.rest[pairs[:, 1]], axis=1)
    rows = mesh.node_rows
    graph = coo_array((lengths, (pairs[:, 0], pairs[:, 1])), shape=(rows, rows)).tocsr()
    return np.asarray(dijkstra(graph, indices=sources, min_only=True))


def smooth(share: NDArray[np.float64]) -> NDArray[np.float64]:
    return share**2 * (3 - 2 * share)


def grab_and_pull(simulation: Simulation, tool: str, *way: float, steps: int = 20) -> None:
    simulation.advance(FrameInputs((Command("grab", {"tool": tool, "radius": 0.02}),)), NONE)
    pose = simulation.poses[tool].copy()
    pose[:3] += way
    simulation.advance(FrameInputs(tools=(ToolSample(tool, pose),)), Budget(steps=steps))


def let_go(simulation: Simulation, tool: str, steps: int = 0) -> JournalEntry:
    command = Command("release", {"hold_id": 0, "tool": tool})
    return simulation.advance(FrameInputs((command,)), Budget(steps=steps)).journal


def test_the_weights_are_those_of_the_distance_along_edges() -> None:
    mesh = block_mesh(9)
    source = corner_node(mesh)
    state = displaced(mesh)
    before = state.displacement.copy()
    Seeding(mesh, RADIUS).seed(state, np.array([source]), network(mesh))
    rows = mesh.node_rows
    share = ways(mesh, [source], mesh.fixed[:rows]) / RADIUS
    expected = smooth(np.minimum(share, 1.0))[:, None] * before[:rows]
    np.testing.assert_allclose(state.displacement[:rows], expected, rtol=1e-5, atol=1e-9)
    near = share < 1.0
    assert 40 < near.sum() < rows
    np.testing.assert_array_equal(state.displacement[:rows][~near], before[:rows][~near])
    np.testing.assert_array_equal(state.previous[:rows][near], state.displacement[:rows][near])
    np.testing.assert_array_equal(state.previous[:rows][~near], 0.0)


def test_a_second_seeding_is_as_good_as_the_first() -> None:
    mesh = block_mesh(7)
    seeding, sources = Seeding(mesh, RADIUS), np.array([corner_node(mesh)])
    first, again = displaced(mesh), displaced(mesh)
    Seeding(mesh, RADIUS).seed(first, sources, network(mesh))
    seeding.seed(displaced(mesh), np.array([corner_node(mesh, (0.03, 0.03, 0.03))]), network(mesh))
    seeding.seed(again, sources, network(mesh))
    np.testing.assert_array_equal(again.displacement, first.displacement)


def test_held_nodes_stay_and_the_blend_ends_at_them() -> None:
    mesh = block_mesh(9)
    source, state = corner_node(mesh), displaced(mesh)
    held = np.flatnonzero(np.abs(mesh.rest[: mesh.node_rows, 0] - 0.045) < 1e-9)
    state.prescribed[held] = True
    before, rows = state.displacement.copy(), mesh.node_rows
    Seeding(mesh, RADIUS).seed(state, np.array([source]), network(mesh))
    np.testing.assert_array_equal(state.displacement[held], before[held])
    beyond = mesh.rest[:rows, 0] < 0.045 - 1e-9
    np.testing.assert_array_equal(state.displacement[:rows][beyond], before[:rows][beyond])
    # Next to held nodes displacements are nearly kept, as far from them as from the source half.
    d = ways(mesh, [source], state.prescribed[:rows])
    near = np.flatnonzero(d < RADIUS)
    e = np.linalg.norm(mesh.rest[near][:, None] - mesh.rest[held][None], axis=2).min(axis=1)
    layer = mesh.rest[near, 0] < 0.0525 + 1e-9
    weights = np.linalg.norm(state.displacement[near], axis=1)
    weights /= np.linalg.norm(before[near], axis=1)
    assert (weights[layer] >= smooth(d[near] / RADIUS)[layer] - 1e-5).all()
    straight = smooth(np.minimum(d[near] / np.minimum(RADIUS, d[near] + e), 1.0))
    np.testing.assert_allclose(weights[layer], straight[layer], rtol=1e-4, atol=1e-5)


def test_a_cut_is_not_crossed() -> None:
    mesh = block_mesh(9)
    source = corner_node(mesh, (0.0375, 0.06, 0.06))
    springs = network(mesh)
    springs.follow(mesh.apply(split_at(mesh, 0.03)))
    state = displaced(mesh)
    before, rows = state.displacement.copy(), mesh.node_rows
    Seeding(mesh, RADIUS).seed(state, np.array([source]), springs)
    d = ways(mesh, [source], mesh.fixed[:rows])
    other = ~np.isfinite(d) & ~mesh.fixed[:rows]
    close = np.linalg.norm(mesh.rest[:rows] - mesh.rest[source], axis=1) < 0.02
    assert (other & close).sum() > 10
    np.testing.assert_array_equal(state.displacement[:rows][other], before[:rows][other])
    assert (state.displacement[:rows] != before[:rows]).any()


def test_a_piece_without_fixed_nodes_is_left_alone() -> None:
    mesh = block_mesh(7)
    mesh.fixed[: mesh.node_rows] = mesh.rest[: mesh.node_rows, 0] < 1e-9
    loose, kept = corner_node(mesh), corner_node(mesh, (0.01, 0.06, 0.06))
    springs = network(mesh)
    springs.follow(mesh.apply(split_at(mesh, 0.03)))
    state = displaced(mesh)
    before = state.displacement.copy()
    seeding = Seeding(mesh, RADIUS)
    assert len(seeding.seed(state, np.array([loose]), springs)) == 0
    np.testing.assert_array_equal(state.displacement, before)
    moved = seeding.seed(state, np.array([loose, kept]), springs)
    assert (mesh.rest[moved, 0] <= 0.03 + 1e-9).all()
    np.testing.assert_array_equal(state.displacement[kept], 0.0)
    mesh.fixed[:] = False
    assert len(Seeding(mesh, RADIUS).seed(state, np.array([loose, kept]), springs)) == 0


@pytest.mark.parametrize("model", registry.names())
def test_released_nodes_start_from_rest_in_every_model_and_the_session_goes_on(model: str) -> None:
    simulation = block_simulation(LEFT, RIGHT, model=model, seeded_release=0.04)
    grab_and_pull(simulation, "left", 0.0, 0.004, 0.003)
    grab_and_pull(simulation, "right", 0.0, 0.003, 0.0)
    mesh, state = simulation.mesh, simulation.state
    freed = simulation.holds.of_tool("left")[0].rows
    kept = simulation.holds.of_tool("right")[0].rows
    before = state.displacement.copy()
    let_go(simulation, "left")
    np.testing.assert_array_equal(state.displacement[freed], 0.0)
    np.testing.assert_array_equal(state.displacement[kept], before[kept])
    simulation.advance(FrameInputs(), Budget(steps=1))
    first = np.abs(state.displacement[freed]).max()
    frames = [simulation.advance(FrameInputs(), Budget(steps=5)) for _ in range(4)]
    assert not any(frame.lost for frame in frames)
    np.testing.assert_array_equal(state.displacement[kept], before[kept])
    # No momentum from before: the first step carries nothing away.
    assert first < 0.004
    assert np.isfinite(state.displacement[: mesh.node_rows]).all()


@pytest.mark.parametrize("model", ["lr", "quasi_static", "vertex_block_descent"])
def test_seeded_nodes_do_not_repeat_the_moves_of_an_earlier_release(model: str) -> None:
    simulation = block_simulation(LEFT, RIGHT, model=model, parameters={model: {"levels": 1}})
    grab_and_pull(simulation, "left", 0.0, 0.004, 0.003)
    grab_and_pull(simulation, "right", 0.0, 0.003, 0.0)
    let_go(simulation, "left", steps=3)
    lingering = simulation.model.active.lingering  # type: ignore[attr-defined]
    near = np.flatnonzero(lingering._last_move.any(axis=1)).astype(np.int32)
    assert len(near) > 10
    simulation.model.nodes_placed(near[:5])
    np.testing.assert_array_equal(lingering._last_move[near[:5]], 0.0)
    assert lingering._last_move[near[5:]].any(axis=1).all()


@pytest.mark.parametrize("model", registry.names())
def test_off_is_what_it_was_before(model: str) -> None:
    def run(scene: dict[str, Any]) -> NDArray[np.float32]:
        simulation = block_simulation(LEFT, model=model, **scene)
        grab_and_pull(simulation, "left", 0.0, 0.004, 0.003)
        before = simulation.state.displacement.copy()
        let_go(simulation, "left")
        np.testing.assert_array_equal(simulation.state.displacement, before)
        return simulation.advance(FrameInputs(), Budget(steps=5)).positions

    np.testing.assert_array_equal(run({}), run({"seeded_release": 0.0}))


def test_released_while_paused_it_waits_until_time_goes_on() -> None:
    simulation = block_simulation(LEFT, model="quasi_static", seeded_release=RADIUS)
    grab_and_pull(simulation, "left", 0.0, 0.004, 0.003)
    freed, before = simulation.holds.rows, simulation.state.displacement.copy()
    simulation.advance(FrameInputs((Command("pause", {"on": True}),)), NONE)
    let_go(simulation, "left")
    np.testing.assert_array_equal(simulation.state.displacement, before)
    simulation.advance(FrameInputs((Command("pause", {"on": False}),)), NONE)
    np.testing.assert_array_equal(simulation.state.displacement[freed], 0.0)


@pytest.mark.parametrize("model", registry.names())
def test_a_replay_with_seeding_is_bit_exact(model: str) -> None:
    simulation = block_simulation(LEFT, RIGHT, model=model, seeded_release=RADIUS)
    random, entries, level = np.random.default_rng(5), [], {"left": False, "right": False}
    places = {"left": np.array(LEFT.pose[:3]), "right": np.array(RIGHT.pose[:3])}
    for number in range(40):
        samples = []
        for tool in level:
            places[tool] += random.normal(scale=1e-3, size=3)
            edge: Literal[-1, 0, 1] = 0
            if random.random() < 0.2:
                level[tool] = not level[tool]
                edge = 1 if level[tool] else -1
            samples.append(ToolSample(tool, pose_of(places[tool]), 1, level[tool], edge))
        edits = (split_at(simulation.mesh, 0.03, top=0.05),) if number == 20 else ()
        inputs = FrameInputs(edits=edits, tools=tuple(samples))
        entries.append(simulation.advance(inputs, Budget(steps=2)).journal)
    result = replay(entries, block_mesh())
    assert result.mismatches == ()
    again = result.simulation
    assert again.scene.seeded_release == RADIUS
    np.testing.assert_array_equal(again.state.displacement, simulation.state.displacement)
    unseeded = replace(simulation.scene, seeded_release=0.0).as_arguments()
    start = replace(entries[0].inputs.commands[0], arguments=unseeded)
    entries[0] = replace(entries[0], inputs=replace(entries[0].inputs, commands=(start,)))
    assert replay(entries, block_mesh()).mismatches


def test_a_start_from_before_there_was_seeding_has_none() -> None:
    arguments = Scene(seeded_release=0.02).as_arguments()
    assert Scene.from_arguments(arguments).seeded_release == 0.02
    del arguments["seeded_release"]
    assert Scene.from_arguments(arguments).seeded_release == 0.0


@pytest.mark.parametrize("radius", [-0.01, 1.5, float("nan")])
def test_a_wrong_radius_is_refused(radius: float) -> None:
    with pytest.raises(ValueError, match=r"seeded_release = .* allowed: 0 to 1 m"):
        block_simulation(seeded_release=radius)


@pytest.mark.parametrize("model", ["lr", "quasi_static"])
def test_springs_return_in_fewer_steps(model: str) -> None:
    plain, seeded = (released("wall", model, radius, 500) for radius in (0.0, 0.04))
    for slow, fast in zip(plain.steps, seeded.steps, strict=True):
        assert slow is not None
        assert fast is not None
        assert fast < slow
