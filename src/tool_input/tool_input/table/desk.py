"""The ROS side of the operating table: what is heard of the simulation, and what is asked of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rclpy.node import Node
from tissue_interfaces import msg

from tissue_sim import qos
from tissue_sim.conversions import (
    array_of,
    epoch_of,
    pose_array,
    positions_from_state,
    topology_to_mesh,
)
from tissue_sim.edit_messages import edit_from_msg
from tissue_sim.geometry.holes import Hole
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.hole_messages import hole_from_msg
from tissue_sim.polled_subscriptions import PolledSubscriptions
from tissue_sim.replica import Replica
from tool_input.table.requests import Requests
from tool_input.table.tissue_frame import NodeValues, Surface, TissueFrame, ToolShown

if TYPE_CHECKING:
    from tool_input.table.person import Person


class Desk:
    """Everybody's connection to the simulation. All of it is used in the node's thread only.

    Attributes:
        node: The node it belongs to.
        frame_id: Frame of the organ.
        replica: The organ as it was heard.
        status: Newest `tissue/status`; this and those below are None until they are heard.
        material: Newest `tissue/material`.
        held_nodes: Newest `tissue/held_nodes`.
        holes: Newest `tissue/holes`.
        readings: Newest `tissue/readings`.
        risk_regions: Newest `tissue/risk_regions`.
        playback: Newest `tissue/playback`.
        tools: The tools there are, by name.
    """

    def __init__(self, node: Node, frame_id: str) -> None:
        """Listen and ask through a node.

        Args:
            node: The node.
            frame_id: Frame of the organ.
        """
        self.node = node
        self.frame_id = frame_id
        self.replica = Replica(shapes_kept=2)
        self.status: msg.Status | None = None
        self.material: msg.Material | None = None
        self.held_nodes: msg.HeldNodes | None = None
        self.holes: msg.Holes | None = None
        self.readings: msg.Readings | None = None
        self.risk_regions: msg.RiskRegions | None = None
        self.playback: msg.Playback | None = None
        self.tools: dict[str, msg.Tool] = {}
        self._poses: dict[str, NDArray[np.float64]] = {}
        self._moved: set[str] = set()
        self._scalar: msg.NodeScalar | None = None
        self._difference: msg.TissueState | None = None
        self._surface: tuple[bytes, int, Surface] | None = None
        self._soon: deque[Callable[[], None]] = deque()
        self._requests = Requests(node, self.soon)
        self._wake = node.create_guard_condition(self._act)
        self._heard = PolledSubscriptions(node)
        self._listen()

    # What is asked

    def soon(self, act: Callable[[], None]) -> None:
        """Call something in the node's thread, after what was asked for before; from any thread."""
        self._soon.append(act)
        self._wake.trigger()

    def request(
        self,
        person: Person,
        service: str,
        request: Any,
        answered: Callable[[Any], None] | None = None,
    ) -> None:
        """Ask for something in a person's name.

        The request's author and request_id, where it has them, are filled in. A refusal is told to
        the person.

        Args:
            person: Who asks.
            service: One of `requests.SERVICES`.
            request: The service's request.
            answered: Called in the node's thread with the answer, if that is a success.
        """
        self._requests.ask(person, service, request, answered)

    def new_id(self, person: Person) -> str:
        """A request id that no other request has."""
        return self._requests.new_id(person)

    def _act(self) -> None:
        while self._soon:
            self._soon.popleft()()

    # What is heard

    def hear(self) -> None:
        """Take in what has come since the last call."""
        self._heard.take()
        self._requests.send()

    def frame(self) -> TissueFrame | None:
        """The newest shape with all that is known of it; None before there is one."""
        shape, mesh = self.replica.shape_at(), self.replica.mesh
        if shape is None or mesh is None:
            return None
        epoch = self.replica.epoch
        return TissueFrame(
            epoch,
            shape.frame,
            mesh,
            shape.positions,
            self._surface_of(epoch, mesh.version),
            {name: self._shown(tool) for name, tool in self.tools.items()},
            self._values_of(self._scalar, epoch, mesh.version),
            self._values_of(self._difference, epoch, mesh.version),
            self._holes_of(epoch),
            self._risk_rows(epoch, mesh),
        )

    def pose(self, tool: str) -> NDArray[np.float64]:
        """Where a tool is: position [m] and quaternion x y z w, shape (7,)."""
        return self._poses[tool]

    def _surface_of(self, epoch: bytes, version: int) -> Surface:
        known = self._surface
        if known is None or known[:2] != (epoch, version):
            assert self.replica.mesh is not None
            known = self._surface = (epoch, version, Surface.of(self.replica.mesh))
        return known[2]

    def _shown(self, tool: msg.Tool) -> ToolShown:
        state = tool.state
        if state == msg.Tool.FREE and self.playback is not None and tool.id in self._moved:
            # No person moves it, but the recording does.
            state = msg.Tool.ACTIVE
        return ToolShown(
            tool.id, tool.kind, tool.shape, tuple(tool.size), tool.owner, state, tool.pressed,
            self._poses[tool.id],
        )  # fmt: skip

    def _holes_of(self, epoch: bytes) -> tuple[Hole, ...]:
        holes = self.holes
        if holes is None or epoch_of(holes) != epoch:
            return ()
        return tuple(hole_from_msg(hole) for hole in holes.holes)

    def _risk_rows(self, epoch: bytes, mesh: Mesh) -> NDArray[np.int64]:
        heard = self.risk_regions
        if heard is None or epoch_of(heard) != epoch or not heard.regions:
            return np.empty(0, dtype=np.int64)
        nodes = np.concatenate([array_of(one.nodes, np.uint32) for one in heard.regions])
        rows = mesh.node_rows_of(np.unique(nodes)).astype(np.int64)
        known: NDArray[np.int64] = rows[rows >= 0]
        return known

    @staticmethod
    def _values_of(message: Any, epoch: bytes, version: int) -> NodeValues | None:
        if message is None or message.version != version or epoch_of(message) != epoch:
            return None
        if isinstance(message, msg.NodeScalar):
            values = array_of(message.values, np.float32)
            return NodeValues(message.name, message.unit, values)
        values = array_of(message.scalar, np.float32)
        return NodeValues(message.scalar_name, message.scalar_unit, values)

    def _listen(self) -> None:
        add = self._heard.add
        add(msg.Topology, "tissue/topology", self._on_topology, qos.LATCHED)
        add(msg.TopologyEdit, "tissue/edits", self._on_edit, qos.EDITS)
        add(msg.TissueState, "tissue/state", self._on_state, qos.STATE)
        add(msg.ToolList, "tissue/tools", self._on_tools, qos.LATCHED)
        add(msg.Status, "tissue/status", self._keep("status"), qos.LATCHED)
        add(msg.Material, "tissue/material", self._keep("material"), qos.LATCHED)
        add(msg.HeldNodes, "tissue/held_nodes", self._keep("held_nodes"), qos.LATCHED)
        add(msg.Holes, "tissue/holes", self._keep("holes"), qos.LATCHED)
        add(msg.Readings, "tissue/readings", self._keep("readings"), qos.READINGS)
        add(msg.RiskRegions, "tissue/risk_regions", self._keep("risk_regions"), qos.LATCHED)
        add(msg.Playback, "tissue/playback", self._keep("playback"), qos.LATCHED)
        add(msg.NodeScalar, "tissue/scalar", self._keep("_scalar"), qos.STATE)
        add(msg.TissueState, "tissue/difference", self._keep("_difference"), qos.STATE)

    def _keep(self, attribute: str) -> Callable[[Any, Any], None]:
        return lambda message, _: setattr(self, attribute, message)

    def _on_topology(self, message: msg.Topology, _: Any) -> None:
        epoch = epoch_of(message)
        if self.replica.wants_keyframe(epoch, message.version):
            self.replica.take_keyframe(epoch, topology_to_mesh(message))

    def _on_edit(self, message: msg.TopologyEdit, _: Any) -> None:
        self.replica.take_edit(epoch_of(message), edit_from_msg(message))

    def _on_state(self, message: msg.TissueState, _: Any) -> None:
        positions = positions_from_state(message)
        self.replica.take_state(epoch_of(message), message.version, message.frame, positions)

    def _on_tools(self, message: msg.ToolList, _: Any) -> None:
        now = {tool.id: tool for tool in message.tools}
        for gone in set(self.tools) - set(now):
            self._heard.remove(f"tools/{gone}/measured_cp")
            del self._poses[gone]
            self._moved.discard(gone)
        self.tools = now
        for name, tool in now.items():
            self._poses.setdefault(name, pose_array(tool.pose))
            topic = f"tools/{name}/measured_cp"
            self._heard.add(PoseStamped, topic, self._pose_of(name), qos.MEASURED)

    def _pose_of(self, tool: str) -> Callable[[PoseStamped, Any], None]:
        def take(message: PoseStamped, _: Any) -> None:
            if tool not in self._poses:
                return
            pose = pose_array(message.pose)
            if not np.array_equal(pose, self._poses[tool]):
                self._moved.add(tool)
            self._poses[tool] = pose

        return take
