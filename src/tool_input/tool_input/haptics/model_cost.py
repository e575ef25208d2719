"""What contact models cost the simulation, and where its organ is pressed."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from tissue_sim.frame import Budget, Edge, FrameInputs, ToolSample
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.contact_model import ContactModels
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.scene_file import SceneFile
from tissue_sim.simulation import Simulation

RADIUS = 0.008
"""Of the probe [m]."""
DEEP = 0.003
"""How deep it goes [m]."""
FRAMES = 120
KINDS = {
    "probe": {"kind": "probe"},
    "hold by force": {"hold": "force"},
    "hold by position": {"hold": "position"},
}


def mesh_of(scene: SceneFile) -> Mesh:
    """The organ of a scene."""
    values = scene.simulation
    shape = {
        name.removeprefix("shape."): value
        for name, value in values.items()
        if name.startswith("shape.")
    }
    return scene_geometry.load(values["geometry"], parameters=shape).mesh


def outermost(mesh: Mesh, towards: NDArray[np.float64]) -> NDArray[np.float64]:
    """Place of the node that a tool which comes from far along an axis meets first [m], shape (3,).

    Of those within 2 mm the one that is nearest to the middle.
    """
    places = mesh.rest[: mesh.node_rows]
    far = places @ towards
    first = np.flatnonzero(far < far.min() + 0.002)
    across = places[first] - places.mean(axis=0)
    across -= (across @ towards)[:, None] * towards
    place: NDArray[np.float64] = places[first[np.argmin(np.linalg.norm(across, axis=1))]]
    return place


def model_costs(scene: SceneFile, towards: NDArray[np.float64]) -> list[dict[str, float | str]]:
    """Median processor time of a contact model by kind of contact, and the most nodes it had.

    Args:
        scene: Whose organ is pressed and held where a probe would press it.
        towards: Direction it is pressed in, along an axis, shape (3,).
    """
    rows: list[dict[str, float | str]] = []
    for kind, numbers in KINDS.items():
        mesh = mesh_of(scene)
        tool = ToolSpec("tool", size=(RADIUS,), **numbers)  # type: ignore[arg-type]
        simulation = Simulation(mesh, Scene(model=scene.simulation["model"], tools=(tool,)))
        place, contacts = outermost(mesh, towards), ContactModels()
        if kind == "probe":
            place = place - RADIUS * towards
        taken, nodes = [], 0
        for frame in range(FRAMES):
            way = DEEP * np.sin(np.pi * frame / FRAMES) * towards
            pose = np.array([*(place + way), 0.0, 0.0, 0.0, 1.0])
            edge: Edge = 0 if frame else 1
            samples = (ToolSample("tool", pose, 0, True, edge),)
            simulation.advance(FrameInputs(tools=samples), Budget(steps=1))
            begun = time.thread_time()
            model = contacts.of(simulation, "tool")
            if model.contact:
                taken.append(time.thread_time() - begun)
                nodes = max(nodes, len(simulation.holds.rows) + len(simulation.probes.rows))
        rows.append({"kind": kind, "nodes": nodes, "model_us": 1e6 * float(np.median(taken))})
    return rows
