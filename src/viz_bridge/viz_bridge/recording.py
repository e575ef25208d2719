"""Draws an organ's messages into a rerun recording: the same code live and out of a bag."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from tissue_sim.geometry.sutures import Sutures
from viz_bridge.blueprints import session_blueprint
from viz_bridge.cdr import Message
from viz_bridge.drawn_difference import DrawnDifference
from viz_bridge.drawn_holes import log_holes
from viz_bridge.organ_follower import OrganFollower
from viz_bridge.organ_surface import OrganSurface, SurfacePart, surface_of
from viz_bridge.session_events import SessionEvent, nanoseconds
from viz_bridge.tool_shapes import DrawnTool, blade_corners

APPLICATION = "tissue_sim"
METRES_PER_NEWTON = 0.01
STEEL, PRESSED, FROZEN = (196, 204, 214), (255, 196, 92), (120, 132, 150)
FORCE = (102, 204, 255)
THREAD, THREAD_RADIUS = (66, 88, 196), 0.0004
_PARTS = ("outside", "inside")


class Recording:
    """Logs to one rerun stream.

    Topology is logged in time at each version, never as static: a static triangle list would hide
    every later one. Positions and normals are logged for each state; a state is never drawn on
    another version.

    Attributes:
        states: States drawn.
        organ: What is known of the organ.
    """

    def __init__(self, stream: rr.RecordingStream, max_hz: float = 0.0) -> None:
        """Draw into a stream.

        Args:
            stream: Where to.
            max_hz: States drawn a second at most; 0 for all. A new version is always drawn.
        """
        self.stream = stream
        self.organ = OrganFollower()
        self.states = 0
        self._period = 1e9 / max_hz if max_hz > 0 else 0.0
        self._next = 0.0
        self._surface: OrganSurface | None = None
        self._looks: dict[str, object] = {}
        self._colors: dict[str, tuple[int, int, int]] = {}
        self._blueprint_sent = self._sewn = False
        self._difference = DrawnDifference(stream)
        self._early: Message | None = None
        self._received = 0
        self._last_status = ""
        self._warned: dict[str, str] = {}
        self._takers: dict[str, Callable[[Message], None]] = {
            "tissue/state": self._take_state,
            "tissue/difference": self._take_difference,
            "tissue/topology": self._take_topology,
            "tissue/edits": self._take_edit,
            "tissue/journal": self._take_journal,
            "tissue/tools": self._take_tools,
            "tissue/status": self._take_status,
            "tissue/holes": self._take_holes,
            "script/event": self._take_text,
            "/diagnostics": self._take_diagnostics,
        }

    def takes(self, topic: str) -> bool:
        """Whether a topic, relative to the organ's namespace, is drawn at all."""
        return topic in self._takers or topic.endswith("/measured_cf")

    def take(self, topic: str, message: Message, received: int) -> None:
        """Draw a message.

        Args:
            topic: Relative to the organ's namespace; `/diagnostics` is absolute.
            message: As decoded.
            received: When it was received [ns since 1970], for messages without a time of their
                own.
        """
        self._received = received
        taker = self._takers.get(topic)
        if taker is not None:
            taker(message)
        elif topic.endswith("/measured_cf"):
            self._take_force(topic.split("/")[1], message)

    def close(self, timeout: float = 5.0) -> None:
        """Write what is still on its way."""
        # A viewer that has stopped takes nothing any more: the end must not wait for it.
        with contextlib.suppress(RuntimeError, ValueError, TimeoutError):
            self.stream.flush(timeout_sec=timeout)
        self.stream.disconnect()

    def _at(self, stamp: int, sim_time: float | None = None, frame: int | None = None) -> None:
        self.stream.set_time("clock", timestamp=stamp / 1e9)
        time = self.organ.sim_time if sim_time is None else sim_time
        self.stream.set_time("sim_time", duration=time)
        self.stream.set_time("frame", sequence=self.organ.frame if frame is None else frame)

    def _take_topology(self, message: Message) -> None:
        if self.organ.take_topology(message):
            self._changed()

    def _take_edit(self, message: Message) -> None:
        if self.organ.take_edit(message):
            self._changed()

    def _changed(self) -> None:
        self._surface = None
        early, self._early = self._early, None
        if early is not None:
            self._take_state(early)

    def _take_state(self, message: Message) -> None:
        positions = self.organ.take_state(message)
        if positions is None or self.organ.mesh is None:
            # Its edit or keyframe may come after it.
            self._early = message
            return
        self._early = None
        stamp = nanoseconds(message.header.stamp)
        if self._surface is not None and 0 < self._next - stamp < 2 * self._period:
            return
        # Half a period of tolerance keeps the rate in spite of jitter.
        self._next = max(self._next + self._period, stamp + 0.5 * self._period)
        if self._next - stamp > 2 * self._period:
            self._next = stamp + self._period
        self._at(stamp)
        if self._surface is None:
            self._surface = surface_of(self.organ.mesh)
            self._difference.remember(self.organ.replica.epoch, self._surface)
            self._log_topology(positions)
        else:
            for name in _PARTS:
                part: SurfacePart = getattr(self._surface, name)
                if len(part.triangles):
                    vertices = part.vertices(positions)
                    moved = rr.Mesh3D.from_fields(
                        vertex_positions=vertices, vertex_normals=part.normals(vertices)
                    )
                    self.stream.log(f"organ/{name}", moved)
        self._log_sutures(self.organ.mesh.sutures, positions)
        # The list of tools comes a moment after the first state, if at all.
        if not self._blueprint_sent and (self.organ.tools.by_id or self.states >= 2):
            self._blueprint_sent = True
            self._send_blueprint(positions)
        self.states += 1

    def _send_blueprint(self, positions: NDArray[np.float32]) -> None:
        tips = [t.tip for t in self.organ.tools.by_id.values() if t.kind == "grab"]
        self.stream.send_blueprint(session_blueprint(positions, tips, self._difference.drawn > 0))

    def _take_difference(self, message: Message) -> None:
        first = self._difference.drawn == 0
        # The second model may be behind: what it shows belongs to its own frame.
        stamp = nanoseconds(message.header.stamp)
        self._at(stamp, float(message.sim_time), int(message.frame))
        shape = self.organ.replica.shape_at(0)
        if self._difference.take(message) and first and shape is not None:
            self._blueprint_sent = True
            self._send_blueprint(shape.positions)

    def _log_topology(self, positions: NDArray[np.float32]) -> None:
        for name in _PARTS:
            part: SurfacePart = getattr(self._surface, name)
            path = f"organ/{name}"
            if not len(part.triangles):
                self.stream.log(path, rr.Clear(recursive=False))
                continue
            vertices = part.vertices(positions)
            self.stream.log(
                path,
                rr.Mesh3D(
                    vertex_positions=vertices,
                    triangle_indices=part.triangles,
                    vertex_normals=part.normals(vertices),
                    vertex_colors=part.colors,
                ),
            )

    def _log_sutures(self, sutures: Sutures, positions: NDArray[np.float32]) -> None:
        """Threads, and a knot at each end: where lips are closed there is nothing else to see."""
        if not len(sutures):
            if self._sewn:
                self.stream.log("organ/sutures", rr.Clear(recursive=True))
            self._sewn = False
            return
        self._sewn = True
        ends = positions[sutures.nodes]
        threads = rr.LineStrips3D(ends, radii=[THREAD_RADIUS], colors=[THREAD])
        knots = rr.Points3D(ends.reshape(-1, 3), radii=[1.6 * THREAD_RADIUS], colors=[THREAD])
        self.stream.log("organ/sutures", threads)
        self.stream.log("organ/sutures/knots", knots)

    def _take_journal(self, message: Message) -> None:
        events = self.organ.take_journal(message)
        self._at(nanoseconds(message.header.stamp))
        for tool in self.organ.tools.by_id.values():
            self._log_tool(tool)
        for event in events:
            self._log_event(event)

    def _log_event(self, event: SessionEvent) -> None:
        self.stream.log("events", rr.TextLog(event.text, level=event.level))

    def _log_tool(self, tool: DrawnTool) -> None:
        path = f"tools/{tool.id}"
        if self._looks.get(tool.id) != tool.look:
            self._looks[tool.id] = tool.look
            self._colors.pop(tool.id, None)
        color = PRESSED if tool.use else FROZEN if tool.state == "frozen" else STEEL
        if self._colors.get(tool.id) != color:
            self._colors[tool.id] = color
            self._log_shape(path, tool, color)
        self.stream.log(
            path, rr.Transform3D(translation=tool.tip, quaternion=rr.Quaternion(xyzw=tool.pose[3:]))
        )

    def _log_shape(self, path: str, tool: DrawnTool, color: tuple[int, int, int]) -> None:
        if tool.shape == "sphere":
            radius = tool.size[0] if tool.size else 0.005
            reach = rr.Ellipsoids3D(
                radii=[radius],
                colors=[color],
                line_radii=[0.012 * radius],
                fill_mode="majorwireframe",
            )
            tip = rr.Ellipsoids3D(radii=[0.18 * radius], colors=[color], fill_mode="solid")
            self.stream.log(f"{path}/reach", reach)
            self.stream.log(f"{path}/tip", tip)
            return
        if tool.shape == "box":
            half = [0.5 * length for length in tool.size]
            self.stream.log(f"{path}/reach", rr.Boxes3D(half_sizes=[half], colors=[color]))
            return
        if tool.shape == "capsule":
            radius, length = tool.size
            self.stream.log(
                f"{path}/reach",
                rr.Capsules3D(lengths=[length], radii=[radius], colors=[color]),
            )
            return
        corners = blade_corners(tool)
        triangles = [[0, 1, 2]] if len(corners) == 3 else [[0, 1, 2], [0, 2, 3]]
        blade = rr.Mesh3D(
            vertex_positions=corners,
            triangle_indices=triangles,
            vertex_normals=np.tile([0.0, 1.0, 0.0], (len(corners), 1)),
            albedo_factor=(*color, 255),
        )
        self.stream.log(f"{path}/blade", blade)

    def _take_tools(self, message: Message) -> None:
        before = set(self.organ.tools.by_id)
        self.organ.tools.take_list(message)
        self._at(self._received)
        for gone in before - set(self.organ.tools.by_id):
            self.stream.log(f"tools/{gone}", rr.Clear(recursive=True))
            self.stream.log(f"forces/{gone}", rr.Clear(recursive=True))
            self._looks.pop(gone, None)
            self._colors.pop(gone, None)
        for tool in self.organ.tools.by_id.values():
            self._log_tool(tool)

    def _take_force(self, tool_id: str, message: Message) -> None:
        self.organ.tools.take_force(tool_id, message)
        tool = self.organ.tools.by_id.get(tool_id)
        if tool is None:
            return
        self._at(nanoseconds(message.header.stamp))
        arrow = rr.Arrows3D(
            vectors=[tool.force * METRES_PER_NEWTON],
            origins=[tool.tip],
            radii=[0.0008],
            colors=[FORCE],
        )
        self.stream.log(f"forces/{tool_id}", arrow)
        self.stream.log(f"plots/force/{tool_id}", rr.Scalars(float(np.linalg.norm(tool.force))))

    def _take_status(self, message: Message) -> None:
        names = ("loading", "ready", "paused", "failed")
        state = names[message.state] if message.state < len(names) else str(message.state)
        text = f"{message.organ}, {message.model}: {state}"
        if message.message:
            text += f": {message.message}"
        if text != self._last_status:
            self._last_status = text
            self._at(self._received)
            level = "ERROR" if state == "failed" else "INFO"
            self.stream.log("events", rr.TextLog(text, level=level))

    def _take_holes(self, message: Message) -> None:
        self._at(self._received)
        log_holes(self.stream, self.organ, message)

    def _take_text(self, message: Message) -> None:
        self._at(self._received)
        self.stream.log("events", rr.TextLog(str(message.data), level="INFO"))

    def _take_diagnostics(self, message: Message) -> None:
        for status in message.status:
            level = int(status.level)
            text = f"{status.name}: {status.message}"
            # Figures change every second: what is new is a warning in other words.
            words = re.sub(r"[\d.]+", "#", text)
            if level and self._warned.get(status.name) != words:
                self._at(self._received)
                self.stream.log("events", rr.TextLog(text, level="WARN" if level == 1 else "ERROR"))
            self._warned[status.name] = words if level else ""


def file_stream(path: str) -> rr.RecordingStream:
    """A stream into a new .rrd file.

    Raises:
        OSError: The file cannot be written.
    """
    with open(path, "wb"):
        pass
    stream = rr.RecordingStream(APPLICATION)
    stream.save(path)
    return stream
