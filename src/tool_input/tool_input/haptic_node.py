"""Node `haptic`: an arm that displays forces feels the tool that it drives."""

from __future__ import annotations

import sys
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Bool
from tissue_interfaces.msg import ContactModel, ToolList

from tissue_sim import conversions, node_main, qos
from tissue_sim.contact_messages import contact_from_msg
from tissue_sim.interaction.tools import PROBE
from tissue_sim.polled_subscriptions import PolledSubscriptions
from tissue_sim.realtime import FixedRate, start_loop
from tool_input.arm_parameters import named
from tool_input.crtk_arm import CrtkArm
from tool_input.diagnostics_topic import DiagnosticsTopic
from tool_input.haptics.contact_loop import ContactLoop
from tool_input.haptics.haptic_parameters import SPECS, arm_force_of, limits_of
from tool_input.haptics.loop_account import LoopAccount
from tool_input.motion import Pose
from tool_input.tool_topics import ToolTopics

LOOK_SECONDS = 0.1


class HapticNode(Node):
    """Messages and forces in a loop thread of its own; diagnostics in the executor's.

    Attributes:
        exit_code: What the process ends with.
    """

    def __init__(self) -> None:
        super().__init__("haptic")
        self.exit_code = 0
        values = named(node_main.declare(self, SPECS))
        self._values = values
        self._force = arm_force_of(values)
        self._rate = FixedRate(values["rate_hz"])
        self._loop = ContactLoop(limits_of(values, self._force), self._rate.period)
        self._account = LoopAccount(self._rate)
        self._enabled = not values["enable_topic"]
        self._heard = PolledSubscriptions(self)
        self._topics = None
        if values["pose_hz"] > 0.0:
            self._topics = ToolTopics(self, values["tool"], values["frame_id"])
        self._told_at = self._heard_at = -np.inf
        self._tool: NDArray[np.float64] | None = None
        self._hand: NDArray[np.float64] | None = None
        self._arm = CrtkArm(
            self, values, self._listen, self._on_pose, self._on_use, qos.NEWEST_POSE_IN
        )
        tool = values["tool"]
        self._listen(ContactModel, f"tools/{tool}/contact_model", self._on_model, qos.MEASURED)
        self._listen(ToolList, "tissue/tools", self._on_tools, qos.LATCHED)
        if values["enable_topic"]:
            self._listen(Bool, values["enable_topic"], self._on_enable, qos.USE)
        self._out = self.create_publisher(WrenchStamped, f"{values['arm']}/servo_cf", qos.MEASURED)
        self._diagnostics = DiagnosticsTopic(self)
        self.create_timer(LOOK_SECONDS, self._look)
        self._stop = threading.Event()
        self._thread = start_loop(self._run, values["realtime_priority"], self.get_logger().info)

    def close(self) -> None:
        """End the loop; the last force is none."""
        self._stop.set()
        if hasattr(self, "_thread"):
            self._thread.join(timeout=10.0)

    def _listen(
        self, message: type, topic: str, callback: Callable[[Any], None], profile: Any
    ) -> None:
        self._heard.add(message, topic, lambda found, _info: callback(found), profile)

    # The loop thread

    def _run(self) -> None:
        try:
            self._rate.start()
            while self._rate.wait(self._stop):
                begun = time.perf_counter()
                self._tick(begun)
                self._rate.published()
                self._account.tick_ms.add(1e3 * (time.perf_counter() - begun))
        except Exception as error:
            if self.context.ok():  # Ctrl-C takes the publishers away in the middle of a tick.
                self.exit_code = 1
                self.get_logger().fatal(f"the loop failed: {type(error).__name__}: {error}")
                traceback.print_exc()
        finally:
            if self.context.ok():
                self._publish(np.zeros(6), self._arm.stamp)
            if self.exit_code:
                self.context.try_shutdown()

    def _tick(self, now: float) -> None:
        self._heard.take()
        if self._tool is None or self._hand is None:
            return
        wrench = self._loop.step(now, self._tool, self._hand, self._withheld(now))
        self._publish(self._force.at_arm(wrench), self._arm.stamp)

    def _withheld(self, now: float) -> str:
        """Why there must be no force; empty: there may be."""
        silence = self._values["force_timeout"]
        if now - self._heard_at > silence:
            return f"no pose of {self._values['arm']} for more than {silence:g} s"
        if not self._enabled:
            return f"{self._values['enable_topic']} does not say true"
        return "the clutch is pressed" if self._arm.mapping.clutched else ""

    def _publish(self, wrench: NDArray[np.float64], stamp: Time) -> None:
        """Publish a wrench at the arm, with the stamp of the pose that it answers."""
        self._out.publish(conversions.wrench_stamped(wrench, self._values["arm"], stamp))

    def _on_pose(self, pose: Pose, stamp: Time) -> None:
        self._heard_at = time.perf_counter()
        self._tool = _values(pose)
        if self._arm.pose is not None:
            self._hand = _values(self._arm.mapping.hand_pose(self._arm.pose))
        # A share of the period earlier, so that poses in step with it are not told half as often.
        if self._topics and self._heard_at - self._told_at > 0.9 / self._values["pose_hz"]:
            self._told_at = self._heard_at
            self._topics.pose(pose, stamp)

    def _on_use(self, pressed: bool) -> None:
        if self._topics:
            self._topics.use(pressed)

    def _on_enable(self, message: Bool) -> None:
        self._enabled = bool(message.data)

    def _on_tools(self, message: ToolList) -> None:
        kinds = {tool.id: tool.kind for tool in message.tools}
        self._loop.pushes_only = kinds.get(self._values["tool"]) == PROBE

    def _on_model(self, message: ContactModel) -> None:
        frame = self._values["frame_id"]
        try:
            if message.header.frame_id != frame:
                raise ValueError(f"it is in {message.header.frame_id!r}, frame_id is {frame!r}")
            model = contact_from_msg(message)
        except ValueError as error:
            self._account.refusal = str(error)
            return
        self._account.models += 1
        # From the clock that stamps to the one that ticks; a stamp of the future is one of now.
        age = 1e-9 * (time.time_ns() - conversions.nanoseconds_of(message.header.stamp))
        self._loop.receive(model, time.perf_counter() - max(age, 0.0))

    # The executor's thread

    def _look(self) -> None:
        if self._topics:
            self._topics.tell_newcomers()
        self._arm.look()
        findings = self._account.findings(time.perf_counter(), self._loop)
        self._diagnostics.publish_when_due([self._arm.watch.finding(), *findings])


def _values(pose: Pose) -> NDArray[np.float64]:
    return np.concatenate([pose.position, pose.quaternion])


def main(args: list[str] | None = None) -> None:
    """Entry point."""
    sys.exit(node_main.run(HapticNode, args))


if __name__ == "__main__":
    main()
