"""How every node of this package starts and ends."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

DISCOVERY_VARIABLES = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "ROS_DISCOVERY_SERVER",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
)


def stay_local() -> None:
    """Keep discovery on this machine, unless the user chose otherwise."""
    if not any(os.environ.get(name) for name in DISCOVERY_VARIABLES):
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        print(
            "Only processes on this machine can take part; "
            "set ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET to open it to the network.",
            file=sys.stderr,
        )


def run_node(make: Callable[[], Node], args: list[str] | None = None) -> int:
    """Make a node and spin it until it is done or the process is asked to end.

    A node that has a `future` attribute is done when that future is; the future's result is the
    exit code.

    Args:
        make: Makes the node; a ValueError from it is what the user did wrong.
        args: Arguments of the command line.

    Returns:
        The exit code: 2 where the node could not be made.
    """
    stay_local()
    rclpy.init(args=args)
    try:
        node = make()
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    future = getattr(node, "future", None)
    code = 0
    try:
        if future is None:
            executor.spin()
        else:
            executor.spin_until_future_complete(future)
            code = int(future.result()) if future.done() else 1
    except (KeyboardInterrupt, ExternalShutdownException):
        code = 0 if future is None else 1
    finally:
        node.destroy_node()
        executor.shutdown(timeout_sec=1.0)
        rclpy.try_shutdown()
    return code
