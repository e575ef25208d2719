"""What a service answers when something went wrong that nobody has foreseen."""

from __future__ import annotations

import traceback

from rclpy.node import Node


def internal_error(node: Node, service: str, error: Exception) -> str:
    """Log where an error came from, for whoever mends it; the message for the client."""
    node.get_logger().error(f"{service}: internal error\n{traceback.format_exc()}")
    return f"internal error: {type(error).__name__}: {error}"
