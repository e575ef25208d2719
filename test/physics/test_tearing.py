"""Tissue that is pulled until it tears, with finite elements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cut_service.planner import Settings, plan
from cut_service.sweep import Sweep
from cut_service.tearing import Tear, TearSettings, plan_tear
from cut_service.unswept import work_without_sweep
from support.valid_mesh import check_valid
from tissue_sim.elastic.material_field import MaterialField
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.stress import element_material
from tissue_sim.frame import Budget, Edge, FrameInputs, ToolSample
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

HEIGHT, SIDE, THICK = 0.06, 0.03, 0.01
NOTCH = 0.030
MATERIAL = Material(young_modulus=5e4, poisson_ratio=0.3)
GRIP = ToolSpec(
    "grip", pose=(SIDE / 2, THICK / 2, HEIGHT + 0.05, 0.0, 0.0, 0.0, 1.0), size=(0.055,)
)


def notched() -> Simulation:
    """A strip held at its bottom, with a notch across a third of its width in the middle."""
    raw = block(7, 3, 13, SIDE, THICK, HEIGHT)
    fixed = np.zeros(len(raw.points), dtype=np.bool_)
    fixed[raw.node_sets["fixed"]] = True
    mesh = Mesh(raw, fixed)
    corners = [[-1.0, -1.0, NOTCH], [0.011, -1.0, NOTCH], [0.011, 1.0, NOTCH], [-1.0, 1.0, NOTCH]]
    sweep = Sweep.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])
    rest = mesh.rest[: mesh.node_rows]
    mesh.apply(plan(mesh, rest, sweep, settings=Settings(snap=False)).edit)
    scene = Scene(
        model="finite_element", material=MATERIAL, tools=(GRIP.checked(),),
        parameters={"finite_element": {"corotated": 1.0}},
    )  # fmt: skip
    return Simulation(mesh, scene)


def advance(
    simulation: Simulation, pull: float, edits: tuple[TopologyEdit, ...] = (), edge: Edge = 0
) -> None:
    pose = np.array(GRIP.pose)
    pose[2] += pull
    sample = ToolSample("grip", pose, 1, True, edge)
    frame = simulation.advance(FrameInputs(edits=edits, tools=(sample,)), Budget(steps=60))
    assert all(answer.success for answer in frame.answers)


def look(simulation: Simulation, threshold: float) -> Tear:
    mesh = simulation.mesh
    held = mesh.node_ids[simulation.holds.rows]
    work = work_without_sweep(mesh, simulation.state.positions(mesh), held)
    return plan_tear(work, element_material(MaterialField(mesh, MATERIAL)), TearSettings(threshold))


def test_a_notched_strip_tears_across_the_plane_of_the_notch_into_two() -> None:
    simulation = notched()
    advance(simulation, 0.0, edge=1)
    assert len(simulation.holds.rows) >= 21
    before = check_valid(simulation.mesh)
    threshold, pull, first, torn = 2.5e4, 0.0, None, []
    for _ in range(150):
        found = look(simulation, threshold)
        edits: tuple[TopologyEdit, ...] = ()
        if found.edit is None:
            pull += 0.0005
        else:
            first = pull if first is None else first
            torn.append(found.corners)
            edits = (replace(found.edit, request_id=f"tear-{len(torn)}"),)
        advance(simulation, pull, edits)
        advance(simulation, pull)
        if torn and check_valid(simulation.mesh).components == 2:
            break
    after = check_valid(simulation.mesh)
    assert after.components == 2
    assert after.volume == before.volume
    assert first is not None
    # Without a notch it would bear a pull of threshold / E times its height.
    assert 0.0 < first < 0.7 * threshold / MATERIAL.young_modulus * HEIGHT
    # The crack runs in the plane of the notch, at most one row of elements beside it.
    copies = np.flatnonzero(simulation.mesh.node_parents != simulation.mesh.node_ids)
    copies = copies[copies < simulation.mesh.node_rows]
    height = simulation.mesh.rest[copies, 2]
    assert np.abs(height - NOTCH).max() <= 0.0051
    assert np.mean(np.abs(height - NOTCH) < 1e-9) > 0.8
    # Torn apart, nothing pulls any more.
    for _ in range(20):
        advance(simulation, pull)
    assert look(simulation, threshold).over == 0


def test_a_strip_that_bears_its_pull_does_not_tear() -> None:
    simulation = notched()
    advance(simulation, 0.0, edge=1)
    for _ in range(5):
        advance(simulation, 0.002)
    found = look(simulation, 1e6)
    assert (found.over, found.edit) == (0, None)
    assert look(simulation, 1.0).largest == pytest.approx(look(simulation, 10.0).largest)
