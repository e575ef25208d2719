"""Bags of a session in which a block is pulled, simulated and written in this process."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from std_msgs.msg import Bool
from tissue_interfaces.msg import TissueState

from support.bags import EPOCH, ROOMY, put
from support.small_block import block_mesh, pose_of, tool_at
from support.split_edit import split_at
from tissue_sim import conversions, edit_messages, journal_messages
from tissue_sim.frame import Budget, Command, Edge, FrameInputs, ToolSample
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation
from viz_bridge.bag_writer import BagWriter

START = 1_700_000_000_000_000_000
CORNER = np.array([0.06, 0.06, 0.06])
STEPS = 3
PRESS, RELEASE = 10, 50
PULL = np.array([0.0, 0.0002, 0.0001])
"""Way of the tool in a frame [m]."""


@dataclass
class Pulled:
    """What a session was like.

    Attributes:
        held: Rows held in each frame.
        positions: Positions after each frame [m].
    """

    held: list[NDArray[np.int32]] = field(default_factory=list)
    positions: list[NDArray[np.float32]] = field(default_factory=list)


def place(frame: int) -> NDArray[np.float64]:
    """Where the tool is: it begins to move when it is pressed."""
    return CORNER + PULL * max(frame - PRESS, 0)


def record_pull(
    writer: BagWriter,
    frames: int = 60,
    namespace: str = "",
    epoch: bytes = EPOCH,
    state_every: int = 1,
    cut_at: int = 0,
    pause_at: int = 0,
    with_topology: bool = True,
    with_journal: bool = True,
    hold: str = "position",
    displaced: float = 0.0,
) -> Pulled:
    """A grasper pulls a corner of a block; frame by frame, as the bag node records it.

    Args:
        writer: Bag to write to.
        frames: Frames of the session.
        namespace: Namespace of the organ.
        epoch: Id of the epoch.
        state_every: Frames between two states that are kept.
        cut_at: Frame with an edit; 0: none.
        pause_at: Frame from which on ten frames are paused; 0: none.
        with_topology: Whether the keyframe is kept.
        with_journal: Whether the journal is.
        hold: How the grasper holds.
        displaced: How far all tissue is from rest at the start [m].
    """
    tool = tool_at(tuple(CORNER), size=(0.02,), hold=hold)
    mesh = block_mesh()
    away = np.full((mesh.node_rows, 3), displaced, dtype=np.float32) if displaced else None
    scene = Scene(model="quasi_static", tools=(tool,), displacement=away)
    simulation = Simulation(mesh, scene, epoch)
    stamp = conversions.stamp_of(START)
    if with_topology:
        keyframe = conversions.mesh_to_topology(simulation.mesh, epoch, "organ", stamp)
        put(writer, f"{namespace}/tissue/topology", keyframe, START)
    seen = Pulled()
    for number in range(1, frames + 1):
        edge: Edge = 1 if number == PRESS else -1 if number == RELEASE else 0
        sample = ToolSample(
            "grasper", pose_of(place(number)), number, PRESS <= number < RELEASE, edge
        )
        pauses = pause_at and number in (pause_at, pause_at + 10)
        commands = (Command("pause", {"on": number == pause_at}),) if pauses else ()
        edits = (split_at(simulation.mesh, 0.03),) if number == cut_at else ()
        frame = simulation.advance(FrameInputs(commands, edits, (sample,)), Budget(steps=STEPS))
        seen.held.append(simulation.holds.rows)
        seen.positions.append(frame.positions.copy())
        at = START + number * 16_666_667
        stamp = conversions.stamp_of(at)
        messages = [
            edit_messages.edit_to_msg(edit.change.edit, epoch, "organ", stamp)
            for edit in frame.edits
        ]
        for edit in messages:
            put(writer, f"{namespace}/tissue/edits", edit, at)
        if with_journal:
            entry = journal_messages.entry_to_msg(frame.journal, messages, "organ", stamp)
            put(writer, f"{namespace}/tissue/journal", entry, at)
        if number % state_every == 0:
            header = conversions.header("organ", stamp)
            state = TissueState(header=header, sim_time=simulation.sim_time)
            state.epoch = conversions.epoch_field(epoch)
            state.version, state.frame = simulation.mesh.version, number
            conversions.fill_state(state, frame.positions)
            put(writer, f"{namespace}/tissue/state", state, at)
    return seen


def pull_bag(folder: Path, **more: object) -> tuple[Path, Pulled]:
    """A bag with one such session."""
    writer = BagWriter(folder, ROOMY)
    seen = record_pull(writer, **more)  # type: ignore[arg-type]
    writer.close()
    return folder, seen


def robot_bag(
    folder: Path, tool: str = "grasper", press_at: float = 0.2, frame_id: str = "organ"
) -> Path:
    """A bag of a robot alone: poses at 200 Hz, 20 mm/s from the press on, and when it is used."""
    writer = BagWriter(folder, ROOMY)
    for number in range(200):
        time = number / 200
        at = START + round(1e9 * time)
        pose = PoseStamped(header=conversions.header(frame_id, conversions.stamp_of(at)))
        moved = CORNER + np.array([0.0, 0.02, 0.0]) * max(time - press_at, 0.0)
        conversions.fill_pose(pose.pose, pose_of(moved))
        put(writer, f"/psm1/tools/{tool}/servo_cp", pose, at)
        if press_at and time in (0.0, press_at):
            put(writer, f"/psm1/tools/{tool}/use", Bool(data=time > 0.0), at + 1)
    writer.close()
    return folder
