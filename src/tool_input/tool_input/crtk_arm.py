"""What comes from a CRTK arm: the pose of its tip, its jaw and its clutch."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState, Joy
from std_msgs.msg import Bool

from tissue_sim import conversions, qos
from tissue_sim.interaction import rigid
from tool_input.arm_mapping import ArmMapping
from tool_input.arm_parameters import BOOL, jaw_of, mapping_of
from tool_input.input_watch import InputWatch
from tool_input.motion import Pose

Subscribe = Callable[[type, str, Callable[[Any], None], Any], Any]
"""Subscribes with message type, topic, callback and quality of service."""


class CrtkArm:
    """Turns an arm's messages into the pose and the use of a tool.

    Attributes:
        mapping: From the arm's poses to the tool's.
        watch: Whether the arm speaks.
        pose: The arm's newest pose, in the frame of its base; None before there is one.
        tool: The pose of the tool that goes with it.
        stamp: When the arm was there.
    """

    def __init__(
        self,
        node: Node,
        values: dict[str, Any],
        subscribe: Subscribe,
        on_pose: Callable[[Pose, Time], None],
        on_use: Callable[[bool], None],
        poses: QoSProfile = qos.POSE_IN,
    ) -> None:
        """Subscribe to the arm.

        Args:
            node: Whose log tells what is wrong.
            values: Of the parameters `arm_parameters.ARM`.
            subscribe: Makes a subscription.
            on_pose: Called with each pose of the tool and its stamp.
            on_use: Called when the jaw begins or ends to use the tool.
            poses: Quality of service of the arm's poses.

        Raises:
            ValueError: A parameter is not allowed.
        """
        self.mapping: ArmMapping = mapping_of(values)
        self.pose: Pose | None = None
        self.tool: Pose | None = None
        self.stamp = Time()
        self._jaw = jaw_of(values)
        self._log = node.get_logger()
        self._tell_pose, self._tell_use = on_pose, on_use
        arm = values["arm"]
        self.watch = InputWatch(f"{arm}/measured_cp", values["input_timeout"])
        subscribe(PoseStamped, f"{arm}/measured_cp", self._on_pose, poses)
        subscribe(JointState, f"{arm}/jaw/measured_js", self._on_jaw, qos.POSE_IN)
        if values["clutch_topic"]:
            kind = Bool if values["clutch_type"] == BOOL else Joy
            subscribe(kind, values["clutch_topic"], self._on_clutch, qos.USE)
        self._log.info(f"{arm}/measured_cp and {arm}/jaw/measured_js drive tools/{values['tool']}")

    def look(self) -> None:
        """Notice that the arm has fallen silent; call it some times a second."""
        if self.watch.lost(time.monotonic()):
            self._log.warning(self.watch.silence)

    def _on_pose(self, message: PoseStamped) -> None:
        try:
            arm = rigid.checked_pose(conversions.pose_array(message.pose))
        except rigid.PoseError as error:
            self._refuse(str(error))
            return
        if self.watch.accept(time.monotonic()):
            self._log.info(f"input on {self.watch.topic}")
        self.pose, self.stamp = Pose(arm[:3], arm[3:]), message.header.stamp
        self.tool = self.mapping.tool_pose(self.pose)
        self._tell_pose(self.tool, self.stamp)

    def _on_jaw(self, message: JointState) -> None:
        if not message.position or not math.isfinite(message.position[0]):
            self._refuse("the jaw's JointState holds no finite position")
        elif self._jaw.changed(float(message.position[0])):
            self._tell_use(bool(self._jaw.pressed))

    def _on_clutch(self, message: Bool | Joy) -> None:
        if isinstance(message, Bool):
            self.mapping.clutch(message.data)
        elif not message.buttons:
            self._refuse("the clutch's Joy holds no button")
        else:
            self.mapping.clutch(bool(message.buttons[0]))

    def _refuse(self, reason: str) -> None:
        self.watch.refuse(reason)
        self._log.warning(f"a message was left out: {reason}", throttle_duration_sec=1.0)
