"""Node `crtk`: a CRTK arm (dVRK and others) drives a tool; its jaw is the tool's use."""

from __future__ import annotations

import math
import sys

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from tissue_sim import node_main, qos
from tissue_sim.parameters import ParameterError, Spec
from tool_input.arm_mapping import ArmBase, ArmMapping, JawSwitch
from tool_input.motion import Pose
from tool_input.tool_topics import ToolTopics

SPECS = (
    Spec("arm", "string", "", "namespace of the arm's topics, such as PSM1"),
    Spec("tool", "string", "", "the tool it drives"),
    Spec("frame_id", "string", "organ", "frame the base below is given in"),
    Spec("base_position", "doubles", [0.0, 0.0, 0.0], "the arm's base", "m", length=3),
    Spec(
        "base_orientation",
        "doubles",
        [0.0, 0.0, 0.0, 1.0],
        "orientation of the arm's base, quaternion x y z w",
        length=4,
    ),
    Spec("scale", "double", 1.0, "metres of the tool per metre of the arm", "", 0.01, 100.0),
    Spec(
        "close_below", "double", 0.1, "jaw opening below which the tool is used", "rad", -3.2, 3.2
    ),
    Spec("open_above", "double", 0.25, "jaw opening above which it is not", "rad", -3.2, 3.2),
    Spec("clutch_topic", "string", "", "Bool topic: true takes the arm off the tool; empty: none"),
)
LOOK_SECONDS = 0.1


class CrtkNode(Node):
    """Passes an arm's measured pose and jaw on to a tool."""

    def __init__(self) -> None:
        super().__init__("crtk")
        values = node_main.declare(self, SPECS)
        for name in ("arm", "tool"):
            if not values[name]:
                raise ParameterError(f"no {name}: give it with -p {name}:=NAME")
        orientation = np.array(values["base_orientation"])
        if abs(np.linalg.norm(orientation) - 1.0) > 0.01:
            raise ParameterError("base_orientation must be a quaternion of length 1")
        base = ArmBase(
            np.array(values["base_position"]), Rotation.from_quat(orientation), values["scale"]
        )
        self._mapping = ArmMapping(base)
        self._jaw = JawSwitch(values["close_below"], values["open_above"])
        self._topics = ToolTopics(self, values["tool"], values["frame_id"])
        arm = values["arm"]
        self.create_subscription(PoseStamped, f"{arm}/measured_cp", self._on_pose, qos.POSE_IN)
        self.create_subscription(JointState, f"{arm}/jaw/measured_js", self._on_jaw, qos.POSE_IN)
        if values["clutch_topic"]:
            self.create_subscription(Bool, values["clutch_topic"], self._on_clutch, qos.USE)
        self.get_logger().info(
            f"{arm}/measured_cp and {arm}/jaw/measured_js drive tools/{values['tool']}"
        )
        self._waiting = self.create_timer(LOOK_SECONDS, self._look_for_listeners)

    def _look_for_listeners(self) -> None:
        if self._topics.listeners:
            self.get_logger().info(f"somebody listens to tools/{self._topics.tool}")
            self._waiting.cancel()

    def _on_pose(self, message: PoseStamped) -> None:
        place, turn = message.pose.position, message.pose.orientation
        position = np.array([place.x, place.y, place.z])
        quaternion = np.array([turn.x, turn.y, turn.z, turn.w])
        length = float(np.linalg.norm(quaternion))
        if not (np.isfinite(position).all() and math.isfinite(length) and length > 0.5):
            self.get_logger().warning(
                "a pose that is not finite or has no orientation was left out",
                throttle_duration_sec=1.0,
            )
            return
        pose = self._mapping.tool_pose(Pose(position, quaternion / length))
        self._topics.pose(pose, message.header.stamp)

    def _on_jaw(self, message: JointState) -> None:
        if not message.position:
            self.get_logger().warning(
                "the jaw's JointState holds no position", throttle_duration_sec=1.0
            )
        elif self._jaw.changed(float(message.position[0])):
            self._topics.use(bool(self._jaw.pressed))

    def _on_clutch(self, message: Bool) -> None:
        self._mapping.clutch(message.data)


def main(args: list[str] | None = None) -> None:
    """Entry point."""
    sys.exit(node_main.run(CrtkNode, args))


if __name__ == "__main__":
    main()
