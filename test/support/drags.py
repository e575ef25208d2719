"""A hold dragged straight through an organ and out, and let go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from support.small_block import pose_of
from tissue_sim.frame import Budget, Edge, FrameInputs, ToolSample
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

SPEED = 1.0
"""Of the hold [m/s]."""

RATE = 60
SECONDS = 5
"""Time for the tissue to come back [s]."""


@dataclass(frozen=True)
class Drag:
    """A straight drag from a point of the organ's surface, through the organ and out [m]."""

    geometry: str
    start: tuple[float, float, float]
    way: tuple[float, float, float]
    length: float

    def places(self) -> NDArray[np.float64]:
        """Where the tool is in each frame [m], shape (frames, 3)."""
        way = np.array(self.way) / np.linalg.norm(self.way)
        frames = int(np.ceil(self.length / SPEED * RATE))
        way = np.arange(frames + 1)[:, None] * way * (SPEED / RATE)
        return np.array(self.start) + way


def with_grasper(
    mesh: Mesh, model: str, way: Drag, radius: float, **parameters: float
) -> Simulation:
    """A simulation with a grasper that reaches `radius` [m] where the way begins."""
    tool = ToolSpec("grasper", pose=tuple(pose_of(way.start)), size=(radius,)).checked()
    scene = Scene(model=model, parameters={model: parameters}, tools=(tool,), rate_hz=RATE)
    return Simulation(mesh, scene)


def drag(simulation: Simulation, way: Drag, steps: int) -> float:
    """Grab, drag, let go and wait; the largest displacement afterwards over the pull.

    `steps` are those of a static model in a frame.
    """
    places = way.places()
    budget = Budget(steps=steps if simulation.model.time_step is None else None)
    for number, place in enumerate(places):
        edge: Edge = 1 if number == 0 else 0
        sample = ToolSample("grasper", pose_of(place), 1, True, edge)
        frame = simulation.advance(FrameInputs(tools=(sample,)), budget)
        assert np.isfinite(frame.positions).all()
    assert len(simulation.holds.rows)
    sample = ToolSample("grasper", pose_of(places[-1]), 1, False, -1)
    simulation.advance(FrameInputs(tools=(sample,)), budget)
    assert not len(simulation.holds.rows)
    for _ in range(SECONDS * RATE):
        frame = simulation.advance(FrameInputs(), budget)
        assert np.isfinite(frame.positions).all()
    pulled = float(np.linalg.norm(places[-1] - places[0]))
    return float(np.linalg.norm(simulation.state.displacement, axis=1).max()) / pulled
