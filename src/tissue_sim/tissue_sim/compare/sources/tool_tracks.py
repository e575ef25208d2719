"""Recorded motion of tools alone, such as that of a robot, played to an organ."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.interaction import InteractionError
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.sources.held_frames import HeldFrames
from tissue_sim.compare.sources.played import (
    STEPS,
    frame_note,
    grasper,
    session_hz,
    stage_of,
    tools_beside,
)
from tissue_sim.compare.sources.recorded import Recording
from tissue_sim.frame import Budget, Edge, FrameInputs, ToolSample
from tissue_sim.interaction.rigid import PoseError, checked_pose
from tissue_sim.interaction.tools import GRAB, ToolSpec
from tissue_sim.simulation import Simulation
from tool_input.bag_tracks import POSE, BagTracks


@dataclass
class Track:
    """How a tool was moved and used.

    Attributes:
        times: When poses came, since the first message [s].
        poses: The poses: x y z [m] and quaternion x y z w.
        used: When its use changed [s], and to what.
    """

    times: list[float] = field(default_factory=list)
    poses: list[NDArray[np.float64]] = field(default_factory=list)
    used: list[tuple[float, bool]] = field(default_factory=list)

    def pose(self, time: float) -> NDArray[np.float64] | None:
        """The newest pose at a time [s], shape (7,); None: there is none yet."""
        index = int(np.searchsorted(self.times, time, "right")) - 1
        return None if index < 0 else self.poses[index]

    def level(self, time: float) -> bool:
        """Whether it is used at a time [s]."""
        return next((level for at, level in reversed(self.used) if at <= time), False)


def play_tools(
    bag: Path, organ: Organ, rate_hz: float, tools: Mapping[str, ToolSpec] | None = None
) -> Recording:
    """What the tools of a bag do to an organ, up to the first use of one that is no grasper.

    Poses are taken as they are: nothing limits jumps and speeds as in a session. Where tissue is
    when it is grabbed is decided as for a script.

    Args:
        bag: Bag directory or MCAP file with tools/<tool>/servo_cp and tools/<tool>/use.
        organ: The organ; not changed.
        rate_hz: Frames per second [1/s].
        tools: Tools that there are, by name; None: those of the project's scene with the organ's
            name. A tool that is not among them is a grasper that holds some 60 nodes.

    Raises:
        ValueError: The bag cannot be read, or its tools hold nothing.
    """
    tracks, frames, end = _read(bag)
    known = tools_beside(organ) if tools is None else tools
    notes = frame_note(frames)
    there = {}
    for name in tracks:
        there[name] = known.get(name) or grasper(name, organ)
        if name not in known:
            radius = 1e3 * there[name].size[0]
            notes += (f"{name} is taken for a grasper with a radius of {radius:.3g} mm",)
    ends = [
        (at, name)
        for name, track in tracks.items()
        for at, level in track.used
        if level and there[name].kind != GRAB
    ]
    if ends:
        end, name = min(ends)
        notes += (f"{name} changes the mesh at {end:.2f} s; the interaction ends before it",)
    held = HeldFrames()
    simulation = Simulation(*stage_of(organ, there.values(), rate_hz))
    _play(simulation, tracks, end, held)
    interaction, _ = held.interaction(bag.resolve().stem, organ, session_hz(rate_hz), rate_hz)
    return Recording(organ, interaction, None, (*notes, *held.notes()))


def has_tools(topics: Iterable[str]) -> bool:
    """Whether tools can be played: some topic is a tools/<tool>/servo_cp."""
    return any("tools/" in topic and topic.endswith("/servo_cp") for topic in topics)


def _read(bag: Path) -> tuple[dict[str, Track], set[str], float]:
    """Tracks by tool, the frames their poses are in, and the time of the last message [s]."""
    # Here, because viz_bridge depends on this package.
    from viz_bridge.bag_reader import read_bag

    topics = BagTracks(bag)
    tracks: dict[str, Track] = {}
    frames: set[str] = set()
    first, time = None, 0.0
    for item in read_bag(bag, topics.topics):
        message = item.message
        first = item.log_time if first is None else first
        time = 1e-9 * (item.log_time - first)
        track = tracks.setdefault(topics.targets[item.topic].split("/")[-2], Track())
        if topics.topics[item.topic] == POSE:
            frames.add(str(message.header.frame_id))
            track.times.append(time)
            track.poses.append(_pose(item.topic, message.pose))
        elif track.level(time) != bool(message.data):
            track.used.append((time, bool(message.data)))
    if not any(level for track in tracks.values() for _, level in track.used):
        raise InteractionError(
            f"{bag}: no tool is used in it (tools/<tool>/use is never true), so none holds tissue; "
            f"its topics: {', '.join(topics.topics)}"
        )
    return tracks, frames, time


def _pose(topic: str, message: object) -> NDArray[np.float64]:
    place, turn = message.position, message.orientation  # type: ignore[attr-defined]
    pose = np.array([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w])
    try:
        return checked_pose(pose)
    except PoseError as error:
        raise InteractionError(f"{topic}: {error}") from error


def _play(
    simulation: Simulation, tracks: Mapping[str, Track], end: float, held: HeldFrames
) -> None:
    level = dict.fromkeys(tracks, False)
    period, number = 1.0 / simulation.scene.rate_hz, 0
    while number * period < end:
        time, number, samples = number * period, number + 1, []
        for name, track in tracks.items():
            pose = track.pose(time)
            if pose is None:
                continue
            now = track.level(time)
            edge: Edge = 0 if now == level[name] else 1 if now else -1
            level[name] = now
            samples.append(ToolSample(name, pose, number, now, edge))
        simulation.advance(FrameInputs(tools=tuple(samples)), Budget(steps=STEPS))
        held.take(simulation)
