"""Holds by force: equilibrium, time constant, stability, cuts, other models and replay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from support.elastic_scenes import split_edit
from support.small_block import pose_of
from tissue_sim import snapshot
from tissue_sim.elastic import registry
from tissue_sim.frame import Budget, Command, Edge, Frame, FrameInputs, ToolSample
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.interaction import rigid
from tissue_sim.interaction.coupling import FORCE, POSITION, Coupling
from tissue_sim.interaction.patch import Patch
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.journal import replay
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

ALL = registry.names()
TOP = np.array([0.03, 0.03, 0.06])
STIFF = 1e6
"""Angular stiffness [N m/rad] that leaves a patch no turning."""


def tool_of(tool: str = "grasper", hold: str = FORCE, at: Any = TOP, **coupling: float) -> ToolSpec:
    """A tool that reaches 16 mm."""
    return ToolSpec(
        tool, pose=tuple(pose_of(at)), size=(0.016,), hold=hold, coupling=Coupling(**coupling)
    ).checked()


def simulation_of(
    model: str, *tools: ToolSpec, rate_hz: float = 60.0, side: int = 2, **parameters: float
) -> Simulation:
    """A block of 6 cm, fixed where the coordinate of a side is 0."""
    raw = block(4, 4, 4)
    scene = Scene(
        model=model, parameters={model: parameters}, tools=tools or (tool_of(),), rate_hz=rate_hz
    )
    return Simulation(Mesh(raw, raw.points[:, side] < 1e-9), scene)


def frame_of(
    simulation: Simulation, pose: Any, edge: Edge = 0, tool: str = "grasper", **inputs: Any
) -> Frame:
    """A frame with a tool there."""
    sample = ToolSample(tool, np.asarray(pose, np.float64), 1, edge != -1, edge)
    budget = Budget(steps=8 if simulation.model.time_step is None else None)
    return simulation.advance(FrameInputs(tools=(sample,), **inputs), budget)


def moved(move: Any, turn: Any = (0.0, 0.0, 0.0), start: Any = TOP) -> np.ndarray:
    """A pose a little away from the start; the turn is small [rad]."""
    quaternion = np.array([*(0.5 * np.asarray(turn, np.float64)), 1.0])
    return pose_of(np.add(start, move), quaternion / np.linalg.norm(quaternion))


def frames(simulation: Simulation, pose: Any, count: int) -> Frame:
    for _ in range(count):
        frame = frame_of(simulation, pose)
    return frame


def patch_of(simulation: Simulation) -> Patch:
    (patch,) = simulation.holds.patches
    return patch


def way_of(patch: Patch, start: Any = TOP) -> np.ndarray:
    """How far a patch is from where it was grabbed: metres and radians, shape (6,)."""
    return np.concatenate([patch.pose[:3] - start, rigid.rotation_vector(patch.pose[3:])])


@pytest.fixture(scope="module")
def tissue() -> np.ndarray:
    """Stiffness of the tissue that is held, from absolute holds, shape (6, 6)."""
    columns = np.empty((6, 6))
    simulation = simulation_of("finite_element", tool_of(hold=POSITION))
    frame_of(simulation, moved((0, 0, 0)), 1)
    for motion in range(6):
        way = np.eye(6)[motion] * 1e-3
        wrench = frames(simulation, moved(way[:3], way[3:]), 60).wrenches["grasper"]
        columns[:, motion] = -wrench / 1e-3
    assert np.abs(columns - columns.T).max() < 2e-2 * np.abs(columns[:3, :3]).max()
    return columns


def energy_of(simulation: Simulation) -> float:
    """Energy of linear tissue and of the coupling [J]."""
    mesh, u = simulation.mesh, simulation.state.displacement.astype(np.float64)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    tissue = -0.5 * float((u[rows] * simulation.model.forces(simulation.state, rows)).sum())
    coupling, pose = simulation.tools["grasper"].coupling, simulation.poses["grasper"]
    stretch = patch_of(simulation).pose[:3] - pose[:3]
    turn = rigid.rotation_vector(
        rigid.multiply(patch_of(simulation).pose[3:], rigid.conjugate(pose[3:]))
    )
    springs = coupling.stiffness * stretch @ stretch + coupling.angular_stiffness * turn @ turn
    return tissue + 0.5 * float(springs)


@pytest.mark.parametrize("stiffness", [100.0, 3000.0, 1e5])
def test_tissue_comes_to_rest_where_spring_and_tissue_balance(
    tissue: np.ndarray, stiffness: float
) -> None:
    angular = stiffness * 1e-4
    spring = np.diag([stiffness] * 3 + [angular] * 3)
    # Small: the torque of a force at a place that moves is of second order.
    tool = np.array([2e-4, -1e-4, 3e-4, 1e-3, 0.0, 2e-3])
    simulation = simulation_of(
        "finite_element",
        tool_of(stiffness=stiffness, angular_stiffness=angular, force_limit=1e3, torque_limit=1e3),
    )
    frame_of(simulation, moved((0, 0, 0)), 1)
    frame = frames(simulation, moved(tool[:3], tool[3:]), 120)
    rest = np.linalg.solve(spring + tissue, spring @ tool)
    way = way_of(patch_of(simulation))
    assert np.abs(way - rest).max() < 5e-3 * np.abs(rest).max()
    wrench = frame.wrenches["grasper"]
    np.testing.assert_allclose(wrench[:3], stiffness * (way - tool)[:3], rtol=1e-6)
    twist = angular * (way - tool)[3:]
    np.testing.assert_allclose(wrench[3:], twist, atol=2e-3 * np.abs(twist).max())
    held = simulation.holds.rows
    forces = simulation.model.forces(simulation.state, held)
    np.testing.assert_allclose(wrench[:3], forces.sum(axis=0), atol=2e-3 * np.abs(wrench).max())


def test_the_force_is_the_slope_of_the_energy(tissue: np.ndarray) -> None:
    simulation = simulation_of("finite_element", tool_of(stiffness=2000.0, force_limit=1e3))
    frame_of(simulation, moved((0, 0, 0)), 1)
    middle, step = np.array([3e-3, 0.0, 4e-3]), 1e-3
    wrench = frames(simulation, moved(middle), 100).wrenches["grasper"]
    for axis in range(3):
        energies = []
        for way in (step, -step):
            frames(simulation, moved(middle + way * np.eye(3)[axis]), 60)
            energies.append(energy_of(simulation))
        slope = (energies[0] - energies[1]) / (2 * step)
        assert slope == pytest.approx(-wrench[axis], abs=5e-3 * np.abs(wrench).max())


def test_a_step_is_followed_with_damping_over_stiffness(tissue: np.ndarray) -> None:
    # At 500 Hz a time constant of some 60 ms has some 30 frames: backward Euler errs by 2 %.
    stiffness, damping, rate = 2000.0, 300.0, 500.0
    simulation = simulation_of(
        "finite_element",
        tool_of(stiffness=stiffness, damping=damping, angular_stiffness=STIFF, torque_limit=STIFF),
        rate_hz=rate,
    )
    frame_of(simulation, moved((0, 0, 0)), 1)
    # Responses are learned first; then the tool jumps.
    frames(simulation, moved((2e-3, 2e-3, 2e-3)), 250)
    start = way_of(patch_of(simulation))[:3]
    tool = np.array([0.0, 0.0, 4e-3])
    both = stiffness * np.eye(3) + tissue[:3, :3]
    rest = np.linalg.solve(both, stiffness * tool)
    for number in range(1, 61):
        frame_of(simulation, moved(tool))
        decay = expm(-both * number / (rate * damping))
        wanted = rest + decay @ (start - rest)
        way = way_of(patch_of(simulation))[:3]
        assert np.abs(way - wanted).max() < 0.03 * np.linalg.norm(start - rest)


def test_tissue_whose_answer_is_known_is_followed_with_one_step_a_frame(
    tissue: np.ndarray,
) -> None:
    stiffness = 100.0
    simulation = simulation_of(
        "finite_element",
        tool_of(
            stiffness=stiffness, damping=0.0, angular_stiffness=STIFF, torque_limit=STIFF,
            force_limit=1e3,
        ),
    )  # fmt: skip
    frame_of(simulation, moved((0, 0, 0)), 1)
    for move in np.eye(3):
        frames(simulation, moved(4e-3 * move), 60)
    tool = np.array([3e-3, 2e-3, -4e-3])
    rest = np.linalg.solve(stiffness * np.eye(3) + tissue[:3, :3], stiffness * tool)
    start = np.linalg.norm(way_of(patch_of(simulation))[:3] - rest)
    sample = ToolSample("grasper", moved(tool), 1, True, 0)
    for _ in range(3):
        simulation.advance(FrameInputs(tools=(sample,)), Budget(steps=1))
    # Without what was learned each step would go some 3 % of the way.
    assert np.linalg.norm(way_of(patch_of(simulation))[:3] - rest) < 0.05 * start


def wander(count: int, seed: int) -> list[np.ndarray]:
    """Poses that jump about within 4 mm and 0.2 rad."""
    random = np.random.default_rng(seed)
    return [
        moved(random.uniform(-4e-3, 4e-3, 3), random.uniform(-0.2, 0.2, 3)) for _ in range(count)
    ]


@pytest.mark.parametrize("damping", [0.0, 5.0])
@pytest.mark.parametrize("stiffness", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("model", ALL)
def test_nothing_grows_at_125_poses_a_second(model: str, stiffness: float, damping: float) -> None:
    simulation = simulation_of(
        model,
        tool_of(
            stiffness=stiffness, damping=damping, angular_stiffness=1e-4 * stiffness,
            angular_damping=1e-4 * damping, force_limit=1e5, torque_limit=1e3,
        ),
        rate_hz=125.0,
    )  # fmt: skip
    frame_of(simulation, moved((0, 0, 0)), 1)
    for pose in wander(30, seed=3):
        frame_of(simulation, pose)
        assert np.linalg.norm(way_of(patch_of(simulation))[:3]) < 0.012
    last = moved((2e-3, 1e-3, 3e-3))
    frames(simulation, last, 70)
    before = patch_of(simulation).pose.copy()
    frames(simulation, last, 10)
    if stiffness > 1.0 or damping == 0.0 or simulation.model.has_forces:
        assert np.abs(patch_of(simulation).pose - before).max() < 2e-4
    assert simulation.lost_states == 0


@pytest.mark.parametrize(
    ("model", "parameters"),
    [
        ("finite_element", {"corotated": 1}),
        ("finite_element", {"direct": 1}),
        ("vertex_block_descent", {"dynamic": 1}),
        ("spring_mass", {"integrator": 1, "damping": 0.1}),
        ("spring_mass", {"integrator": 3}),
        ("spring_mass", {"damping": 0.0}),
    ],
)
def test_nothing_grows_in_the_models_variants(model: str, parameters: dict[str, Any]) -> None:
    tool = tool_of(
        stiffness=1e3, damping=0.0, angular_stiffness=0.1, angular_damping=0.0, force_limit=1e5,
        torque_limit=1e3,
    )  # fmt: skip
    simulation = simulation_of(model, tool, rate_hz=125.0, **parameters)
    frame_of(simulation, moved((0, 0, 0)), 1)
    for pose in [*wander(30, seed=3), *[moved((2e-3, 1e-3, 3e-3))] * 60]:
        frame_of(simulation, pose)
        assert np.linalg.norm(way_of(patch_of(simulation))[:3]) < 0.008
    assert simulation.lost_states == 0


@pytest.mark.parametrize("model", ALL)
def test_a_part_cut_free_goes_where_the_spring_pulls_it(model: str) -> None:
    start = np.array([0.05, 0.03, 0.06])
    simulation = simulation_of(model, tool_of(at=start), side=0)
    frame_of(simulation, moved((0, 0, 0), start=start), 1)
    for _ in range(8):
        frame_of(simulation, moved((0, 0, 5e-3), start=start))
    edit = split_edit(simulation.mesh, 0.02)
    assert frame_of(simulation, moved((0, 0, 5e-3), start=start), edits=(edit,)).edits
    for number in range(1, 121):
        lift = 5e-3 + 1e-3 * min(number, 20)
        frame = frame_of(simulation, moved((0, 0, lift), start=start))
    np.testing.assert_allclose(way_of(patch_of(simulation), start)[:3], [0, 0, 0.025], atol=3e-4)
    # Springs alone have not turned the part back quite.
    assert np.abs(frame.wrenches.get("grasper", np.zeros(6))).max() < 0.1
    assert np.abs(simulation.state.displacement).max() < 0.03
    assert simulation.lost_states == 0


def test_the_energy_only_falls_while_the_tool_stands_still() -> None:
    simulation = simulation_of(
        "finite_element", tool_of(stiffness=800.0, damping=0.0, force_limit=1e3)
    )
    frame_of(simulation, moved((0, 0, 0)), 1)
    pose = moved((4e-3, 0, 6e-3), (0, 0.1, 0))
    frames(simulation, moved((1e-3, 2e-3, 1e-3), (0.1, 0, 0.1)), 60)
    # The tool is there already, the tissue has not noticed yet.
    simulation.poses["grasper"] = pose
    energies = [energy_of(simulation)]
    for _ in range(60):
        frame_of(simulation, pose)
        energies.append(energy_of(simulation))
    assert np.diff(energies).max() < 1e-5 * energies[0]
    assert energies[-1] < 0.9 * energies[0]


@pytest.mark.parametrize("model", ALL)
def test_the_spring_gives_way_at_its_limit(model: str) -> None:
    simulation = simulation_of(model, tool_of(stiffness=1e4, force_limit=2.0))
    frame_of(simulation, moved((0, 0, 0)), 1)
    frame = frames(simulation, moved((0, 0, 0.03)), 150)
    if not simulation.model.has_forces:
        assert frame.wrenches == {}
        np.testing.assert_allclose(way_of(patch_of(simulation))[:3], [0, 0, 0.03], atol=1e-6)
        return
    wrench = frame.wrenches["grasper"]
    assert np.linalg.norm(wrench[:3]) == pytest.approx(2.0)
    forces = simulation.model.forces(simulation.state, simulation.holds.rows)
    assert np.linalg.norm(forces.sum(axis=0)) == pytest.approx(2.0, rel=0.02)
    assert 0.0 < way_of(patch_of(simulation))[2] < 0.01


@pytest.mark.parametrize("model", ["relaxation", "chain_mail"])
def test_tissue_without_forces_follows_and_says_so(model: str) -> None:
    simulation = simulation_of(model, tool_of(stiffness=300.0, damping=30.0))
    frame = frame_of(simulation, moved((0, 0, 0)), 1)
    assert "holds by force" in frame.events[0]
    assert f"{model} has no forces" in frame.events[0]
    for number in range(1, 31):
        frame = frame_of(simulation, moved((0, 0, 4e-3)))
        # Backward Euler with a time constant of damping over stiffness.
        wanted = 4e-3 * (1.0 - (1.0 + 300.0 / 30.0 / 60.0) ** -number)
        assert way_of(patch_of(simulation))[2] == pytest.approx(wanted, rel=1e-6)
        assert frame.wrenches == {}


def test_releasing_and_grabbing_again_begins_without_a_force() -> None:
    simulation = simulation_of("finite_element")
    frame_of(simulation, moved((0, 0, 0)), 1)
    frame = frames(simulation, moved((0, 0, 8e-3)), 60)
    assert frame.wrenches["grasper"][2] < -0.5
    frame_of(simulation, moved((0, 0, 0)), -1)
    frames(simulation, moved((0, 0, 0)), 60)
    assert np.abs(simulation.state.displacement).max() < 1e-6
    again = frame_of(simulation, moved((0, 0, 0)), 1)
    assert np.abs(again.wrenches["grasper"]).max() < 1e-3
    again = frames(simulation, moved((0, 0, 8e-3)), 60)
    np.testing.assert_allclose(again.wrenches["grasper"], frame.wrenches["grasper"], atol=1e-3)


def test_tools_hold_in_different_ways_at_once_and_take_over_without_a_jump() -> None:
    spots = {"left": TOP, "right": np.add(TOP, (0.015, 0.0, 0.0))}
    simulation = simulation_of(
        "finite_element",
        tool_of("left", hold=POSITION, at=spots["left"]),
        replace(tool_of("right", at=spots["right"]), size=(0.02,)),
    )

    def both(lift: float, edge: Edge = 0) -> Frame:
        samples = tuple(
            ToolSample(name, moved((0, 0, lift), start=at), 1, True, edge)
            for name, at in spots.items()
        )
        return simulation.advance(FrameInputs(tools=samples), Budget(steps=8))

    both(0.0, 1)
    left, right = simulation.holds.by_id.values()
    assert len(right.rows)
    assert len(right.waiting)
    for number in range(1, 61):
        frame = both(6e-3 * min(number / 20, 1.0))
    u = simulation.state.displacement
    np.testing.assert_allclose(u[left.rows], np.tile([0, 0, 6e-3], (len(left.rows), 1)), atol=1e-8)
    assert 0 < way_of(patch_of(simulation), spots["right"])[2] < 5.9e-3
    assert set(frame.wrenches) == {"left", "right"}
    waiting, before = right.waiting.copy(), u.copy()
    pose = simulation.poses["left"]
    sample = ToolSample("left", pose, 1, False, -1)
    simulation.advance(FrameInputs(tools=(sample,)), Budget(steps=0))
    assert np.isin(waiting, right.rows).all()
    np.testing.assert_allclose(simulation.state.displacement[waiting], before[waiting], atol=1e-8)
    for _ in range(100):
        frame = simulation.advance(FrameInputs(), Budget(steps=8))
    assert set(frame.wrenches) == {"right"}
    forces = simulation.model.forces(simulation.state, right.rows).sum(axis=0)
    np.testing.assert_allclose(frame.wrenches["right"][:3], forces, atol=5e-3)


def test_a_stiffer_coupling_takes_effect_on_what_is_held() -> None:
    simulation = simulation_of("finite_element", tool_of(stiffness=200.0))
    frame_of(simulation, moved((0, 0, 0)), 1)
    soft = frames(simulation, moved((0, 0, 5e-3)), 80)
    stiffer = tool_of(stiffness=5000.0).as_arguments()
    frame_of(simulation, moved((0, 0, 5e-3)), commands=(Command("set_tool", stiffer),))
    stiff = frames(simulation, moved((0, 0, 5e-3)), 80)
    assert stiff.wrenches["grasper"][2] < 2 * soft.wrenches["grasper"][2] < 0
    del stiffer["hold"], stiffer["coupling"]
    frame_of(simulation, moved((0, 0, 5e-3)), commands=(Command("set_tool", stiffer),))
    assert simulation.tools["grasper"].coupling.stiffness == 5000.0
    assert simulation.tools["grasper"].hold == FORCE


def test_a_lost_state_takes_the_patch_back_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = simulation_of("vertex_block_descent")
    frame_of(simulation, moved((0, 0, 0)), 1)
    frames(simulation, moved((0, 0, 5e-3)), 20)
    before, pose = simulation.state.displacement.copy(), patch_of(simulation).pose.copy()
    with monkeypatch.context() as broken:
        broken.setattr(
            simulation.model, "step", lambda state: state.displacement.fill(np.nan), raising=True
        )
        frame = frame_of(simulation, moved((0, 0, 9e-3)))
    assert frame.lost
    np.testing.assert_array_equal(simulation.state.displacement, before)
    np.testing.assert_array_equal(patch_of(simulation).pose, pose)
    frames(simulation, moved((0, 0, 5e-3)), 20)
    assert simulation.lost_states == 1


@pytest.mark.parametrize("model", ["finite_element", "lr", "spring_mass"])
def test_a_journal_repeats_a_hold_by_force_bit_by_bit(model: str) -> None:
    simulation = simulation_of(model, tool_of(stiffness=900.0))
    entries = [frame_of(simulation, moved((0, 0, 0)), 1).journal]
    for number, pose in enumerate(wander(24, seed=5)):
        inputs: dict[str, Any] = {}
        if number == 8:
            inputs["edits"] = (split_edit(simulation.mesh, 0.02, above=0.03),)
        if number in (12, 14):
            inputs["commands"] = (Command("pause", {"on": number == 12}),)
        if number == 16:
            other = "lr" if model != "lr" else "finite_element"
            inputs["commands"] = (Command("set_model", {"model": other, "parameters": {}}),)
        if number == 20:
            inputs["commands"] = (Command("set_tool", tool_of(stiffness=70.0).as_arguments()),)
        entries.append(frame_of(simulation, pose, **inputs).journal)
    assert simulation.mesh.version == 2
    raw = block(4, 4, 4)
    again = replay(entries, Mesh(raw, raw.points[:, 2] < 1e-9))
    assert again.mismatches == ()
    np.testing.assert_array_equal(again.simulation.holds.patches[0].pose, patch_of(simulation).pose)


def test_a_saved_organ_is_grabbed_again_where_it_was(tmp_path: Path) -> None:
    simulation = simulation_of("finite_element")
    frame_of(simulation, moved((0, 0, 0)), 1)
    frames(simulation, moved((0, 0, 8e-3)), 60)
    snapshot.save(snapshot.take(simulation.mesh, simulation.state.displacement), tmp_path, "pulled")
    loaded = snapshot.load(tmp_path, "pulled")
    scene = Scene.from_arguments(simulation.scene.as_arguments())
    assert scene.tools == simulation.scene.tools
    tools = scene.tools
    again = Simulation(
        loaded.mesh(),
        Scene(model="finite_element", tools=tools, displacement=loaded.displacement),
    )
    rows = again.mesh.node_rows
    np.testing.assert_array_equal(
        again.state.displacement[:rows], simulation.state.displacement[:rows]
    )
    assert len(again.holds) == 0
    # The tip is put where the patch is: the same nodes are held, and nothing pulls yet.
    pose = patch_of(simulation).pose.copy()
    frame = again.advance(
        FrameInputs(tools=(ToolSample("grasper", pose, 1, True, 1),)), Budget(steps=0)
    )
    np.testing.assert_array_equal(again.holds.rows, simulation.holds.rows)
    np.testing.assert_allclose(frame.wrenches["grasper"], 0.0, atol=1e-12)


@pytest.mark.parametrize("second", ALL)
@pytest.mark.parametrize("first", ALL)
def test_a_model_takes_over_a_hold_by_force_after_a_cut(first: str, second: str) -> None:
    simulation = simulation_of(first, tool_of(stiffness=1500.0))
    pose = moved((2e-3, 0, 6e-3))
    frame_of(simulation, moved((0, 0, 0)), 1)
    frames(simulation, pose, 8)
    frame_of(simulation, pose, edits=(split_edit(simulation.mesh, 0.02, above=0.03),))
    frames(simulation, pose, 4)
    assert simulation.mesh.version == 2
    before, where = simulation.state.displacement.copy(), patch_of(simulation).pose.copy()
    switch = FrameInputs((Command("set_model", {"model": second, "parameters": {}}, "switch"),))
    frame = simulation.advance(switch, Budget(steps=0))
    assert frame.answers[0].success
    assert any("has no forces" in event for event in frame.events) != simulation.model.has_forces
    np.testing.assert_array_equal(simulation.state.displacement, before)
    np.testing.assert_array_equal(patch_of(simulation).pose, where)
    simulation.advance(FrameInputs(), Budget(steps=1))
    assert np.linalg.norm((patch_of(simulation).pose - where)[:3]) < np.linalg.norm(pose[:3] - TOP)
    frame = frames(simulation, pose, 120)
    left = pose[:3] - patch_of(simulation).pose[:3]
    if not simulation.model.has_forces:
        assert np.abs(left).max() < 1e-6
    else:
        np.testing.assert_allclose(frame.wrenches["grasper"][:3], -1500.0 * left, rtol=1e-9)
        forces = simulation.model.forces(simulation.state, simulation.holds.rows).sum(axis=0)
        np.testing.assert_allclose(1500.0 * left, -forces, atol=0.02 * np.abs(forces).max())
    (hold,) = simulation.holds.by_id.values()
    places = simulation.mesh.rest[hold.rows] + simulation.state.displacement[hold.rows]
    np.testing.assert_allclose(
        places, rigid.to_world(patch_of(simulation).pose, hold.local), atol=1e-8
    )
    assert simulation.lost_states == 0
