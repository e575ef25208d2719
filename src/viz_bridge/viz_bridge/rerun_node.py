"""Node `rerun`: shows the organ in rerun's viewer, or records it for rerun."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import rerun as rr
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import QoSProfile

from tissue_sim import qos
from tissue_sim.node_main import declare, run
from tissue_sim.parameters import ParameterError, Spec
from tissue_sim.polled_subscriptions import PolledSubscriptions
from viz_bridge.cdr import Decoder
from viz_bridge.drawing_thread import DrawingThread
from viz_bridge.message_text import message_text
from viz_bridge.recorded_topics import DRAWN, message_class, of_tool
from viz_bridge.recording import APPLICATION, Recording, file_stream
from viz_bridge.viewer_process import ViewerError, ViewerProcess

SPECS = (
    Spec("sink", "string", "viewer", "where to draw: an .rrd file, a viewer's window, both, or a "
         "page on 127.0.0.1", choices=("file", "viewer", "both", "web")),
    Spec("path", "string", "session.rrd", "the .rrd file of sinks file and both"),
    Spec("max_hz", "double", 30.0, "states drawn a second at most; 0: all", unit="Hz",
         minimum=0.0, maximum=1000.0),
    Spec("port", "integer", 0, "where the viewer takes data on 127.0.0.1; 0: any free one",
         minimum=0, maximum=65535),
    Spec("page_port", "integer", 0, "of the page of sink web; 0: any free one", minimum=0,
         maximum=65535),
    Spec("close_timeout", "double", 8.0, "waited for a viewer that takes nothing, at the end",
         unit="s", minimum=0.0, maximum=600.0),
)  # fmt: skip


TAKING_PERIOD = 0.01
AFTER_VIEWER_SECONDS = 5.0
"""Longest wait for what was stuck on a viewer, once that has ended."""


class RerunNode(Node):
    """Takes messages raw and hands them to one drawing thread per sink."""

    def __init__(self) -> None:
        super().__init__("rerun")
        self._values = declare(self, SPECS)
        self._viewer: ViewerProcess | None = None
        self._threads: list[DrawingThread] = []
        self._decoders: dict[str, Decoder] = {}
        self._tools: set[str] = set()
        self._heard = PolledSubscriptions(self)
        self._open_sinks()
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        for topic in DRAWN:
            self._subscribe(topic.name, topic.type_name, topic.profile)
        self.create_timer(TAKING_PERIOD, self._heard.take)
        self.create_timer(1.0, self._report)

    def close(self) -> None:
        """Finish the recording, with what is waiting for it, and end the viewer."""
        self._heard.take()
        deadline = time.monotonic() + self._values["close_timeout"]
        for thread in self._threads:
            if not thread.close(max(0.1, deadline - time.monotonic())):
                print(f"[rerun]: {thread.name} takes nothing any more", file=sys.stderr, flush=True)
        if self._viewer is not None:
            self._viewer.stop()
            # What was stuck on the viewer fails now. A thread that does so while Python is being
            # taken down aborts the process.
            for thread in self._threads:
                thread.close(AFTER_VIEWER_SECONDS)

    def _open_sinks(self) -> None:
        sink = self._values["sink"]
        if sink in ("file", "both"):
            path = Path(self._values["path"])
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                stream = file_stream(str(path))
            except OSError as error:
                raise ParameterError(f"path {path} cannot be written: {error.strerror}") from None
            self._draw_to(str(path), stream)
            self.get_logger().info(f"recording to {path}")
        if sink in ("viewer", "both", "web"):
            try:
                self._viewer = ViewerProcess(
                    sink == "web", self._values["port"], self._values["page_port"]
                )
            except ViewerError as error:
                if sink != "both":
                    raise ParameterError(str(error)) from None
                self.get_logger().error(f"{error}; only the file is written")
                return
            stream = rr.RecordingStream(APPLICATION)
            stream.connect_grpc(self._viewer.url)
            self._draw_to("the viewer", stream)
            where = self._viewer.page or self._viewer.url
            self.get_logger().info(f"showing on {where}")

    def _draw_to(self, name: str, stream: rr.RecordingStream) -> None:
        max_hz = self._values["max_hz"]
        self._threads.append(DrawingThread(name, lambda: Recording(stream, max_hz)))

    def _subscribe(self, name: str, type_name: str, profile: QoSProfile) -> None:
        if type_name not in self._decoders:
            self._decoders[type_name] = Decoder(type_name, message_text(type_name))
        decoder = self._decoders[type_name]

        def receive(data: bytes, info: dict[str, int]) -> None:
            self._receive(name, decoder, data, info["received_timestamp"])

        self._heard.add(message_class(type_name), name, receive, profile, raw=True)

    def _receive(self, topic: str, decoder: Decoder, data: bytes, received: int) -> None:
        if topic == "tissue/tools":
            for tool in decoder(data).tools:
                self._follow(tool.id)
        for thread in self._threads:
            thread.put(topic, decoder, data, received)

    def _follow(self, tool: str) -> None:
        if tool in self._tools:
            return
        self._tools.add(tool)
        for topic in of_tool(tool):
            if topic.name.endswith("/measured_cf"):
                self._subscribe(topic.name, topic.type_name, topic.profile)

    def _report(self) -> None:
        array = DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        for thread in self._threads:
            status = DiagnosticStatus(
                level=DiagnosticStatus.ERROR if thread.failure else DiagnosticStatus.OK,
                name=f"{self.get_fully_qualified_name()}: drawing",
                message=thread.failure or "drawing",
                hardware_id=thread.name,
            )
            status.values = [
                KeyValue(key="states drawn", value=str(thread.drawn)),
                KeyValue(key="states passed over", value=str(thread.passed_over)),
                KeyValue(key="messages dropped", value=str(thread.dropped)),
            ]
            deaf = self._heard.incompatible()
            if deaf and not thread.failure:
                status.level, status.message = DiagnosticStatus.WARN, "; ".join(deaf.values())
            array.status.append(status)
        self._diagnostics.publish(array)


def main(args: list[str] | None = None) -> None:
    """Draw until interrupted."""
    sys.exit(run(RerunNode, args))


if __name__ == "__main__":
    main()
