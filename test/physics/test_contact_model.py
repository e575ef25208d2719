"""What a contact model says near a tool is what the tool's force does there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tissue_sim.frame import Budget, Command, Edge, FrameInputs, ToolSample
from tissue_sim.geometry import scene_geometry
from tissue_sim.interaction import rigid
from tissue_sim.interaction.contact import Contact
from tissue_sim.interaction.contact_model import ContactModel, ContactModels
from tissue_sim.interaction.contact_parts import blade_parts, in_series, probe_parts, turned
from tissue_sim.interaction.coupling import Coupling
from tissue_sim.interaction.probes import Pressed
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

SIZES = {"nodes_x": 6, "nodes_y": 6, "nodes_z": 6, "size_x": 0.05, "size_y": 0.05, "size_z": 0.05}
RADIUS = 0.012
RIGID = Contact(contact_stiffness=2e7, contact_damping=2e4, contact_friction=0.3)
Reals = NDArray[np.float64]


def assert_passive(model: ContactModel) -> None:
    for matrix in (model.stiffness, model.damping):
        scale = max(float(np.abs(matrix).max()), 1e-30)
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * scale)
        assert np.linalg.eigvalsh(matrix).min() >= -1e-9 * scale


# A sphere against a flat wall whose nodes do not give way


def flat_wall(tip: Reals, spacing: float = 0.0005) -> tuple[Pressed, float]:
    """Nodes of the half space z < 0 inside a sphere at the tip, and the surface of each."""
    across = np.arange(-0.02, 0.0201, spacing)
    places = np.array([[x, y, 0.0] for x in across for y in across])
    way = places - tip
    far = np.linalg.norm(way, axis=1)
    inside = far < RADIUS
    way, far = way[inside], far[inside]
    area = np.full(len(far), spacing**2)
    pressed = Pressed(places[inside], way / far[:, None], RADIUS - far, np.zeros_like(way), area)
    return pressed, spacing**2


def force_at(tip: Reals) -> Reals:
    """Force of the wall on the sphere, straight from the law."""
    pressed, area = flat_wall(tip)
    push = area * RIGID.contact_stiffness * pressed.depth
    return -(push[:, None] * pressed.normal).sum(axis=0)


def test_a_sphere_on_a_flat_wall_is_as_stiff_as_finite_differences_say() -> None:
    """All of it but what its force does by turning with the normal, which is not positive."""
    tip = np.array([0.0, 0.0, RADIUS - 0.0015])
    pressed, area = flat_wall(tip)
    wrench, stiffness, _ = probe_parts(
        pressed, replace(RIGID, contact_friction=0.0), tip, np.zeros(6)
    )
    np.testing.assert_allclose(wrench[:3], force_at(tip), rtol=1e-12)
    push = area * RIGID.contact_stiffness * pressed.depth
    around = np.eye(3) - pressed.normal[:, :, None] * pressed.normal[:, None, :]
    turning = -(push / (RADIUS - pressed.depth))[:, None, None] * around
    measured = np.zeros((3, 3))
    for axis in range(3):
        step = 1e-7 * np.eye(3)[axis]
        measured[:, axis] = -(force_at(tip + step) - force_at(tip - step)) / 2e-7
    np.testing.assert_allclose(stiffness[:3, :3] + turning.sum(axis=0), measured, atol=1e-4 * 500)
    assert np.linalg.eigvalsh(turning.sum(axis=0)).max() <= 0.0
    # The integrals of kappa (R - r) c / r and kappa c^2 / r^2 over the disc, c above the wall.
    c, p = tip[2], RADIUS - tip[2]
    kappa = RIGID.contact_stiffness
    assert wrench[2] == pytest.approx(kappa * np.pi * c * p * p, rel=0.02)
    assert stiffness[2, 2] == pytest.approx(
        kappa * np.pi * c * c * np.log((RADIUS / c) ** 2), rel=0.02
    )


def test_what_sticks_is_a_spring_and_what_slides_a_damper_with_coulombs_force() -> None:
    tip = np.array([0.0, 0.0, RADIUS - 0.0015])
    pressed, area = flat_wall(tip)
    speed = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    stuck, sticky, plain = probe_parts(pressed, RIGID, tip, speed)
    assert sticky[0, 0] > sticky[2, 2] * 0.9
    push = area * RIGID.contact_stiffness * pressed.depth
    normal = pressed.normal
    slip = np.tile([-0.01, 0.0, 0.0], (len(normal), 1))
    slip -= np.einsum("ij,ij->i", slip, normal)[:, None] * normal
    sliding = replace(pressed, slip=slip)
    slid, smooth, rough = probe_parts(sliding, RIGID, tip, speed)
    np.testing.assert_allclose(slid, stuck, atol=1e-12)
    assert smooth[0, 0] < 0.1 * sticky[0, 0]
    drag = (rough - plain) @ speed
    assert drag[0] == pytest.approx(RIGID.contact_friction * push.sum(), rel=0.05)
    for matrix in (sticky, smooth, plain, rough):
        assert np.linalg.eigvalsh(matrix).min() > -1e-9 * np.abs(matrix).max()


# Couplings and blades


def test_a_coupling_and_the_tissue_behind_it_are_springs_in_series() -> None:
    coupling = Coupling(stiffness=500.0, damping=5.0)
    spring = coupling.tangent(rigid.IDENTITY, rigid.IDENTITY)
    tissue = np.diag([200.0] * 3 + [0.02] * 3)
    stiffness, damping = in_series(spring, tissue, coupling)
    assert stiffness[0, 0] == pytest.approx(500.0 * 200.0 / 700.0, rel=1e-6)
    assert stiffness[3, 3] == pytest.approx(0.05 * 0.02 / 0.07, rel=1e-6)
    # The imaginary part of Z = K (S + i w B) / (K + S + i w B), over w, as w goes to 0.
    w = 1e-4
    z = 500.0 * (200.0 + 5.0j * w) / (700.0 + 5.0j * w)
    assert damping[0, 0] == pytest.approx(z.imag / w, rel=1e-6)
    nothing = np.zeros((6, 6))
    assert np.abs(in_series(spring, nothing, coupling)[0]).max() < 1e-5
    np.testing.assert_allclose(
        in_series(spring, nothing, coupling)[1], np.diag([5.0] * 3 + [5e-4] * 3), rtol=1e-6
    )


def test_a_spring_at_its_limit_gives_way_along_its_force() -> None:
    coupling = Coupling(force_limit=1.0)
    pose = np.array([0.003, 0.004, 0.0, 0.0, 0.0, 0.0, 1.0])
    tangent = coupling.tangent(pose, rigid.IDENTITY)
    for axis in range(3):
        step = np.zeros(7)
        step[axis] = 1e-8
        change = coupling.wrench_on_tool(pose + step, rigid.IDENTITY)
        change -= coupling.wrench_on_tool(pose - step, rigid.IDENTITY)
        np.testing.assert_allclose(tangent[:3, axis], -change[:3] / 2e-8, atol=1e-4)
    assert np.linalg.norm(tangent[:3, :3] @ pose[:3]) < 1e-9


def test_a_blade_feels_its_resistance_while_it_moves_and_nothing_at_rest() -> None:
    velocity = np.array([0.02, 0.0, -0.01, 0.0, 0.3, 0.0])
    resistance = np.array([-1.0, 0.1, 0.6, 0.001, -0.002, 0.0])
    wrench, stiffness, damping = blade_parts(resistance, velocity)
    assert not wrench.any()
    assert not stiffness.any()
    np.testing.assert_allclose(-damping @ velocity, resistance, rtol=1e-12)
    assert not blade_parts(resistance, np.zeros(6))[2].any()
    assert not blade_parts(resistance, -velocity)[2].any()


# Beside a simulation


def simulation_of(model: str, tool: ToolSpec) -> Simulation:
    parameters = {model: {"levels": 1000.0}} if model in ("lr", "quasi_static") else {}
    mesh = scene_geometry.load("block", parameters=SIZES).mesh
    return Simulation(mesh, Scene(model=model, parameters=parameters, tools=(tool,)))


def run(
    simulation: Simulation, poses: list[Reals], contacts: ContactModels | None, steps: int = 20
) -> tuple[list[ContactModel], list[int]]:
    """Contact models and checksums of frames of a tool that is in use from the first."""
    models, checksums = [], []
    for k, pose in enumerate(poses):
        edge: Edge = 1 if k == 0 else 0
        samples = (ToolSample("tool", pose, 0, True, edge),)
        frame = simulation.advance(FrameInputs(tools=samples), Budget(steps=steps))
        checksums.append(frame.journal.crc32)
        if contacts is not None:
            models.append(contacts.of(simulation, "tool"))
    return models, checksums


def pulled(way: Reals, frames: int, still: int) -> list[Reals]:
    start = np.array([0.025, 0.025, 0.05, 0.0, 0.0, 0.0, 1.0])
    return [
        start + np.concatenate([way * min(1.0, k / frames), np.zeros(4)])
        for k in range(frames + still)
    ]


TOOLS = {
    "probe": ToolSpec("tool", kind="probe", shape="sphere", size=(RADIUS,)),
    "force": ToolSpec("tool", size=(0.013,), hold="force"),
    "position": ToolSpec("tool", size=(0.013,)),
}


@pytest.mark.parametrize("kind", TOOLS)
def test_feeling_changes_nothing(kind: str) -> None:
    """Sessions are the same bit by bit whether somebody asks for contact models or not."""
    offset = np.array([0.0, 0.0, RADIUS if kind == "probe" else 0.0, 0.0, 0.0, 0.0, 0.0])
    poses = [pose + offset for pose in pulled(np.array([0.002, 0.001, -0.003]), 8, 4)]
    alone = run(simulation_of("lr", TOOLS[kind]), poses, None, 3)[1]
    models, felt = run(simulation_of("lr", TOOLS[kind]), poses, ContactModels(), 3)
    assert felt == alone
    assert models[-1].contact
    for model in models:
        assert_passive(model)
        assert model.valid_for == pytest.approx(0.1)


def test_a_probes_model_is_the_force_it_feels() -> None:
    """At rest, where all nodes stick, and without contact it is zero."""
    sticky = replace(TOOLS["probe"], contact=replace(RIGID, contact_friction=1.0))
    simulation, contacts = simulation_of("quasi_static", sticky), ContactModels()
    offset = np.array([0.0, 0.0, RADIUS, 0.0, 0.0, 0.0, 0.0])
    poses = [pose + offset for pose in pulled(np.array([0.0, 0.0, -0.003]), 10, 60)]
    model = run(simulation, poses, contacts)[0][-1]
    felt = simulation.probes.wrench("tool", poses[-1], simulation.state)
    np.testing.assert_allclose(model.wrench[:3], felt[:3], atol=0.01 * abs(felt[2]))
    assert model.reach == RADIUS
    away = run(simulation, [poses[0] + [0, 0, 0.1, 0, 0, 0, 0]], contacts)[0][-1]
    assert not away.contact
    assert not away.wrench.any()
    assert not away.stiffness.any()


def test_a_hold_by_position_learns_how_stiff_the_tissue_is() -> None:
    """First as stiff as with everything else still, then what a motion has shown."""
    simulation, contacts = simulation_of("finite_element", TOOLS["position"]), ContactModels()
    along = np.array([0.6, 0.0, 0.8])
    models = run(simulation, pulled(0.003 * along, 6, 6), contacts, 40)[0]
    np.testing.assert_allclose(models[0].wrench, 0.0, atol=1e-6)
    change = models[-1].wrench[:3] - models[0].wrench[:3]
    measured = -float(change @ along) / 0.003
    sensed, learned = (float(along @ models[k].stiffness[:3, :3] @ along) for k in (0, -1))
    assert learned == pytest.approx(measured, rel=0.02)
    assert sensed > 1.5 * measured


def test_without_forces_nothing_is_felt() -> None:
    simulation = simulation_of("relaxation", TOOLS["position"])
    models, _ = run(simulation, pulled(np.array([0.0, 0.0, 0.004]), 4, 2), ContactModels())
    assert not any(model.contact for model in models)


def test_a_model_is_given_in_the_organs_axes() -> None:
    turn = rigid.from_matrix(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    pose = np.concatenate([[0.1, 0.2, 0.3], turn])
    np.testing.assert_allclose(
        turned(np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), pose),
        np.diag([2.0, 1.0, 3.0, 5.0, 4.0, 6.0]), atol=1e-12,
    )  # fmt: skip


def test_an_edit_is_felt_at_once() -> None:
    """After another model the tissue is sensed anew, and nothing of the old one remains."""
    simulation, contacts = simulation_of("finite_element", TOOLS["position"]), ContactModels()
    poses = pulled(np.array([0.0, 0.0, 0.003]), 4, 4)
    run(simulation, poses, contacts)
    command = Command("set_model", {"model": "quasi_static"}, "1")
    simulation.advance(FrameInputs(commands=(command,)), Budget(steps=5))
    fresh = contacts.of(simulation, "tool")
    again = ContactModels().of(simulation, "tool")
    np.testing.assert_allclose(fresh.stiffness, again.stiffness, rtol=1e-9, atol=1e-9)
