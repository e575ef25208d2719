"""Node `script`: plays a procedure: publishes poses and uses, calls services, ends with it."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from tissue_interfaces.msg import Journal, Status, Tool, ToolList
from tissue_interfaces.srv import SetTool

from tissue_sim import node_main, qos
from tissue_sim.whole_files import write_json
from tool_input.motion import Pose
from tool_input.player import Player
from tool_input.procedure import Event, Procedure, ProcedureTool, load_procedure
from tool_input.script_clock import SimulationClock, WallClock
from tool_input.script_parameters import SPECS, ScriptParameters
from tool_input.script_requests import Requests
from tool_input.tool_topics import ToolTopics, pose_message

EVENTS = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
POLL_SECONDS = 0.02

LONGEST_SILENCE = 120.0
"""Time without the simulation's journal after which a procedure that goes by it is given up [s]."""


class ScriptError(RuntimeError):
    """The procedure cannot go on; the message says why."""


class ScriptNode(Node):
    """Plays one procedure in a thread of its own while the executor takes messages and answers.

    Attributes:
        exit_code: 0 when everything was played and no request failed.
    """

    def __init__(self) -> None:
        super().__init__("script")
        self.settings = ScriptParameters.of(node_main.declare(self, SPECS))
        self.procedure: Procedure = load_procedure(Path(self.settings.procedure))
        self.exit_code = 1
        self._status: Status | None = None
        self._tools: dict[str, Tool] | None = None
        self._topics = {
            name: ToolTopics(self, name, self.procedure.frame_id) for name in self.procedure.tools
        }
        self._events: Publisher | None = None
        self._clock_source = SimulationClock() if self.settings.clock == "simulation" else None
        self._requests = Requests(self, self.procedure, self._say, self.settings.service_timeout)
        self.create_subscription(Status, "tissue/status", self._on_status, qos.LATCHED)
        self.create_subscription(ToolList, "tissue/tools", self._on_tools, qos.LATCHED)
        if self._clock_source is not None:
            self.create_subscription(
                Journal, "tissue/journal", self._clock_source.hear, qos.JOURNAL_CLOCK
            )
        self._player = Player(self.procedure, self)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._play, name="script", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ended.set()
        self._thread.join(timeout=5.0)

    # What the player calls

    def pose(self, tool: str, pose: Pose) -> None:
        """Publish a tool's pose."""
        self._topics[tool].pose(pose)

    def use(self, tool: str, pressed: bool) -> None:
        """Publish a tool's use."""
        self._topics[tool].use(pressed)
        if self._player.time > 0.0 or pressed:
            self._say(f"{'press' if pressed else 'release'} {tool}")

    def act(self, event: Event) -> None:
        """Call the service an event needs, or show its label."""
        self._say(event.target if event.action == "label" else str(event))
        if event.action == "pause" and self._clock_source is not None:
            self._clock_source.pause(bool(event.value))
        if event.action != "label":
            self._requests.send(event)

    # What the executor calls

    def _on_status(self, message: Status) -> None:
        self._status = message

    def _on_tools(self, message: ToolList) -> None:
        self._tools = {tool.id: tool for tool in message.tools}

    # The thread

    def _play(self) -> None:
        try:
            self._get_ready()
            self._run()
            self._requests.finish(self._ended)
            self._say(f"over after {self._player.time:.2f} s")
            if self._events is not None:
                self._events.wait_for_all_acked(Duration(seconds=1.0))
            self.exit_code = 0 if not self._requests.failures else 1
        except ScriptError as error:
            if not self._ended.is_set():
                self.get_logger().error(str(error))
        except Exception as error:
            if rclpy.ok():
                self.get_logger().error(f"the procedure failed: {type(error).__name__}: {error}")
        if self.settings.report:
            self._write_report(Path(self.settings.report))
        rclpy.try_shutdown()

    def _get_ready(self) -> None:
        """Wait for everything that may be slow to be found before the simulation's clock starts."""
        patience = self.settings.start_timeout
        self._wait(lambda: self._status is not None, patience, "nothing is heard on tissue/status")
        self._wait(lambda: self._tools is not None, patience, "nothing is heard on tissue/tools")
        self._find_listeners([name for name in self._topics if name in (self._tools or {})])
        for service in self._requests.needed():
            self._wait(service.service_is_ready, patience, f"no service {service.srv_name}")
        # Whoever waits for somebody to offer this topic starts when the procedure can begin.
        self._events = self.create_publisher(String, "script/event", EVENTS)
        self._wait(self._ready, patience, "tissue/status does not say READY")
        self._make_tools()
        self._find_listeners(self._topics)

    def _find_listeners(self, tools: Iterable[str]) -> None:
        wanted = self.settings.listeners

        def deaf() -> list[str]:
            return [name for name in tools if self._topics[name].listeners < wanted]

        self._wait(
            lambda: not deaf(),
            self.settings.start_timeout,
            lambda: f"fewer than {wanted} listen to tools/<tool>/servo_cp of {', '.join(deaf())}",
        )

    def _ready(self) -> bool:
        if self._status is not None and self._status.state == Status.FAILED:
            raise ScriptError(f"the simulation failed: {self._status.message}")
        return self._status is not None and self._status.state == Status.READY

    def _make_tools(self) -> None:
        known = self._tools or {}
        for name, tool in self.procedure.tools.items():
            there = known.get(name)
            if there is not None and there.kind != tool.kind:
                raise ScriptError(
                    f"tool {name} is a {there.kind} tool there, not a {tool.kind} tool"
                )
            if there is None and not tool.shape:
                raise ScriptError(
                    f"the simulation has no tool {name}; "
                    f"known: {', '.join(known) or 'none'}. "
                    "Give its shape and size in the procedure, and it will be made"
                )
            if _differs(tool, there):
                self._make_tool(tool, there)

    def _make_tool(self, tool: ProcedureTool, there: Tool | None) -> None:
        client = self.create_client(SetTool, "tissue/set_tool")
        self._wait(client.service_is_ready, self.settings.start_timeout, "no tissue/set_tool")
        request = SetTool.Request(request_id=f"script-tool-{tool.name}-{time.time_ns()}")
        request.tool.id, request.tool.kind = tool.name, tool.kind
        request.tool.shape = tool.shape or (there.shape if there is not None else "")
        size = tool.size or (tuple(there.size) if there is not None else ())
        request.tool.size = [float(value) for value in size]
        request.tool.cutting = tool.cutting
        for name, value in tool.response.items():
            setattr(request.tool, name, float(value))
        request.tool.owner = self.get_fully_qualified_name()
        request.tool.pose = pose_message(tool.start)
        answer = client.call_async(request)
        self._wait(answer.done, self.settings.service_timeout, "tissue/set_tool does not answer")
        if not answer.result().success:
            raise ScriptError(f"tool {tool.name} was refused: {answer.result().message}")

    def _run(self) -> None:
        clock = self._clock_source or WallClock()
        self._player.begin()
        clock.start()
        period = 1.0 / self.settings.pose_hz
        deadline = time.monotonic()
        announced = -1
        while not self._player.over:
            deadline = max(deadline + period, time.monotonic() - period)
            if self._ended.wait(max(0.0, deadline - time.monotonic())):
                raise ScriptError("asked to end before the procedure was over")
            if self._status is not None and self._status.state == Status.FAILED:
                raise ScriptError(f"the simulation failed: {self._status.message}")
            if clock.silence() > LONGEST_SILENCE:
                raise ScriptError(f"no tissue/journal for {clock.silence():.0f} s")
            self._player.advance(clock.now())
            tenth = int(10 * min(self._player.time / self.procedure.end, 1.0))
            if tenth > announced:
                announced = tenth
                self.get_logger().info(f"{self.procedure.title}: {10 * tenth} %")

    def _wait(
        self, condition: Callable[[], bool], seconds: float, problem: str | Callable[[], str]
    ) -> None:
        """Wait for a condition."""
        deadline = time.monotonic() + seconds
        while not condition():
            if self._ended.wait(POLL_SECONDS):
                raise ScriptError("asked to end before the procedure began")
            if time.monotonic() > deadline:
                text = problem if isinstance(problem, str) else problem()
                raise ScriptError(f"{text} after {seconds:g} s")

    def _say(self, text: str) -> None:
        if self._events is not None:
            self._events.publish(String(data=text))
        self.get_logger().info(f"{self._player.time:6.2f} s  {text}")

    def _write_report(self, path: Path) -> None:
        report: dict[str, Any] = {
            "title": self.procedure.title,
            "seconds": round(self._player.time, 3),
            "exit_code": self.exit_code,
            "requests": self._requests.log,
        }
        write_json(path, report)


def _differs(tool: ProcedureTool, there: Tool | None) -> bool:
    """Whether a procedure wants a tool to be other than it is."""
    if there is None:
        return True
    if tool.shape and (there.shape != tool.shape or tuple(there.size) != tool.size):
        return True
    felt = {name: getattr(there, name) for name in tool.response}
    return bool(tool.cutting) and (there.cutting != tool.cutting or felt != tool.response)


def main(args: list[str] | None = None) -> None:
    """Entry point."""
    sys.exit(node_main.run(ScriptNode, args))


if __name__ == "__main__":
    main()
