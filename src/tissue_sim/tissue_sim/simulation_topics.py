"""What the simulation's node publishes."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from tissue_interfaces.msg import ContactModel as ContactModelMsg
from tissue_interfaces.msg import (
    CutRequest,
    Journal,
    Status,
    TissueState,
    Tool,
    ToolList,
    Topology,
    TopologyEdit,
)

from tissue_sim import conversions, edit_messages, journal_messages, qos
from tissue_sim.contact_messages import contact_to_msg
from tissue_sim.diagnostics import Finding
from tissue_sim.frame import Frame
from tissue_sim.geometry.components import parts_of
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.contact_model import ContactModel
from tissue_sim.interaction.tracker import ToolTracker


class SimulationTopics:
    """Publishers of everything but what belongs to one tool.

    Attributes:
        frame_id: The organ's frame.
        bad_qos: Topics that somebody asked for with an incompatible quality of service.
    """

    def __init__(self, node: Node, frame_id: str) -> None:
        self.frame_id = frame_id
        self.bad_qos: dict[str, str] = {}

        def make(message: type, topic: str, profile: Any) -> Any:
            def incompatible(info: Any) -> None:
                self.bad_qos[topic] = (
                    f"{topic}: {info.total_count} subscribers ask for an incompatible quality of "
                    f"service ({info.last_policy_kind})"
                )

            events = PublisherEventCallbacks(incompatible_qos=incompatible)
            return node.create_publisher(message, topic, profile, event_callbacks=events)

        self.state = make(TissueState, "tissue/state", qos.STATE)
        self.journal = make(Journal, "tissue/journal", qos.JOURNAL)
        self.edits = make(TopologyEdit, "tissue/edits", qos.EDITS)
        self.topology = make(Topology, "tissue/topology", qos.LATCHED)
        self.status = make(Status, "tissue/status", qos.LATCHED)
        self.tools = make(ToolList, "tissue/tools", qos.LATCHED)
        self.cut_requests = make(CutRequest, "tissue/cut_request", qos.CUT_REQUEST)
        self.diagnostics = make(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        self._status_before: tuple[Any, ...] = ()
        self._tools_before: tuple[Any, ...] | None = None

    def publish_frame(self, frame: Frame, stamp: Time) -> None:
        """Publish a frame's state, edits, cut requests and journal entry."""
        entry = frame.journal
        edits = [
            edit_messages.edit_to_msg(edit, entry.epoch, self.frame_id, stamp)
            for edit in (applied.change.edit for applied in frame.edits)
        ]
        for edit in edits:
            self.edits.publish(edit)
        self.publish_state(frame, stamp)
        for number, cut in enumerate(frame.cuts):
            request_id = f"{entry.epoch.hex()[:8]}-{entry.frame}-{number}"
            if cut.stroke:
                request_id = f"{cut.stroke}/{entry.frame}"
            self.cut_requests.publish(
                conversions.cut_request(cut, entry, request_id, self.frame_id, stamp)
            )
        # A replay makes edits of undo and redo anew, from their commands.
        planned = edits[len(edits) - len(entry.inputs.edits) :]
        self.journal.publish(journal_messages.entry_to_msg(entry, planned, self.frame_id, stamp))

    def publish_state(self, frame: Frame, stamp: Time) -> None:
        """Publish where the nodes are after a frame."""
        entry = frame.journal
        state = TissueState(
            header=conversions.header(self.frame_id, stamp),
            sim_time=float(entry.sim_time),
            version=entry.version,
            frame=entry.frame,
        )
        state.epoch = conversions.epoch_field(entry.epoch)
        moved = [sample for sample in entry.inputs.tools if sample.stamp]
        state.tool_ids = [sample.tool for sample in moved]
        state.tool_stamps = [conversions.stamp_of(sample.stamp) for sample in moved]
        conversions.fill_state(state, frame.positions)
        self.state.publish(state)

    def publish_status(
        self,
        epoch: bytes,
        version: int,
        organ: str,
        model: str,
        state: int,
        request: str,
        message: str,
        stamp: Time,
        progress: float = 0.0,
    ) -> None:
        """Publish the status if it changed."""
        now = (epoch, version, organ, model, state, request, message, progress)
        if now == self._status_before:
            return
        self._status_before = now
        status = Status(
            header=conversions.header(self.frame_id, stamp),
            version=version,
            organ=organ,
            model=model,
            state=state,
            request=request,
            progress=progress,
            message=message,
        )
        status.epoch = conversions.epoch_field(epoch)
        self.status.publish(status)

    def publish_tools(self, trackers: Sequence[ToolTracker], stamp: Time) -> None:
        """Publish the list of tools if it changed, poses aside."""
        now = tuple((t.spec, t.state, t.reason, t.pressed) for t in trackers)
        if now == self._tools_before:
            return
        self._tools_before = now
        message = ToolList(header=conversions.header(self.frame_id, stamp))
        message.tools = [self._tool(tracker) for tracker in trackers]
        self.tools.publish(message)

    @staticmethod
    def _tool(tracker: ToolTracker) -> Tool:
        spec = tracker.spec
        message = Tool(
            id=spec.id,
            kind=spec.kind,
            shape=spec.shape,
            owner=spec.owner,
            state=tracker.state,
            reason=tracker.reason,
            pressed=tracker.pressed,
            pose=conversions.pose_message(tracker.pose),
            hold=spec.hold,
            **spec.coupling.as_arguments(),
            cutting=spec.cutting,
            **spec.response.as_arguments(),
            **spec.contact.as_arguments(),
        )
        conversions.fill(message.size, np.array(spec.size))
        return message

    def publish_diagnostics(self, name: str, findings: Sequence[Finding], stamp: Time) -> None:
        """Publish findings under the node's name."""
        self.diagnostics.publish(conversions.diagnostics(name, findings, stamp))


class ToolTopics:
    """Publishers of one tool's measured pose and force, and of the contact it feels."""

    def __init__(self, node: Node, tool: str, frame_id: str) -> None:
        self.frame_id = frame_id
        self._tool = tool
        self._contact = node.create_publisher(
            ContactModelMsg, f"tools/{tool}/contact_model", qos.MEASURED
        )
        self.pose = node.create_publisher(PoseStamped, f"tools/{tool}/measured_cp", qos.MEASURED)
        self.wrench = node.create_publisher(
            WrenchStamped, f"tools/{tool}/measured_cf", qos.MEASURED
        )

    def publish(
        self, pose: NDArray[np.float64], wrench: NDArray[np.float64] | None, stamp: Time
    ) -> None:
        """Publish the pose applied, and the force unless there is none to speak of."""
        self.pose.publish(conversions.pose_stamped(pose, self.frame_id, stamp))
        if wrench is not None:
            self.wrench.publish(conversions.wrench_stamped(wrench, self.frame_id, stamp))

    @property
    def contact_wanted(self) -> bool:
        """Whether somebody listens to the contact's model."""
        return bool(self._contact.get_subscription_count())

    def publish_contact(self, model: ContactModel, stamp: Time) -> None:
        """Publish what the tool feels near where it is."""
        self._contact.publish(contact_to_msg(model, self._tool, self.frame_id, stamp))

    def destroy(self, node: Node) -> None:
        """Take the publishers down."""
        node.destroy_publisher(self._contact)
        node.destroy_publisher(self.pose)
        node.destroy_publisher(self.wrench)


PUBLISHING_TAKES = 0.006
"""Time left until the next frame in which a large keyframe can be published [s]."""

PATIENCE = 0.5
"""A keyframe waits no longer for so much time [s]."""


class Keyframes:
    """Makes keyframes in a thread of its own: after edits, at most once in `interval`.

    The loop publishes them when it has time: publishing keeps Python's lock for milliseconds.

    Attributes:
        components: Connected parts of the organ in the last keyframe.
        unkeyed: Edits since the last keyframe that was begun.
    """

    def __init__(self, topics: SimulationTopics, interval: float = 1.0) -> None:
        self.components = 0
        self.unkeyed = 0
        self._topics, self._interval = topics, interval
        self._begun = -np.inf
        self._work: threading.Thread | None = None
        self._made: Topology | None = None

    def wanted(self, now: float) -> bool:
        """Whether it is time for the next keyframe."""
        if not self.unkeyed or self._made or (self._work and self._work.is_alive()):
            return False
        return now - self._begun >= self._interval or self.unkeyed >= qos.MAX_UNKEYED_EDITS // 2

    def make(self, mesh: Mesh, epoch: bytes, stamp: Time) -> Topology:
        """A keyframe, and the number of parts of the organ on the way."""
        self.components = parts_of(mesh)
        return conversions.mesh_to_topology(mesh, epoch, self._topics.frame_id, stamp)

    def begin(self, mesh: Mesh, epoch: bytes, now: float, stamp: Time) -> None:
        """Make a keyframe beside the loop.

        Args:
            mesh: A copy nobody else changes.
            epoch: Its epoch.
            now: Steady time [s].
            stamp: Start of the frame.
        """
        self.unkeyed = 0
        self._begun = now

        def work() -> None:
            self._made = self.make(mesh, epoch, stamp)

        self._work = threading.Thread(target=work, name="keyframe", daemon=True)
        self._work.start()

    def publish_made(self, now: float, slack: float) -> None:
        """Publish the keyframe made last, if there is one and time for it.

        Args:
            now: Steady time [s].
            slack: Time until the next frame [s].
        """
        made = self._made
        if made is not None and (slack > PUBLISHING_TAKES or now - self._begun > PATIENCE):
            self._made = None
            self._topics.topology.publish(made)

    def publish(self, keyframe: Topology, now: float) -> None:
        """Publish the keyframe an epoch starts with."""
        self.finish()
        self._made = None
        self.unkeyed = 0
        self._begun = now
        self._topics.topology.publish(keyframe)

    def finish(self) -> None:
        """Wait for the keyframe that is being made, and publish it."""
        if self._work:
            self._work.join(timeout=10.0)
        self.publish_made(np.inf, np.inf)
