"""A program that listens to an organ and prints the frames it gets; tests stop it in its tracks."""

from __future__ import annotations

import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from tissue_interfaces.msg import Journal, TissueState

from tissue_sim import qos


def main() -> None:
    rclpy.init(args=sys.argv)
    node = rclpy.create_node("listener")
    node.create_subscription(
        TissueState, "tissue/state", lambda state: print(state.frame, flush=True), qos.STATE
    )
    node.create_subscription(Journal, "tissue/journal", lambda _entry: None, qos.JOURNAL)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
