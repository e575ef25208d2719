"""Node `crtk`: a CRTK arm (dVRK and others) drives a tool; its jaw is the tool's use."""

from __future__ import annotations

import math
import sys
import time

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState, Joy
from std_msgs.msg import Bool

from tissue_sim import conversions, node_main, qos
from tissue_sim.interaction import rigid
from tissue_sim.parameters import ParameterError, Spec
from tool_input.arm_mapping import ArmBase, ArmMapping, JawSwitch
from tool_input.device_parameters import INPUT_TIMEOUT, WORKSPACE, unit_quaternion
from tool_input.diagnostics_topic import DiagnosticsTopic
from tool_input.input_watch import InputWatch
from tool_input.motion import Pose
from tool_input.tool_topics import ToolTopics
from tool_input.workspace import Workspace

BOOL, JOY = "bool", "joy"
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
    Spec(
        "arm_origin",
        "doubles",
        [0.0, 0.0, 0.0],
        "place of the arm that is mapped to base_position, in the frame of its base",
        "m",
        -100.0,
        100.0,
        length=3,
    ),
    Spec("scale", "double", 1.0, "metres of the tool per metre of the arm", "", 0.01, 100.0),
    *WORKSPACE,
    Spec(
        "close_below", "double", 0.1, "jaw opening below which the tool is used", "rad", -3.2, 3.2
    ),
    Spec("open_above", "double", 0.25, "jaw opening above which it is not", "rad", -3.2, 3.2),
    Spec("clutch_topic", "string", "", "what takes the arm off the tool; empty: nothing"),
    Spec(
        "clutch_type",
        "string",
        BOOL,
        "type of clutch_topic: std_msgs/Bool, or sensor_msgs/Joy whose first button is the clutch",
        choices=(BOOL, JOY),
    ),
    INPUT_TIMEOUT,
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
        base = ArmBase(
            np.array(values["base_position"]),
            unit_quaternion("base_orientation", values["base_orientation"]),
            values["scale"],
            np.array(values["arm_origin"]),
        )
        workspace = Workspace.between(values["workspace_min"], values["workspace_max"])
        self._mapping = ArmMapping(base, workspace)
        self._jaw = JawSwitch(values["close_below"], values["open_above"])
        self._topics = ToolTopics(self, values["tool"], values["frame_id"])
        arm = values["arm"]
        self._input = InputWatch(f"{arm}/measured_cp", values["input_timeout"])
        self.create_subscription(PoseStamped, f"{arm}/measured_cp", self._on_pose, qos.POSE_IN)
        self.create_subscription(JointState, f"{arm}/jaw/measured_js", self._on_jaw, qos.POSE_IN)
        if values["clutch_topic"]:
            kind = Bool if values["clutch_type"] == BOOL else Joy
            self.create_subscription(kind, values["clutch_topic"], self._on_clutch, qos.USE)
        self.get_logger().info(
            f"{arm}/measured_cp and {arm}/jaw/measured_js drive tools/{values['tool']}"
        )
        self._diagnostics = DiagnosticsTopic(self)
        self._heard = False
        self.create_timer(LOOK_SECONDS, self._look)

    def _look(self) -> None:
        if not self._heard and self._topics.listeners:
            self._heard = True
            self.get_logger().info(f"somebody listens to tools/{self._topics.tool}")
        if self._input.lost(time.monotonic()):
            self.get_logger().warning(self._input.silence)
        self._diagnostics.publish_when_due([self._input.finding()])

    def _on_pose(self, message: PoseStamped) -> None:
        try:
            arm = rigid.checked_pose(conversions.pose_array(message.pose))
        except rigid.PoseError as error:
            self._refuse(str(error))
            return
        if self._input.accept(time.monotonic()):
            self.get_logger().info(f"input on {self._input.topic}")
        pose = self._mapping.tool_pose(Pose(arm[:3], arm[3:]))
        self._topics.pose(pose, message.header.stamp)

    def _on_jaw(self, message: JointState) -> None:
        if not message.position or not math.isfinite(message.position[0]):
            self._refuse("the jaw's JointState holds no finite position")
        elif self._jaw.changed(float(message.position[0])):
            self._topics.use(bool(self._jaw.pressed))

    def _on_clutch(self, message: Bool | Joy) -> None:
        if isinstance(message, Bool):
            self._mapping.clutch(message.data)
        elif not message.buttons:
            self._refuse("the clutch's Joy holds no button")
        else:
            self._mapping.clutch(bool(message.buttons[0]))

    def _refuse(self, reason: str) -> None:
        self._input.refuse(reason)
        self.get_logger().warning(f"a message was left out: {reason}", throttle_duration_sec=1.0)


def main(args: list[str] | None = None) -> None:
    """Entry point."""
    sys.exit(node_main.run(CrtkNode, args))


if __name__ == "__main__":
    main()
