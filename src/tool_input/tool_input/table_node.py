"""Node `table`: a page in the browser on which several people operate on the organ."""

from __future__ import annotations

import sys

from rclpy.node import Node

from tissue_sim.node_main import declare, run
from tissue_sim.parameters import Spec
from tool_input.table import organ_view, sight
from tool_input.table.desk import Desk
from tool_input.table.page import TablePage

PARAMETERS = (
    Spec("frame_id", "string", "organ", "Frame of the organ; poses and cuts are given in it."),
    Spec("host", "string", "127.0.0.1", "Address the page listens on; 0.0.0.0: all there are."),
    Spec("port", "integer", 8080, "Port of the page; the next free one if taken.", "", 0, 65535),
    Spec("view_hz", "double", 30.0, "How often the page is redrawn.", "1/s", 1.0, 60.0),
    Spec("pose_hz", "double", 60.0, "How often the tools' poses are repeated.", "1/s", 10.0, 250.0),
)


class TableNode(Node):
    """Shows the organ to everybody, and publishes and calls what they do.

    Whatever happens in a window is done here, in the executor's thread, in the order it came.
    """

    def __init__(self) -> None:
        super().__init__("table")
        given = declare(self, PARAMETERS)
        sight.warm_up()
        organ_view.warm_up()
        self._desk = Desk(self, given["frame_id"])
        self.page = TablePage(self._desk, given["host"], given["port"])
        self.create_timer(1.0 / given["view_hz"], self._draw)
        self.create_timer(1.0 / given["pose_hz"], self.page.repeat_poses)
        take_part, watch = self.page.addresses
        self.get_logger().info(f"open {take_part}")
        self.get_logger().info(f"to watch only: {watch}")

    def close(self) -> None:
        """Let go of everything and close the page."""
        self.page.close()

    def _draw(self) -> None:
        self._desk.hear()
        self.page.draw()


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run(TableNode, args)


if __name__ == "__main__":
    sys.exit(main())
