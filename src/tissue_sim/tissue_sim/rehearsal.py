"""A rehearsal of everything a frame may do, so that no frame waits for a kernel to be compiled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissue_sim.elastic import registry
from tissue_sim.frame import Budget, Command, FrameInputs, ToolSample
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sheet import SheetStiffness
from tissue_sim.geometry.sheet_geometry import SURFACE, SheetSettings, surface_of, with_sheet
from tissue_sim.geometry.sutures import DEFAULT_STIFFNESS
from tissue_sim.interaction.contact_model import ContactModels
from tissue_sim.interaction.coupling import FORCE
from tissue_sim.interaction.cut_response import CutResponse
from tissue_sim.interaction.tools import (
    CAPSULE,
    CUT,
    PROBE,
    PROGRESSIVE,
    RECTANGLE,
    ToolSpec,
)
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

CORNERS = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1))
TOOL = ToolSpec("rehearsal", size=(0.002,))


def rehearse(sheet: bool = False) -> None:
    """Grab, pull, split, release and sew two tetrahedra with every model.

    And with the parameters, holds and predictors with which frames call other kernels.
    For tissue made of triangles, do the same with those of a surface as well.

    Kernels are compiled, or loaded from the cache, at their first call: tens of milliseconds each.
    """
    for name in registry.names():
        _rehearse(Scene(model=name, tools=(TOOL,)))
    for name, values in registry.VARIANTS:
        _rehearse(Scene(model=name, parameters={name: values}, tools=(TOOL,)))
    _rehearse(Scene(tools=(replace(TOOL, hold=FORCE),)))
    blade = replace(TOOL, kind=CUT, shape=RECTANGLE, size=(0.01, 0.01), cutting=PROGRESSIVE)
    _rehearse(Scene(tools=(replace(blade, response=CutResponse(toughness=1.0)),)))
    _rehearse(Scene(tools=(replace(TOOL, kind=PROBE),)))
    _rehearse(Scene(tools=(replace(TOOL, shape=CAPSULE, size=(0.002, 0.01)),)))
    _rehearse(Scene(model="vertex_block_descent", predictor="lr", tools=(TOOL,)))
    for name in registry.names() if sheet else ():
        if not registry.MODELS[name].needs_tetrahedra:
            _rehearse(Scene(model=name, tools=(TOOL,)), sheet=True)


def _rehearse(scene: Scene, sheet: bool = False) -> None:
    tets = np.array([[0, 1, 2, 3], [1, 4, 2, 3]])
    corners = 0.01 * np.array(CORNERS, dtype=np.float64)
    raw = RawMesh(corners, tets)
    if sheet:
        torsion = SheetSettings(SURFACE, stiffness=SheetStiffness(torsion=1.0))
        raw = with_sheet(surface_of(raw), torsion, [])
    mesh = Mesh(raw, np.array([True, False, False, False, False]))
    simulation = Simulation(mesh, scene)
    budget = Budget(steps=3)
    at = np.array([*corners[4], 0.0, 0.0, 0.0, 1.0])
    pressed = ToolSample(TOOL.id, at, 1, True, 1)
    moved = replace(pressed, pose=at + 0.001 * np.eye(7)[0], edge=0)
    simulation.advance(FrameInputs(tools=(pressed,)), budget)
    simulation.advance(FrameInputs(tools=(moved,)), budget)
    ContactModels().of(simulation, TOOL.id)
    edits = (_sheet_split(mesh) if sheet else _split(),)
    simulation.advance(FrameInputs(edits=edits, tools=(moved,)), budget)
    simulation.advance(FrameInputs(tools=(replace(moved, use=False, edge=-1),)), budget)
    simulation.advance(FrameInputs(edits=(_stitch(mesh),)), budget)
    grab = Command("grab", {"tool": TOOL.id, "radius": 0.002})
    simulation.advance(FrameInputs(commands=(grab,)), budget)
    simulation.model.residual(simulation.state)


def main() -> None:
    """Fill the cache of kernels; set-up does so, that no session has to wait for it."""
    rehearse(sheet=True)


def _sheet_split(mesh: Mesh) -> TopologyEdit:
    """Give a triangle at a node a copy of it, and move the node."""
    row = mesh.incident.of(4)[:1]
    at, other = np.array([4], dtype=np.uint32), mesh.tets[row, 0] % 4
    nodes = np.where(mesh.tets[row] == 4, PROVISIONAL, mesh.tets[row].astype(np.uint32))
    return TopologyEdit(
        base_version=1,
        read_nodes=at,
        moved_nodes=at,
        moved_rest=0.9 * mesh.rest[at] + 0.1 * mesh.rest[other],
        moved_anchors=np.array([[4, other[0], other[0], other[0]]], dtype=np.uint32),
        moved_weights=np.array([[0.9, 0.1, 0.0, 0.0]]),
        copied_nodes=np.array([PROVISIONAL], dtype=np.uint32),
        copy_parents=at,
        rewritten_elements=mesh.element_ids[row],
        rewritten_nodes=nodes.astype(np.uint32),
    )


def _stitch(mesh: Mesh) -> TopologyEdit:
    """Sew a node to the first copy."""
    new = np.array([PROVISIONAL], dtype=np.uint32)
    return TopologyEdit(
        mesh.version,
        kind="suture",
        added_sutures=new,
        suture_nodes=np.array([[1, 5]], dtype=np.uint32),
        suture_lengths=np.zeros(1),
        suture_stiffness=np.array([DEFAULT_STIFFNESS]),
        suture_groups=new,
    )


def _split() -> TopologyEdit:
    """Part the two elements at their common face, and move a node of it."""
    face = np.array([1, 2, 3], dtype=np.uint32)
    copies = (PROVISIONAL + np.arange(3)).astype(np.uint32)
    return TopologyEdit(
        base_version=1,
        read_nodes=face,
        moved_nodes=face[:1],
        moved_rest=0.01 * np.array([[0.9, 0.05, 0.05]]),
        moved_anchors=np.array([[0, 1, 2, 3]], dtype=np.uint32),
        moved_weights=np.array([[0.0, 0.9, 0.05, 0.05]]),
        copied_nodes=copies,
        copy_parents=face,
        rewritten_elements=np.array([1], dtype=np.uint32),
        rewritten_nodes=np.array([[copies[0], 4, copies[1], copies[2]]], dtype=np.uint32),
    )


if __name__ == "__main__":
    main()
