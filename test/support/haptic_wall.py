"""A hand that presses a simulated organ: a 500 Hz force loop beside 60 Hz frames, by one clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissue_sim.frame import Budget, Edge, FrameInputs, ToolSample
from tissue_sim.geometry import scene_geometry
from tissue_sim.interaction.contact import Contact
from tissue_sim.interaction.contact_model import ContactModel, ContactModels
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

LOOP_HZ, FRAME_HZ = 500.0, 60.0
RADIUS = 0.012
SIZES = {"nodes_x": 6, "nodes_y": 6, "nodes_z": 6, "size_x": 0.05, "size_y": 0.05, "size_z": 0.05}
Reals = NDArray[np.float64]


@dataclass
class Felt:
    """What came of it.

    Attributes:
        energy: That the hand has put into the loop so far, by tick [J].
        forces: On the hand, by tick [N], shape (ticks, 3).
        heights: Of the hand, by tick [m].
    """

    energy: list[float] = field(default_factory=list)
    forces: list[Reals] = field(default_factory=list)
    heights: list[float] = field(default_factory=list)


class PressedBlock:
    """A block of tissue that a probe presses from above, one frame after the other."""

    def __init__(self, model: str = "quasi_static", contact: Contact | None = None) -> None:
        """Begin above the block."""
        contact = contact or Contact()
        tool = ToolSpec("probe", kind="probe", shape="sphere", size=(RADIUS,), contact=contact)
        mesh = scene_geometry.load("block", parameters=SIZES).mesh
        levels = {"quasi_static": {"levels": 1000.0}}
        self.simulation = Simulation(mesh, Scene(model=model, parameters=levels, tools=(tool,)))
        self.contacts = ContactModels()

    def frame(self, pose: Reals, steps: int = 10) -> ContactModel:
        """Advance by one frame with the probe at a pose."""
        edge: Edge = 1 if self.simulation.frame == 0 else 0
        samples = (ToolSample("probe", pose, 0, True, edge),)
        self.simulation.advance(FrameInputs(tools=samples), Budget(steps=steps))
        return self.contacts.of(self.simulation, "probe")


def above(depth: float) -> Reals:
    """A pose of the probe over the middle of the block's upper side, so deep in it [m]."""
    return np.array([0.025, 0.025, 0.05 + RADIUS - depth, 0.0, 0.0, 0.0, 1.0])


def press(
    seconds: float,
    depth_at: Callable[[float], float],
    receive: Callable[[ContactModel, float], None],
    force: Callable[[float, Reals], Reals],
    delay: Callable[[int], float] = lambda _: 0.006,
) -> Felt:
    """Press the block along a way in time, and feel it.

    Args:
        seconds: How long.
        depth_at: How deep the probe is in the undeformed block at a time [m].
        receive: Takes a contact model and the time of its frame.
        force: Gives the wrench on the hand from a time on, at a pose.
        delay: Time from a frame's start to the arrival of its model, by frame [s].
    """
    block, felt, energy = PressedBlock(), Felt(), 0.0
    under_way: list[tuple[float, float, ContactModel]] = []
    before, wrench, frames = above(depth_at(0.0)), np.zeros(6), 0
    for tick in range(int(seconds * LOOP_HZ)):
        now = tick / LOOP_HZ
        pose = above(depth_at(now))
        energy -= float(wrench[:3] @ (pose[:3] - before[:3]))
        before = pose
        if now >= frames / FRAME_HZ:
            under_way.append((now + delay(frames), now, block.frame(pose)))
            frames += 1
        for item in [item for item in under_way if item[0] <= now]:
            under_way.remove(item)
            receive(item[2], item[1])
        wrench = force(now, pose)
        felt.energy.append(energy)
        felt.forces.append(wrench[:3].copy())
        felt.heights.append(float(pose[2]))
    return felt
