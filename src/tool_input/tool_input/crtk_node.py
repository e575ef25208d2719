"""Node `crtk`: a CRTK arm (dVRK and others) drives a tool; its jaw is the tool's use."""

from __future__ import annotations

import sys

from rclpy.node import Node

from tissue_sim import node_main
from tool_input.arm_parameters import ARM, named
from tool_input.crtk_arm import CrtkArm
from tool_input.diagnostics_topic import DiagnosticsTopic
from tool_input.tool_topics import ToolTopics

LOOK_SECONDS = 0.1


class CrtkNode(Node):
    """Passes an arm's measured pose and jaw on to a tool."""

    def __init__(self) -> None:
        super().__init__("crtk")
        values = named(node_main.declare(self, ARM))
        self._topics = ToolTopics(self, values["tool"], values["frame_id"])
        self._arm = CrtkArm(
            self, values, self.create_subscription, self._topics.pose, self._topics.use
        )
        self._diagnostics = DiagnosticsTopic(self)
        self._heard = False
        self.create_timer(LOOK_SECONDS, self._look)

    def _look(self) -> None:
        if not self._heard and self._topics.listeners:
            self._heard = True
            self.get_logger().info(f"somebody listens to tools/{self._topics.tool}")
        self._topics.tell_newcomers()
        self._arm.look()
        self._diagnostics.publish_when_due([self._arm.watch.finding()])


def main(args: list[str] | None = None) -> None:
    """Entry point."""
    sys.exit(node_main.run(CrtkNode, args))


if __name__ == "__main__":
    main()
