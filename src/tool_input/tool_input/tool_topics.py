"""What every source of tool motion publishes: `tools/<tool>/servo_cp` and `tools/<tool>/use`."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from std_msgs.msg import Bool

from tissue_sim import qos
from tool_input.motion import Pose


def pose_message(pose: Pose) -> PoseMessage:
    """A pose as ROS writes it."""
    message = PoseMessage()
    position, orientation = message.position, message.orientation
    position.x, position.y, position.z = (float(value) for value in pose.position)
    orientation.x, orientation.y, orientation.z, orientation.w = (
        float(value) for value in pose.quaternion
    )
    return message


class ToolTopics:
    """Publishers of one tool.

    Attributes:
        tool: Name of the tool.
    """

    def __init__(self, node: Node, tool: str, frame_id: str) -> None:
        """Create the publishers.

        Args:
            node: The node they belong to.
            tool: Name of the tool.
            frame_id: Frame the poses are given in.
        """
        self.tool = tool
        self._node = node
        self._clock = node.get_clock()
        self._frame_id = frame_id
        self._poses = node.create_publisher(PoseStamped, f"tools/{tool}/servo_cp", qos.POSE)
        self._pressed: bool | None = None
        self._told = 0
        self._uses = node.create_publisher(Bool, f"tools/{tool}/use", qos.USE)

    @property
    def listeners(self) -> int:
        """How many listen to both the poses and the uses."""
        return min(self._poses.get_subscription_count(), self._uses.get_subscription_count())

    def pose(self, pose: Pose, stamp: Time | None = None) -> None:
        """Publish where the tool shall be, stamped now if no stamp is given."""
        message = PoseStamped()
        message.header.stamp = stamp or self._clock.now().to_msg()
        message.header.frame_id = self._frame_id
        message.pose = pose_message(pose)
        self._poses.publish(message)

    def use(self, pressed: bool) -> None:
        """Publish whether the tool is pressed."""
        self._pressed = bool(pressed)
        self._uses.publish(Bool(data=self._pressed))

    def tell_newcomers(self) -> None:
        """Publish the level of use again to those who have begun to listen since the last time."""
        before, self._told = self._told, self._uses.get_subscription_count()
        if self._told > before and self._pressed is not None:
            self.use(self._pressed)

    def close(self) -> None:
        """Publish no more: the tool has room for another source."""
        self._node.destroy_publisher(self._poses)
        self._node.destroy_publisher(self._uses)
