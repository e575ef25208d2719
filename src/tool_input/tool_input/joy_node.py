"""Node `joy`: a joystick, a gamepad or a 3D mouse drives tools."""

from __future__ import annotations

import sys
import time
from functools import partial

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import Joy
from tissue_interfaces.msg import Tool, ToolList
from tissue_interfaces.srv import SetTool

from tissue_sim import conversions, node_main, qos
from tissue_sim.diagnostics import OK, WARN, Finding
from tool_input.diagnostics_topic import DiagnosticsTopic
from tool_input.input_watch import InputWatch
from tool_input.joy_mapping import InputError, checked_deflection
from tool_input.joy_parameters import JOY, SPECS, TWIST, mapping_of, steering_of
from tool_input.motion import Pose
from tool_input.steering import SteeredTool
from tool_input.tool_topics import ToolTopics

LOOK_SECONDS = 0.1
LONGEST_STEP = 0.1
"""[s] After a longer gap between two poses the tool goes on from where it is, not in one leap."""


class JoyNode(Node):
    """Moves its tools by the velocity a device asks for, as long as the device speaks."""

    def __init__(self) -> None:
        super().__init__("joy")
        values = node_main.declare(self, SPECS)
        self._steering = steering_of(values)
        self._mapping = mapping_of(values)
        moves_by_joy = values["motion"] == JOY
        topic = values["joy_topic"] if moves_by_joy else values["twist_topic"]
        self._input = InputWatch(topic, values["input_timeout"])
        self._moves_by_joy = moves_by_joy
        self._buttons_known = False
        self._measured: dict[str, tuple[Pose, str]] = {}
        self._there: dict[str, Tool] = {}
        self._set_tool = self.create_client(SetTool, "tissue/set_tool")
        self._driven: dict[str, ToolTopics] = {}
        self._owned: set[str] = set()
        self._told: dict[str, tuple[bool, int]] = {}
        self._stepped = time.monotonic()
        for tool in self._steering.tools:
            self.create_subscription(
                PoseStamped,
                f"tools/{tool.name}/measured_cp",
                partial(self._on_measured, tool.name),
                qos.MEASURED,
            )
        self.create_subscription(ToolList, "tissue/tools", self._on_tools, qos.LATCHED)
        if values["joy_topic"]:
            self.create_subscription(Joy, values["joy_topic"], self._on_joy, qos.POSE_IN)
        if not moves_by_joy:
            message = Twist if values["motion"] == TWIST else TwistStamped
            self.create_subscription(message, topic, self._on_twist, qos.POSE_IN)
        self._diagnostics = DiagnosticsTopic(self)
        self.create_timer(1.0 / values["pose_hz"], self._step)
        self.create_timer(LOOK_SECONDS, self._look)
        names = ", ".join(f"tools/{tool.name}" for tool in self._steering.tools)
        self.get_logger().info(f"{topic} drives {names}")

    def close(self) -> None:
        """Let go of what the device holds."""
        for tool in self._steering.tools:
            if tool.used and tool.name in self._driven:
                self._driven[tool.name].use(False)

    # What comes in

    def _on_measured(self, tool: str, message: PoseStamped) -> None:
        pose = conversions.pose_array(message.pose)
        self._measured[tool] = (Pose(pose[:3], pose[3:]), message.header.frame_id)

    def _on_tools(self, message: ToolList) -> None:
        self._there = {tool.id: tool for tool in message.tools}
        for name in self._driven:
            self._own(name)

    def _on_joy(self, message: Joy) -> None:
        try:
            reading = self._mapping.read(message.axes, message.buttons)
        except InputError as error:
            self._refuse(str(error))
            return
        resumed = not self._buttons_known
        if self._moves_by_joy:
            resumed = self._accept()
            self._steering.deflect(reading.deflection)
        self._buttons_known = True
        steered = self._steering.tool
        self._steering.press(reading.pressed, resumed)
        if self._steering.tool is not steered:
            self.get_logger().info(f"drives {self._steering.tool.name}")
        self._take_over()
        self._tell_uses()

    def _on_twist(self, message: Twist | TwistStamped) -> None:
        twist = message.twist if isinstance(message, TwistStamped) else message
        linear, angular = twist.linear, twist.angular
        values = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
        try:
            deflection = checked_deflection(np.array(values))
        except InputError as error:
            self._refuse(str(error))
            return
        self._accept()
        self._steering.deflect(deflection)

    def _accept(self) -> bool:
        """Count a message that moves the tool; whether the device was silent before."""
        resumed = self._input.accept(time.monotonic())
        if resumed:
            self.get_logger().info(f"input on {self._input.topic}")
            for tool in self._steering.tools:
                self._find(tool)
        return resumed

    def _refuse(self, reason: str) -> None:
        self._input.refuse(reason)
        self.get_logger().warning(
            f"a message was left out because {reason}", throttle_duration_sec=1.0
        )

    # What goes out

    def _step(self) -> None:
        now = time.monotonic()
        seconds, self._stepped = min(now - self._stepped, LONGEST_STEP), now
        if self._input.lost(now):
            self._steering.stop()
            self._buttons_known = False
            self.get_logger().warning(self._input.silence)
        if not self._input.fresh:
            return
        self._take_over()
        self._steering.advance(seconds)
        for tool in self._steering.tools:
            topics = self._driven.get(tool.name)
            if topics is not None and tool.pose is not None:
                topics.pose(tool.pose)
        self._tell_uses()

    def _take_over(self) -> None:
        """Begin to drive the tool that is steered, from where it is."""
        tool = self._steering.tool
        if tool.name not in self._driven and self._find(tool):
            frame_id = self._measured[tool.name][1]
            self._driven[tool.name] = ToolTopics(self, tool.name, frame_id)
            self._own(tool.name)

    def _own(self, name: str) -> None:
        """Become a tool's owner, so that others see who drives it; nothing else of it changes."""
        me, tool = self.get_fully_qualified_name(), self._there.get(name)
        if tool is None or tool.owner == me or name in self._owned:
            return
        if self._set_tool.service_is_ready():
            self._owned.add(name)
            tool.owner = me
            request_id = f"{self.get_name()}-{time.time_ns():x}-{name}"
            answer = self._set_tool.call_async(SetTool.Request(tool=tool, request_id=request_id))
            answer.add_done_callback(self._on_owned)

    def _on_owned(self, answer: Future) -> None:
        if not answer.result().success:
            self.get_logger().warning(f"tissue/set_tool was refused: {answer.result().message}")

    def _find(self, tool: SteeredTool) -> bool:
        """Place a tool where the simulation says it is; whether it says so."""
        if tool.name not in self._measured:
            return False
        self._steering.place(tool, self._measured[tool.name][0])
        return True

    def _tell_uses(self) -> None:
        """Publish the levels of use that changed, and all to those who have just begun to listen.

        The first level a simulation hears makes no edge: it must hear of the release before it
        hears of the press.
        """
        for tool in self._steering.tools:
            topics = self._driven.get(tool.name)
            if topics is None:
                continue
            now = (tool.used, topics.listeners)
            if now != self._told.get(tool.name):
                topics.use(tool.used)
                self._told[tool.name] = now

    def _look(self) -> None:
        missing = [tool.name for tool in self._steering.tools if tool.name not in self._measured]
        where = ", ".join(f"tools/{name}/measured_cp" for name in missing)
        steered = Finding(
            "tools",
            WARN if missing else OK,
            f"no pose on {where}: is the simulation running, and has it the tool?"
            if missing
            else f"drives {self._steering.tool.name}",
            {tool.name: "pressed" if tool.used else "released" for tool in self._steering.tools},
        )
        self._diagnostics.publish_when_due([self._input.finding(), steered])


def main(args: list[str] | None = None) -> None:
    """Entry point."""
    sys.exit(node_main.run(JoyNode, args))


if __name__ == "__main__":
    main()
