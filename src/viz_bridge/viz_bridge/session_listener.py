"""Listens to the messages of a bag and keeps what a report tells of each epoch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.organ import Organ
from tissue_sim.conversions import epoch_of
from tissue_sim.elastic.model import Material
from tissue_sim.journal import JournalError, scene_of
from tissue_sim.journal_messages import entry_from_msg
from tissue_sim.report.session import Event
from tissue_sim.script_words import SCRIPTED
from viz_bridge.bag_reader import BagMessage
from viz_bridge.cdr import Message
from viz_bridge.cut_follower import CutFollower
from viz_bridge.organ_follower import OrganFollower
from viz_bridge.session_events import SessionEvent, nanoseconds
from viz_bridge.stress_follower import TOPIC as READINGS
from viz_bridge.stress_follower import StressFollower

JOURNAL, HOLES = "tissue/journal", "tissue/holes"
QUIET = ("start", "set_tool", "remove_tool")
"""Commands that are no event of an operation."""


class HeardPose(NamedTuple):
    """A tool in one frame.

    Attributes:
        time: Of the frame [s].
        stamp: Of the pose that was applied [ns].
        place: Of the tip [m], shape (3,).
        use: Whether it is used.
    """

    time: float
    stamp: int
    place: NDArray[np.float64]
    use: bool


@dataclass
class HeardEpoch:
    """What was heard of one epoch.

    Attributes:
        name: Its id.
        stress: Its stress and warnings.
        cuts: Its cuts.
        organ: Name of the geometry.
        digest: Of the organ at the start; empty: not recorded.
        nodes: Of the organ at the start.
        material: What the tissue is made of; None: not known.
        models: Elastic models, in the order they ran.
        times: Simulated time of each frame of the journal [s].
        frames: Their numbers.
        stamps: Their time on the clock [ns].
        paused: Whether time stood still in them.
        poses: Of each tool, in the frames that tell of it.
        kinds: Kind of each tool.
        events: What happened.
        holes: Frame and message of each hole by name.
    """

    name: bytes
    stress: StressFollower
    cuts: CutFollower = field(default_factory=CutFollower)
    organ: str = ""
    digest: str = ""
    nodes: int = 0
    material: Material | None = None
    models: list[str] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)
    paused: list[bool] = field(default_factory=list)
    poses: dict[str, list[HeardPose]] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    holes: dict[str, list[tuple[int, Message]]] = field(default_factory=dict)
    is_paused: bool = False


class SessionListener:
    """Listens to a whole bag, epoch by epoch.

    Attributes:
        organ: The organ as it is now.
        epochs: What was heard, by epoch.
        forces: Time on the clock [ns] and magnitude [N] of the force on each tool.
    """

    def __init__(self, recorded: bool, risk: Path | None) -> None:
        self.organ = OrganFollower()
        self.epochs: dict[bytes, HeardEpoch] = {}
        self.forces: dict[str, list[tuple[int, float]]] = {}
        self._recorded, self._risk = recorded, risk
        self._frozen: set[str] = set()

    def take(self, topic: str, item: BagMessage) -> None:
        """Take one message."""
        take = _TAKERS.get(topic)
        if take is not None:
            take(self, item.message)
        elif topic.startswith("tools/") and topic.endswith("/measured_cf"):
            force = item.message.wrench.force
            size = float(np.linalg.norm([force.x, force.y, force.z]))
            stamp = nanoseconds(item.message.header.stamp)
            self.forces.setdefault(topic.split("/")[1], []).append((stamp, size))

    def of(self, epoch: bytes) -> HeardEpoch:
        """What was heard of an epoch."""
        if epoch not in self.epochs:
            self.epochs[epoch] = HeardEpoch(epoch, StressFollower(self._recorded, self._risk))
        return self.epochs[epoch]

    def close(self) -> None:
        """The bag is over."""
        if self.organ.mesh is not None:
            self.of(self.organ.replica.epoch).cuts.close(self.organ.mesh)

    def _topology(self, message: Message) -> None:
        before, last = self.organ.replica.epoch, self.organ.mesh
        if not self.organ.take_topology(message) or self.organ.mesh is None:
            return
        epoch, mesh = self.of(epoch_of(message)), self.organ.mesh
        if epoch.name != before:
            if last is not None:
                self.of(before).cuts.close(last)
            epoch.organ = str(message.organ)
            epoch.nodes = int(mesh.node_alive[: mesh.node_rows].sum())
            if mesh.version == 1:
                epoch.digest = Organ(mesh.name, mesh).digest
            epoch.stress.begin(mesh)
        epoch.cuts.begin(mesh)

    def _edit(self, message: Message) -> None:
        epoch, mesh = self.of(epoch_of(message)), self.organ.mesh
        if mesh is not None and self.organ.replica.epoch == epoch.name:
            epoch.cuts.before(message, mesh)
        if self.organ.take_edit(message):
            epoch.cuts.after(message, self.organ, set(self.organ.tools.by_id))

    def _state(self, message: Message) -> None:
        places, mesh = self.organ.take_state(message), self.organ.mesh
        if places is not None and mesh is not None:
            epoch = self.of(epoch_of(message))
            tools = self.organ.tools.by_id.values()
            epoch.stress.take_state(mesh, places, self.organ.sim_time, epoch.material, tools)

    def _journal(self, message: Message) -> None:
        epoch = self.of(epoch_of(message))
        if not epoch.times and epoch.material is None:
            epoch.material = _material(message)
        time = float(message.sim_time)
        for command in message.commands:
            if command.kind == "pause":
                epoch.is_paused = '"on": true' in command.arguments
        epoch.times.append(time)
        epoch.frames.append(int(message.frame))
        epoch.stamps.append(nanoseconds(message.header.stamp))
        epoch.paused.append(epoch.is_paused)
        epoch.kinds |= self.organ.tools.kinds
        for sample in message.tools:
            pose = HeardPose(
                time, nanoseconds(sample.stamp), np.array(sample.pose[:3]), bool(sample.use)
            )
            epoch.poses.setdefault(str(sample.id), []).append(pose)
        for event in self.organ.take_journal(message):
            if event.kind not in QUIET:
                epoch.events.append(_event(event, epoch.is_paused))

    def _tools(self, message: Message) -> None:
        self.organ.tools.take_list(message)
        frozen = {tool.id: tool.reason for tool in message.tools if tool.state == "frozen"}
        epoch = self.epochs.get(self.organ.replica.epoch)
        for tool in set(frozen) - self._frozen:
            if epoch is not None:
                text = f"{tool} is frozen: {frozen[tool]}"
                epoch.events.append(Event(self.organ.sim_time, "frozen", text, tool))
        self._frozen = set(frozen)

    def _status(self, message: Message) -> None:
        epoch = self.of(epoch_of(message))
        if message.model and message.model not in epoch.models:
            epoch.models.append(str(message.model))

    def _holes(self, message: Message) -> None:
        epoch = self.of(epoch_of(message))
        for hole in message.holes:
            epoch.holes.setdefault(str(hole.name), []).append((int(message.frame), hole))

    def _readings(self, message: Message) -> None:
        self.of(epoch_of(message)).stress.take_readings(message)

    def _label(self, message: Message) -> None:
        epoch = self.epochs.get(self.organ.replica.epoch)
        text = str(message.data)
        # Of all it does a script says so; the journal knows the rest better.
        if epoch is not None and text.partition(" ")[0] not in SCRIPTED:
            epoch.events.append(Event(self.organ.sim_time, "label", text))


_TAKERS: dict[str, Callable[[SessionListener, Message], None]] = {
    "tissue/topology": SessionListener._topology,
    "tissue/edits": SessionListener._edit,
    "tissue/state": SessionListener._state,
    "tissue/tools": SessionListener._tools,
    "tissue/status": SessionListener._status,
    JOURNAL: SessionListener._journal,
    HOLES: SessionListener._holes,
    READINGS: SessionListener._readings,
    "script/event": SessionListener._label,
}


def _material(first: Message) -> Material | None:
    """What the tissue is made of, from the first frame of an epoch."""
    try:
        return scene_of(entry_from_msg(first)).material
    except (JournalError, KeyError):
        return None


def _event(event: SessionEvent, paused: bool) -> Event:
    text = ("paused" if paused else "goes on") if event.kind == "pause" else event.text
    return Event(event.sim_time, event.kind, text, event.tool)
