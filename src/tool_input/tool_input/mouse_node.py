"""Node `mouse`: a page in the browser to grab, pull and cut the organ with the mouse."""

from __future__ import annotations

import sys
import threading
import time

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger
from tissue_interfaces.msg import Status, TissueState, Tool, Topology, TopologyEdit
from tissue_interfaces.srv import Cut, SetModel, SetTool, Undo

from tissue_sim import qos
from tissue_sim.conversions import (
    edit_from_msg,
    epoch_of,
    positions_from_state,
    topology_to_mesh,
)
from tissue_sim.elastic import registry
from tissue_sim.geometry.surface import surface_triangles
from tissue_sim.node_main import declare, run
from tissue_sim.parameters import Spec
from tissue_sim.replica import Replica
from tool_input.motion import Pose
from tool_input.page import OperatingPage
from tool_input.tool_topics import ToolTopics, pose_message

PARAMETERS = (
    Spec("tool", "string", "mouse", "Name of the tool the mouse moves; made if it is not there."),
    Spec("frame_id", "string", "organ", "Frame of the organ; poses and cuts are given in it."),
    Spec("host", "string", "127.0.0.1", "Address the page listens on; loopback only."),
    Spec("port", "integer", 8080, "Port of the page; the next free one if taken.", "", 0, 65535),
    Spec("radius", "double", 0.005, "Grab radius at the start.", "m", 1e-4, 1.0),
    Spec("view_hz", "double", 20.0, "How often the page is redrawn.", "1/s", 1.0, 60.0),
    Spec(
        "pose_hz",
        "double",
        60.0,
        "How often the pose is published while pulling.",
        "1/s",
        10.0,
        250.0,
    ),
)
LOOPBACK = ("127.0.0.1", "localhost", "::1")


class MouseNode(Node):
    """Shows the organ on a page, and publishes and calls what its person does.

    The page's event loop calls the actions below; messages come in the executor's thread.
    """

    def __init__(self) -> None:
        super().__init__("mouse")
        given = declare(self, PARAMETERS)
        if given["host"] not in LOOPBACK:
            raise ValueError(f"host = {given['host']} is not allowed; one of {', '.join(LOOPBACK)}")
        self._tool, self._radius = given["tool"], given["radius"]
        self._frame_id = given["frame_id"]
        self._replica = Replica(shapes_kept=2)
        self._shown: tuple[bytes, int] = (b"", 0)
        self._surface_nodes: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._lock = threading.Lock()
        self._point: NDArray[np.float64] | None = None
        self._requests = 0
        self._topics = ToolTopics(self, self._tool, self._frame_id)
        self._asks = {
            "cut": self.create_client(Cut, "tissue/cut"),
            "set_model": self.create_client(SetModel, "tissue/set_model"),
            "set_tool": self.create_client(SetTool, "tissue/set_tool"),
            "pause": self.create_client(SetBool, "tissue/pause"),
            "reset": self.create_client(Trigger, "tissue/reset"),
            "undo": self.create_client(Undo, "tissue/undo"),
            "redo": self.create_client(Undo, "tissue/redo"),
        }
        models = tuple(registry.names())
        self.page = OperatingPage(self, models, host=given["host"], port=given["port"])
        self.create_subscription(Topology, "tissue/topology", self._on_topology, qos.LATCHED)
        self.create_subscription(TopologyEdit, "tissue/edits", self._on_edit, qos.EDITS)
        self.create_subscription(TissueState, "tissue/state", self._on_state, qos.STATE)
        self.create_subscription(Status, "tissue/status", self._on_status, qos.LATCHED)
        self.create_timer(1.0 / given["view_hz"], self._draw)
        self.create_timer(1.0 / given["pose_hz"], self._publish_pose)
        self.get_logger().info(f"open {self.page.address}")

    def close(self) -> None:
        """Let go and close the page."""
        self.let_go()
        self.page.close()

    # What the page asks for

    def grab(self, point: NDArray[np.float64]) -> None:
        """Start to hold the tissue at a point [m], shape (3,)."""
        self.pull(point)
        self._publish_pose()
        self._topics.use(True)

    def pull(self, point: NDArray[np.float64]) -> None:
        """Move the hold to a point [m], shape (3,)."""
        with self._lock:
            self._point = point

    def let_go(self) -> None:
        """End the hold."""
        self._publish_pose()
        with self._lock:
            self._point = None
        self._topics.use(False)

    def cut(self, vertices: NDArray[np.float64]) -> None:
        """Cut along a rectangle, corners in order [m], shape (4, 3)."""
        request = Cut.Request(request_id=self._new_id())
        request.sweep.header.frame_id = self._frame_id
        request.sweep.header.stamp = self.get_clock().now().to_msg()
        request.sweep.vertices = vertices.ravel().tolist()
        request.sweep.triangles = [0, 1, 2, 0, 2, 3]
        self._call("cut", request)

    def set_radius(self, radius: float) -> None:
        """Set the grab radius [m]."""
        self._radius = radius
        self._make_tool()

    def set_model(self, name: str) -> None:
        """Change the elastic model."""
        self._call("set_model", SetModel.Request(model=name, request_id=self._new_id()))

    def pause(self, paused: bool) -> None:
        """Pause or go on."""
        self._call("pause", SetBool.Request(data=paused))

    def reset(self) -> None:
        """Put the organ back to its start."""
        self._call("reset", Trigger.Request())

    def undo(self) -> None:
        """Take back the newest edit of the tissue."""
        self._call("undo", Undo.Request(author=self.get_name(), request_id=self._new_id()))

    def redo(self) -> None:
        """Make the edit again that was undone last."""
        self._call("redo", Undo.Request(author=self.get_name(), request_id=self._new_id()))

    # What the simulation says

    def _on_topology(self, message: Topology) -> None:
        epoch = epoch_of(message)
        if self._replica.wants_keyframe(epoch, message.version):
            self._replica.take_keyframe(epoch, topology_to_mesh(message))
            self._make_tool()

    def _on_edit(self, message: TopologyEdit) -> None:
        self._replica.take_edit(epoch_of(message), edit_from_msg(message))

    def _on_state(self, message: TissueState) -> None:
        positions = positions_from_state(message)
        self._replica.take_state(epoch_of(message), message.version, message.frame, positions)

    def _on_status(self, message: Status) -> None:
        states = {0: "loading", 1: "ready", 2: "paused", 3: "failed"}
        text = f"**{message.organ}**, {message.model}, {states.get(message.state, '?')}"
        self.page.show_status(f"{text}  \n{message.message}" if message.message else text)

    # What goes out

    def _draw(self) -> None:
        shape, mesh = self._replica.shape_at(), self._replica.mesh
        if shape is None or mesh is None:
            return
        version = (self._replica.epoch, mesh.version)
        if version != self._shown:
            triangles = surface_triangles(mesh)
            self._surface_nodes, corners = np.unique(triangles, return_inverse=True)
            faces = corners.reshape(-1, 3).astype(np.uint32)
            self.page.show_topology(shape.positions[self._surface_nodes], faces)
            self._shown = version
        else:
            self.page.show_positions(shape.positions[self._surface_nodes])

    def _publish_pose(self) -> None:
        with self._lock:
            point = self._point
        if point is not None:
            self._topics.pose(Pose(point, np.array([0.0, 0.0, 0.0, 1.0])))

    def _make_tool(self) -> None:
        request = SetTool.Request(request_id=self._new_id())
        request.tool.id, request.tool.kind, request.tool.shape = self._tool, Tool.GRAB, Tool.SPHERE
        request.tool.size = [float(self._radius)]
        request.tool.owner = self.get_fully_qualified_name()
        centre = np.zeros(3)
        if self._replica.mesh is not None:
            centre = self._replica.mesh.rest[: self._replica.mesh.node_rows].mean(axis=0)
        request.tool.pose = pose_message(Pose(centre, np.array([0.0, 0.0, 0.0, 1.0])))
        self._call("set_tool", request)

    def _new_id(self) -> str:
        self._requests += 1
        return f"{self.get_name()}-{time.time_ns():x}-{self._requests}"

    def _call(self, service: str, request: object) -> None:
        client = self._asks[service]
        if not client.service_is_ready():
            self.page.show_status(f"tissue/{service} is not there: is its node running?")
            return
        future = client.call_async(request)
        future.add_done_callback(lambda done: self._answered(service, done.result()))

    def _answered(self, service: str, answer: object) -> None:
        success, message = getattr(answer, "success", False), getattr(answer, "message", "")
        if not success:
            self.page.show_status(f"{service}: {message}")
            self.get_logger().warning(f"{service} was refused: {message}")


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run(MouseNode, args)


if __name__ == "__main__":
    sys.exit(main())
