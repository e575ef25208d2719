"""Another model takes over while the simulation runs: with a hold, and after a cut."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from support.elastic_scenes import VARIANTS, split_edit
from support.small_block import pose_of
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material, State
from tissue_sim.frame import Budget, Command, Edge, Frame, FrameInputs, ToolSample
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

ALL = registry.names()
TOP = np.array([0.045, 0.03, 0.06])
PULL = 0.008
STEPS = 6

RESTS = {"relaxation": 3e-4}
"""How far from rest [m] a model leaves tissue that it has let go of for 5 s; the others: `REST`.

Relaxation leaves what is within its limits, 0.035 % of lengths, summed over 6 cm and a crack.
"""

REST = 5e-5

DRIFTS = {"dynamic vertex_block_descent": 5e-6}
"""How far [m] a part cut free and flung away moves in the fifth second; the others: `DRIFT`.

Its damping takes away all but e^-3 of the velocity a second.
"""

DRIFT = 1e-6

JUMPS = {"chain_mail": 1.0, "voxel_chain_mail": 1.0}
"""Longest way of a node in the first step, as a share of the pull; the others: 0.5.

A step of ChainMail puts everything within its limits at once.
"""


def simulation_of(model: str, fixed_side: int = 2, **parameters: float) -> Simulation:
    """A block of 6 cm, fixed where the given axis is 0, and a grasper at its top."""
    raw = block(5, 5, 5)
    tool = ToolSpec("grasper", pose=tuple(pose_of(TOP)), size=(0.016,)).checked()
    mesh = Mesh(raw, raw.points[:, fixed_side] < 1e-9)
    return Simulation(mesh, Scene(model=model, parameters={model: parameters}, tools=(tool,)))


def frame_of(simulation: Simulation, lifted: float, edge: Edge = 0, **inputs: Any) -> Frame:
    """A frame with the tool lifted by so much [m]."""
    place = pose_of(np.add(TOP, (0, 0, lifted)))
    sample = ToolSample("grasper", place, 1, edge != -1, edge)
    budget = Budget(steps=STEPS if simulation.model.time_step is None else None)
    frame = simulation.advance(FrameInputs(tools=(sample,), **inputs), budget)
    assert np.isfinite(frame.positions).all()
    return frame


def pull(simulation: Simulation, frames: int = 8) -> None:
    """Grab at the top and lift by PULL."""
    frame_of(simulation, 0.0, 1)
    for number in range(1, frames + 1):
        frame_of(simulation, PULL * number / frames)
    assert len(simulation.holds.rows)


def assert_held_where_the_tool_is(simulation: Simulation, lifted: float) -> None:
    held = simulation.holds.rows
    wanted = np.tile([0, 0, lifted], (len(held), 1))
    np.testing.assert_allclose(simulation.state.displacement[held], wanted, atol=1e-9)


def one_step_of_a_new_model(simulation: Simulation) -> np.ndarray:
    """Where a step of a model built for the mesh as it is now takes a copy of the state [m]."""
    mesh, state = simulation.mesh, State(simulation.mesh)
    for name in ("displacement", "previous", "prescribed"):
        getattr(state, name)[:] = getattr(simulation.state, name)
    springs = simulation.model.springs  # type: ignore[attr-defined]
    material = simulation.scene.material
    model = registry.build(simulation.model.name, mesh, material, springs=springs)
    model.prescribed_changed(state, simulation.holds.rows)
    model.step(state)
    return state.displacement


@pytest.mark.parametrize("cut", [False, True], ids=["whole", "cut"])
@pytest.mark.parametrize("second", ALL)
@pytest.mark.parametrize("first", ALL)
def test_a_model_takes_over_a_hold_without_a_jump(first: str, second: str, cut: bool) -> None:
    simulation = simulation_of(first)
    pull(simulation)
    if cut:
        edit = split_edit(simulation.mesh, 0.03, above=0.02)
        assert frame_of(simulation, PULL, edits=(edit,)).edits
        frame_of(simulation, PULL)
    before = simulation.state.displacement.copy()
    held, version = simulation.holds.rows.copy(), simulation.mesh.version
    arguments = {"model": second, "parameters": {}}
    switch = FrameInputs((Command("set_model", arguments, "switch"),))
    frame = simulation.advance(switch, Budget(steps=0))
    assert frame.answers[0].success
    assert simulation.model.name == second
    np.testing.assert_array_equal(simulation.state.displacement, before)
    np.testing.assert_array_equal(simulation.state.previous, before)
    np.testing.assert_array_equal(simulation.holds.rows, held)
    np.testing.assert_array_equal(simulation.state.prescribed[held], True)
    assert simulation.mesh.version == version
    wanted = one_step_of_a_new_model(simulation)
    simulation.advance(FrameInputs(), Budget(steps=1))
    np.testing.assert_array_equal(simulation.state.displacement, wanted)
    moved = np.linalg.norm(wanted - before, axis=1)
    assert not moved[held].any()
    assert moved.max() < JUMPS.get(second, 0.5) * PULL
    frame_of(simulation, 1.1 * PULL)
    assert_held_where_the_tool_is(simulation, 1.1 * PULL)
    frame_of(simulation, 1.1 * PULL, -1)
    for _ in range(300):
        frame_of(simulation, 1.1 * PULL)
    assert simulation.lost_states == 0
    assert np.abs(simulation.state.displacement).max() < RESTS.get(second, REST)


def test_a_switch_during_motion_stops_it() -> None:
    simulation = simulation_of("spring_mass")
    pull(simulation)
    frame_of(simulation, PULL, -1)
    moving = np.abs(simulation.state.displacement - simulation.state.previous).max()
    assert moving > 1e-5
    switch = Command("set_model", {"model": "spring_mass", "parameters": {"damping": 0.1}})
    simulation.advance(FrameInputs((switch,)), Budget(steps=0))
    np.testing.assert_array_equal(simulation.state.previous, simulation.state.displacement)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_part_cut_free_neither_drifts_nor_blows_up(variant: str) -> None:
    model, parameters = VARIANTS[variant]
    simulation = simulation_of(model, fixed_side=0, **parameters)
    mesh = simulation.mesh
    pull(simulation)
    assert frame_of(simulation, PULL, edits=(split_edit(mesh, 0.03),)).edits
    for number in range(1, 21):
        frame_of(simulation, PULL * (1 + 0.1 * number))
    free = free_part(mesh)
    frame_of(simulation, 3 * PULL, -1)
    for _ in range(240):
        frame_of(simulation, 3 * PULL)
    early = simulation.state.displacement[free].mean(axis=0, dtype=np.float64)
    for _ in range(60):
        frame_of(simulation, 3 * PULL)
    late = simulation.state.displacement[free].mean(axis=0, dtype=np.float64)
    assert simulation.lost_states == 0
    assert np.abs(late - early).max() < DRIFTS.get(variant, DRIFT)
    assert np.linalg.norm(simulation.state.displacement, axis=1).max() < 2 * 3 * PULL
    rest = np.ones(mesh.node_rows, dtype=np.bool_)
    rest[free] = False
    left = np.abs(simulation.state.displacement[: mesh.node_rows][rest]).max()
    assert left < RESTS.get(model, REST)


@pytest.mark.parametrize(
    "variants",
    [
        ("lr", "corotated", "finite_element", "dynamic vertex_block_descent"),
        ("dynamic vertex_block_descent", "corotated", "spring_mass", "vertex_block_descent"),
    ],
)
def test_variants_take_over_a_part_that_was_cut_free(variants: tuple[str, ...]) -> None:
    first, parameters = VARIANTS[variants[0]]
    simulation = simulation_of(first, fixed_side=0, **parameters)
    mesh = simulation.mesh
    pull(simulation)
    assert frame_of(simulation, PULL, edits=(split_edit(mesh, 0.03),)).edits
    free = free_part(mesh)
    middle = mesh.rest[free].mean(axis=0) + simulation.state.displacement[free].mean(axis=0)
    for variant in variants[1:]:
        before = simulation.state.displacement.copy()
        model, parameters = VARIANTS[variant]
        command = Command("set_model", {"model": model, "parameters": dict(parameters)}, "switch")
        switch = FrameInputs((command,))
        assert simulation.advance(switch, Budget(steps=0)).answers[0].success
        np.testing.assert_array_equal(simulation.state.displacement, before)
        for _ in range(20):
            frame_of(simulation, PULL)
        assert_held_where_the_tool_is(simulation, PULL)
    frame_of(simulation, PULL, -1)
    for _ in range(300):
        frame_of(simulation, PULL)
    assert simulation.lost_states == 0
    end = mesh.rest[free].mean(axis=0) + simulation.state.displacement[free].mean(axis=0)
    assert np.linalg.norm(end - middle) < PULL
    rest = np.setdiff1d(np.arange(mesh.node_rows), free)
    assert np.abs(simulation.state.displacement[rest]).max() < REST


def free_part(mesh: Mesh) -> np.ndarray:
    """Nodes of elements beyond the cut at x = 0.03."""
    tets = mesh.tets[: mesh.element_rows]
    beyond = mesh.rest[tets][:, :, 0].mean(axis=1) > 0.03
    free: np.ndarray = np.unique(tets[beyond])
    assert not np.isin(free, tets[~beyond]).any()
    return free


def wrong_values() -> list[tuple[str, str, float]]:
    """Values out of range for every parameter of every model."""
    wrong = []
    for name in ALL:
        for p in registry.parameters_of(name):
            width = p.maximum - p.minimum
            values = [p.minimum - 1e-3 * width, p.maximum + 1e-3 * width, np.nan, np.inf, -np.inf]
            if p.integer:
                values = [p.minimum - 1, p.maximum + 1, *values[2:], p.minimum + 0.5]
            wrong += [(name, p.name, float(value)) for value in values]
    return wrong


@pytest.mark.parametrize("model", ALL)
def test_every_parameter_out_of_range_is_refused_with_its_limits(model: str) -> None:
    simulation = simulation_of("lr")
    running = simulation.model
    for name, parameter, value in wrong_values():
        if name != model:
            continue
        known = {p.name: p for p in registry.parameters_of(name)}[parameter]
        arguments = {"model": name, "parameters": {parameter: value}}
        command = Command("set_model", arguments)
        answer = simulation.advance(FrameInputs((command,)), Budget(steps=0)).answers[0]
        assert (answer.success, answer.error) == (False, "OUT_OF_RANGE")
        assert f"{parameter} = {value:g}" in answer.message
        assert f"allowed: {known.minimum:g} to {known.maximum:g}" in answer.message
        assert (known.unit or "") in answer.message
    assert simulation.model is running


@pytest.mark.parametrize("model", ALL)
def test_defaults_and_limits_are_within_the_limits(model: str) -> None:
    for p in registry.parameters_of(model):
        for value in (p.default, p.minimum, p.maximum):
            assert p.checked(value) == value


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"time_step": 0.01}, "time_step = 0.01 s is not stable .* allowed: up to .* s"),
        ({"integrator": 1, "damping": 0.0}, "damping = 0 is not stable .* allowed: more than 0"),
        ({"integrator": 2, "damping": 0.0}, "damping = 0 is not stable .* allowed: more than 0"),
        ({"home_stiffness": 1e6}, "home_stiffness = .* has been cut, .* allowed: 0"),
    ],
)
def test_what_this_tissue_cannot_carry_is_refused_and_the_model_runs_on(
    parameters: dict[str, float], said: str
) -> None:
    simulation = simulation_of("lr")
    pull(simulation)
    frame_of(simulation, PULL, edits=(split_edit(simulation.mesh, 0.03, above=0.02),))
    running, before = simulation.model, simulation.state.displacement.copy()
    command = Command("set_model", {"model": "spring_mass", "parameters": parameters})
    answer = simulation.advance(FrameInputs((command,)), Budget(steps=0)).answers[0]
    assert (answer.success, answer.error) == (False, "OUT_OF_RANGE")
    assert re.search(said, answer.message)
    assert simulation.model is running
    np.testing.assert_array_equal(simulation.state.displacement, before)
    frame_of(simulation, PULL)


@pytest.mark.parametrize("model", ALL)
@pytest.mark.parametrize("tet", [[0, 1, 2, 3], [0, 1, 2, 2], [0, 2, 1, 4]])
def test_elements_without_volume_are_refused(model: str, tet: list[int]) -> None:
    points = 0.01 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]])
    mesh = Mesh(RawMesh(points, np.array([[0, 1, 2, 4], tet])))
    with pytest.raises(ValueError, match=r"1 of 2 elements are flat or inside out .* allowed:"):
        Simulation(mesh, Scene(model=model))


@pytest.mark.parametrize("model", ALL)
@pytest.mark.parametrize("wrong", [0.5, 0.7, -0.1, np.nan])
def test_impossible_materials_are_refused(model: str, wrong: float) -> None:
    raw = block(3, 3, 3)
    with pytest.raises(ValueError, match=f"poisson_ratio = {wrong:g} is out of range; allowed: 0"):
        Simulation(Mesh(raw), Scene(model=model, material=Material(poisson_ratio=wrong)))
