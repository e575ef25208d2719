"""Node `bag`: records what goes in and what comes out of the simulation into a bag."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import rclpy.parameter
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.parameter_client import AsyncParameterClient
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from std_srvs.srv import Trigger
from tissue_interfaces.msg import ToolList

from tissue_sim import qos
from tissue_sim.node_main import declare, run
from tissue_sim.parameters import ParameterError, Spec
from tissue_sim.polled_subscriptions import PolledSubscriptions, Receiver
from viz_bridge.bag_writer import GB, BagOptions, BagWriter, Origin, free_bytes
from viz_bridge.provenance import provenance
from viz_bridge.recorded_topics import (
    FIXED,
    STATE,
    RecordedTopic,
    message_class,
    of_tool,
    offered,
    tool_of,
)
from viz_bridge.state_thinning import StateThinning

SPECS = (
    Spec("bag", "string", "session", "directory of the bag; must not exist, or be empty"),
    Spec("record_state_hz", "double", 10.0, "states kept a second; 0 or at least 60: all",
         unit="Hz", minimum=0.0, maximum=1000.0),
    Spec("compression", "string", "lz4", "of the bag's chunks", choices=("none", "lz4", "zstd")),
    Spec("min_free_gb", "double", 1.0, "the bag is ended when less is free on its disk",
         unit="GB", minimum=0.0),
    Spec("queue_mb", "double", 256.0, "messages that may wait for the disk", unit="MB",
         minimum=1.0, maximum=16384.0),
    Spec("record_at_start", "bool", True, "record at once; otherwise wait for bag/start"),
    Spec("extra_topics", "strings", [], "further topics to record, as name:package/msg/Type"),
    Spec("notes", "strings", [], "written into the bag's metadata, as key=value"),
    Spec("attachments", "strings", [], "files to put into the bag, such as the scene"),
)  # fmt: skip
TAKING_PERIOD = 0.01
DISCOVERY_PERIOD = 0.25
FIRST_REPORT_SECONDS = 5.0


class BagNode(Node):
    """Subscribes raw to everything worth keeping and hands the bytes to a `BagWriter`."""

    def __init__(self) -> None:
        super().__init__("bag")
        self._values = declare(self, SPECS)
        self._extra = [_extra_topic(text) for text in self._values["extra_topics"]]
        self._notes = dict(_note(text) for text in self._values["notes"])
        self._attachments = [_attachment(Path(name)) for name in self._values["attachments"]]
        self._writer: BagWriter | None = None
        self._heard = PolledSubscriptions(self)
        self._tools: set[str] = set()
        self._thinning = StateThinning(self._values["record_state_hz"])
        self._paused = False
        self._sessions = 0
        self._flow: tuple[float, int] | None = None
        self._reported = False
        self._asked_for_parameters = False
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        for name, answer in (
            ("start", self._on_start),
            ("stop", self._on_stop),
            ("pause", self._on_pause),
            ("split", self._on_split),
        ):
            self.create_service(Trigger, f"bag/{name}", answer)
        if self._values["record_at_start"]:
            self._start()
        self.create_timer(TAKING_PERIOD, self._heard.take)
        self.create_timer(DISCOVERY_PERIOD, self._discover)
        self.create_timer(1.0, self._report)

    def close(self) -> None:
        """End the bag."""
        if self._writer is not None:
            self._stop()

    def _start(self) -> None:
        bag = Path(self._values["bag"])
        if self._sessions:
            bag = bag.with_name(f"{bag.name}_{self._sessions + 1}")
        options = BagOptions(
            compression=self._values["compression"],
            queue_bytes=int(self._values["queue_mb"] * 1e6),
            min_free_gb=self._values["min_free_gb"],
        )
        self._writer = BagWriter(bag, options, self._say)
        self._sessions += 1
        self._writer.describe("tissue_sim", provenance() | self._notes)
        for name, media_type, data in self._attachments:
            self._writer.attach(name, media_type, data)
        self._paused, self._reported, self._asked_for_parameters = False, False, False
        self._flow = None
        # Subscribed anew, so that every bag begins with what is latched.
        self._thinning = StateThinning(self._values["record_state_hz"])
        for topic in (*FIXED, *self._extra):
            self._subscribe(topic)
        self._discover()
        self.get_logger().info(f"recording to {bag}")

    def _stop(self) -> str:
        """End the bag, with what is waiting for it."""
        assert self._writer is not None
        self._heard.take()
        self._heard.clear()
        self._tools.clear()
        writer, self._writer = self._writer, None
        info = writer.close()
        dropped = sum(writer.counts.dropped.values())
        text = (
            f"{writer.directory}: {info.messages} messages, {writer.counts.bytes / 1e6:.1f} MB, "
            f"{info.seconds:.1f} s; {dropped} messages dropped"
        )
        if dropped:
            self._say("warn", text + f" ({dict(writer.counts.dropped)})")
        else:
            self._say("info", text)
        return text

    def _subscribe(self, topic: RecordedTopic) -> None:
        name = self.resolve_topic_name(topic.name)
        kind = message_class(topic.type_name)
        self._heard.add(kind, name, self._receiver(name, topic), topic.profile, raw=True)

    def _receiver(self, name: str, topic: RecordedTopic) -> Receiver:
        is_state = topic.name == STATE
        is_tools = topic.name == "tissue/tools"
        origin: Origin | None = None

        def receive(data: bytes, info: dict[str, int]) -> None:
            nonlocal origin
            writer = self._writer
            if is_tools:
                self._follow(deserialize_message(data, ToolList))
            if writer is None or (self._paused and not topic.latched):
                return
            if is_state and not self._thinning.keeps(data):
                return
            if origin is None:
                origin = Origin(offered(self.get_publishers_info_by_topic(name)))
            received = int(info.get("received_timestamp", 0)) or time.time_ns()
            published = int(info.get("source_timestamp", 0))
            writer.write(name, topic.type_name, data, received, published, origin)

        return receive

    def _follow(self, tools: ToolList) -> None:
        for tool in tools.tools:
            self._record_tool(tool.id)

    def _record_tool(self, tool: str) -> None:
        if tool not in self._tools and self._writer is not None:
            self._tools.add(tool)
            for topic in of_tool(tool):
                self._subscribe(topic)

    def _discover(self) -> None:
        if self._writer is None:
            return
        for topic, _types in self.get_topic_names_and_types():
            tool = tool_of(topic, self.get_namespace())
            if tool is not None:
                self._record_tool(tool)
        if not self._asked_for_parameters:
            self._ask_for_parameters()

    def _ask_for_parameters(self) -> None:
        """Put the simulation's parameters, the seed among them, into the bag."""
        publishers = self.get_publishers_info_by_topic(self.resolve_topic_name(STATE))
        if not publishers:
            return
        source = f"{publishers[0].node_namespace.rstrip('/')}/{publishers[0].node_name}"
        client = AsyncParameterClient(self, source)
        if not client.services_are_ready():
            return
        self._asked_for_parameters = True
        writer = self._writer

        def on_values(names: list[str], done: Future) -> None:
            answer = done.result()
            if answer is None or writer is None or writer.ended:
                return
            values = {
                name: rclpy.parameter.parameter_value_to_python(value)
                for name, value in zip(names, answer.values, strict=True)
            }
            text = json.dumps({source: values}, indent=1, default=list)
            writer.attach("parameters.json", "application/json", text.encode())
            seed = {"seed": str(values["seed"])} if "seed" in values else {}
            writer.describe("tissue_sim/parameters", {"simulation": source, **seed})

        def on_names(done: Future) -> None:
            answer = done.result()
            names = list(answer.result.names) if answer is not None else []
            if names:
                future = client.get_parameters(names)
                future.add_done_callback(lambda values: on_values(names, values))

        client.list_parameters([], 0).add_done_callback(on_names)

    def _report(self) -> None:
        writer = self._writer
        if writer is None:
            return
        now = time.monotonic()
        if self._flow is None and writer.counts.written[self.resolve_topic_name(STATE)]:
            self._flow = (now, writer.counts.bytes)
        # Measured from the first state on: before, next to nothing is published.
        began, before = self._flow or (now, writer.counts.bytes)
        seconds = now - began
        megabytes = writer.counts.bytes / 1e6
        free = free_bytes(writer.directory) / GB - self._values["min_free_gb"]
        per_minute = (megabytes - before / 1e6) * 60 / seconds if seconds else 0.0
        hours = free * 1000 / per_minute / 60 if per_minute > 0 else float("inf")
        if not self._reported and seconds >= FIRST_REPORT_SECONDS and per_minute:
            self._reported = True
            self._say("info", f"{per_minute:.1f} MB per minute; room for {hours:,.1f} hours")
        dropped = sum(writer.counts.dropped.values())
        level = DiagnosticStatus.OK
        message = "paused" if self._paused else "recording"
        deaf = self._heard.incompatible()
        if deaf:
            level, message = DiagnosticStatus.WARN, "; ".join(deaf.values())
        if dropped:
            level, message = DiagnosticStatus.WARN, f"{dropped} messages dropped"
        if writer.ended:
            level, message = DiagnosticStatus.ERROR, writer.ended
        status = DiagnosticStatus(level=level, name=f"{self.get_fully_qualified_name()}: recording")
        status.message, status.hardware_id = message, str(writer.directory)
        status.values = [
            KeyValue(key=key, value=value)
            for key, value in (
                ("bag", str(writer.directory)),
                ("megabytes", f"{megabytes:.3f}"),
                ("megabytes_per_minute", f"{per_minute:.3f}"),
                ("hours_left", f"{hours:.2f}"),
                ("messages", str(sum(writer.counts.written.values()))),
                ("dropped", str(dropped)),
            )
        ]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _say(self, level: str, text: str) -> None:
        # One place in the source may log at one severity only.
        if not self.context.ok():
            # An interrupted node has lost its logger's topic, but not its voice.
            print(f"[{level.upper()}] [bag]: {text}", file=sys.stderr, flush=True)
        elif level == "error":
            self.get_logger().error(text)
        elif level == "warn":
            self.get_logger().warn(text)
        else:
            self.get_logger().info(text)

    def _on_start(self, _request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        if self._writer is not None and self._writer.ended:
            self._stop()
        if self._writer is not None:
            answer.success, answer.message = False, f"recording to {self._writer.directory} already"
            return answer
        try:
            self._start()
        except (ValueError, OSError) as error:
            answer.success, answer.message = False, str(error)
            return answer
        assert self._writer is not None
        answer.success, answer.message = True, str(self._writer.directory)
        return answer

    def _on_stop(self, _request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        answer.success = self._writer is not None
        answer.message = self._stop() if self._writer is not None else "nothing is being recorded"
        return answer

    def _on_pause(self, _request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        answer.success = self._writer is not None
        if self._writer is None:
            answer.message = "nothing is being recorded"
            return answer
        self._paused = not self._paused
        answer.message = (
            "paused; topology, edits, status and tools go on" if self._paused else "recording"
        )
        return answer

    def _on_split(self, _request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        answer.success = self._writer is not None and not self._writer.ended
        answer.message = "goes on in a new file" if answer.success else "nothing is being recorded"
        if self._writer is not None and answer.success:
            self._writer.split()
        return answer


def _extra_topic(text: str) -> RecordedTopic:
    name, separator, type_name = text.partition(":")
    if not separator or not name:
        raise ParameterError(f"extra_topics: {text!r} is not name:package/msg/Type")
    message_class(type_name)
    return RecordedTopic(name, type_name, qos.POSE_IN)


def _note(text: str) -> tuple[str, str]:
    key, separator, value = text.partition("=")
    if not separator or not key:
        raise ParameterError(f"notes: {text!r} is not key=value")
    return key, value


def _attachment(path: Path) -> tuple[str, str, bytes]:
    media = {".yaml": "application/yaml", ".json": "application/json"}
    try:
        return path.name, media.get(path.suffix, "application/octet-stream"), path.read_bytes()
    except OSError as error:
        raise ParameterError(f"attachments: {path}: {error.strerror}") from None


def main(args: list[str] | None = None) -> None:
    """Record until interrupted."""
    sys.exit(run(BagNode, args))


if __name__ == "__main__":
    main()
