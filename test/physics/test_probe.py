"""Probes push tissue: balance, friction, passivity and what happens at the edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import fsolve

from tissue_sim.elastic.registry import MODELS
from tissue_sim.frame import Budget, Edge, Frame, FrameInputs, ToolSample
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.surface import surface_triangles
from tissue_sim.interaction.contact import Contact
from tissue_sim.interaction.tools import ToolError, ToolSpec
from tissue_sim.journal import replay
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

RADIUS = 0.012
PROBE = ToolSpec("probe", kind="probe", shape="sphere", size=(RADIUS,))
SIZES = {"nodes_x": 6, "nodes_y": 6, "nodes_z": 6, "size_x": 0.05, "size_y": 0.05, "size_z": 0.05}
WITH_FORCES = ("quasi_static", "lr", "spring_mass", "vertex_block_descent", "finite_element")
WHOLE = {"levels": 1000.0}


def simulation_of(model: str, tool: ToolSpec = PROBE) -> Simulation:
    values = {model: dict(WHOLE)} if model in ("quasi_static", "lr", "vertex_block_descent") else {}
    mesh = scene_geometry.load("block", parameters=SIZES).mesh
    return Simulation(mesh, Scene(model=model, parameters=values, tools=(tool,)))


def above(depth: float, across: float = 0.0) -> NDArray[np.float64]:
    """A pose of a sphere over the middle of the block's upper side, so deep in it."""
    return np.array([across, 0.0, 0.05 + RADIUS - depth, 0, 0, 0, 1.0]) + np.array(
        [0.025, 0.025, 0, 0, 0, 0, 0]
    )


def pushed(
    simulation: Simulation, poses: list[NDArray[np.float64]], steps: int = 30, pressed: bool = False
) -> Frame:
    """The last frame of a probe in use that goes through poses."""
    for k, pose in enumerate(poses):
        edge: Edge = 1 if k == 0 and not pressed else 0
        samples = (ToolSample("probe", pose, 0, True, edge),)
        budget = Budget() if simulation.model.time_step is not None else Budget(steps=steps)
        frame = simulation.advance(FrameInputs(tools=samples), budget)
    assert not frame.lost
    return frame


def ramp(depth: float, frames: int = 20, still: int = 80) -> list[NDArray[np.float64]]:
    return [above(depth * min(1.0, k / frames)) for k in range(frames + still)]


@pytest.mark.parametrize("model", WITH_FORCES)
def test_contact_and_tissue_are_in_balance(model: str) -> None:
    """What the probe feels is what the fixed side carries, and every node's forces cancel."""
    simulation = simulation_of(model)
    frame = pushed(simulation, ramp(0.004))
    rows, touch = simulation.probes.rows, simulation.probes.touches["probe"]
    assert len(rows) >= 4
    internal = simulation.model.forces(simulation.state, rows)
    most = np.linalg.norm(touch.force, axis=1).max()
    assert np.linalg.norm(internal + touch.force, axis=1).max() < 0.03 * most
    assert frame.wrenches["probe"][2] > 0.0
    fixed = np.flatnonzero(simulation.mesh.fixed[: simulation.mesh.node_rows]).astype(np.int32)
    carried = simulation.model.forces(simulation.state, fixed).sum(axis=0)
    assert frame.wrenches["probe"][2] == pytest.approx(-carried[2], rel=0.05) or (
        frame.wrenches["probe"][2] == pytest.approx(carried[2], rel=0.05)
    )


def test_the_balance_is_that_of_an_independent_solution() -> None:
    """Linear finite elements as a dense matrix, the contact's law as written, solved by scipy."""
    tool = replace(PROBE, contact=Contact(contact_damping=0.0, contact_friction=0.0))
    simulation = simulation_of("finite_element", tool)
    pushed(simulation, ramp(0.003, still=300))
    rows = simulation.probes.rows
    count = simulation.mesh.node_rows
    free = np.flatnonzero(~simulation.mesh.fixed[:count])
    unit = simulation.state.displacement.copy()
    stiffness = np.zeros((3 * len(free), 3 * len(free)))
    for column in range(3 * len(free)):
        simulation.state.displacement[:] = 0.0
        simulation.state.displacement[free[column // 3], column % 3] = 1e-4
        f = simulation.model.forces(simulation.state, free.astype(np.int32))
        stiffness[:, column] = -f.ravel() / 1e-4
    simulation.state.displacement[:] = unit
    touch = simulation.probes.touches["probe"]
    pose, rest = above(0.003), simulation.mesh.rest
    own = {int(row): area for row, area in zip(rows, touch.area, strict=True)}
    in_contact = np.searchsorted(free, rows)

    def unbalanced(u: NDArray[np.float64]) -> NDArray[np.float64]:
        total = (-stiffness @ u).reshape(-1, 3)
        for place, row in zip(in_contact, rows, strict=True):
            way = rest[row] + u.reshape(-1, 3)[place] - pose[:3]
            gap = np.linalg.norm(way) - RADIUS
            pressure = max(0.0, -tool.contact.contact_stiffness * gap)
            total[place] += own[int(row)] * pressure * way / np.linalg.norm(way)
        return total.ravel()

    ours = unit[free].astype(np.float64).ravel()
    solved = fsolve(unbalanced, ours, xtol=1e-12)
    assert np.abs(solved - ours).max() < 0.01 * np.abs(solved).max()


def test_the_surface_of_nodes_adds_up_to_the_organs() -> None:
    from tissue_sim.kernels.contact import surface_at

    mesh = scene_geometry.load("block", parameters=SIZES).mesh
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    area, shape = np.empty(len(rows)), np.empty(len(rows))
    incident = mesh.incident
    surface_at(
        rows, mesh.tets, incident.start, incident.count, incident.data, mesh.rest, area, shape
    )
    assert area.sum() == pytest.approx(6 * 0.05**2, rel=1e-9)
    inside = np.ones(len(rows), dtype=np.bool_)
    inside[np.unique(surface_triangles(mesh))] = False
    assert (area[inside] == 0.0).all()
    assert (area[~inside] > 0.0).all()


@pytest.mark.parametrize("model", sorted(set(MODELS) - set(WITH_FORCES)))
def test_without_forces_tissue_lies_on_the_probe(model: str) -> None:
    simulation = simulation_of(model)
    frame = pushed(simulation, ramp(0.003, still=5))
    assert len(simulation.probes.rows) > 0
    assert simulation.probes.touches["probe"].gap.min() > -2e-3
    assert "probe" not in frame.wrenches


def test_friction_is_coulombs() -> None:
    """Pushed aside it sticks at first, then slides with the friction times the normal force."""
    for friction in (0.0, 0.3):
        tool = replace(PROBE, contact=Contact(contact_friction=friction))
        simulation = simulation_of("quasi_static", tool)
        pushed(simulation, ramp(0.003))
        aside = [above(0.003, across=0.006 * k / 60) for k in range(60)]
        wrench = pushed(simulation, aside, pressed=True).wrenches["probe"]
        touch = simulation.probes.touches["probe"]
        rows = touch.rows
        places = simulation.mesh.rest[rows] + simulation.state.displacement[rows]
        normal = places - aside[-1][:3]
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        along = np.einsum("ij,ij->i", touch.force, normal)
        across = np.linalg.norm(touch.force - along[:, None] * normal, axis=1)
        # Directions are those after the last step, forces those before it.
        assert (across <= (friction + 1e-3) * along).all()
        if friction:
            assert wrench[0] < -0.05 * abs(wrench[2])


def test_pressing_and_letting_go_gains_no_energy() -> None:
    """Work of the tool over cycles of pressing is never negative: the contact is passive."""
    simulation = simulation_of("quasi_static")
    work, before = 0.0, above(0.0)
    pushed(simulation, [before])
    for k in range(1, 241):
        pose = above(0.002 * (1.0 - np.cos(2 * np.pi * k / 60)))
        frame = pushed(simulation, [pose], pressed=True)
        force = frame.wrenches["probe"][:3]
        work -= float(force @ (pose[:3] - before[:3]))
        before = pose
        assert work > -1e-6
    assert work >= 0.0


def test_released_tissue_returns_and_nothing_is_held() -> None:
    simulation = simulation_of("quasi_static")
    pushed(simulation, ramp(0.004))
    sample = ToolSample("probe", above(0.004), 0, False, -1)
    simulation.advance(FrameInputs(tools=(sample,)), Budget(steps=30))
    assert len(simulation.probes.rows) == 0
    for _ in range(300):
        simulation.advance(FrameInputs(), Budget(steps=30))
    assert np.abs(simulation.state.displacement).max() < 1e-6


def test_a_probe_replays_bit_for_bit() -> None:
    simulation = simulation_of("lr")
    entries = []
    for k, pose in enumerate(ramp(0.004, still=10)):
        samples = (ToolSample("probe", pose, 0, True, 1 if k == 0 else 0),)
        entries.append(simulation.advance(FrameInputs(tools=samples), Budget(steps=3)).journal)
    again = replay(entries, scene_geometry.load("block", parameters=SIZES).mesh)
    assert again.mismatches == ()


def test_a_jump_into_the_tissue_is_survived() -> None:
    simulation = simulation_of("quasi_static")
    pushed(simulation, [above(-0.05), above(0.02), above(0.02), above(-0.05), above(0.01)])
    assert np.isfinite(simulation.state.displacement).all()
    assert simulation.lost_states == 0


def test_a_capsule_presses_along_its_length() -> None:
    lying = ToolSpec("probe", kind="probe", shape="capsule", size=(0.006, 0.04))
    simulation = simulation_of("quasi_static", lying)
    turn = np.array([0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)])  # its axis along x
    pose = np.concatenate([[0.005, 0.02, 0.05 + 0.006 - 0.002], turn])
    pushed(simulation, [pose] * 20)
    touched = simulation.mesh.rest[simulation.probes.rows]
    assert np.ptp(touched[:, 0]) > 0.025


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shape": "rectangle", "size": (0.01, 0.01)}, "allowed: sphere, capsule"),
        ({"shape": "capsule"}, "radius, length along z"),
        ({"contact": Contact(contact_stiffness=0.0)}, "contact_stiffness = 0 is out of range"),
        ({"contact": Contact(contact_friction=-1.0)}, "contact_friction = -1 is out of range"),
    ],
)
def test_bad_probes_are_refused(change: dict, message: str) -> None:
    with pytest.raises(ToolError, match=message):
        replace(PROBE, **change).checked()
