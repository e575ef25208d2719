"""The messages that this workspace builds cross from one process to another."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from tissue_interfaces.msg import TissueState

LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
PUBLISHER = """
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from tissue_interfaces.msg import TissueState
rclpy.init()
node = rclpy.create_node("other_process")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
publisher = node.create_publisher(TissueState, "state", latched)
message = TissueState(version=7, frame=42)
message.positions.frombytes(bytes(3 * 35_000 * 4))
publisher.publish(message)
rclpy.spin(node)
"""


def test_state_of_the_thesis_heart_reaches_another_process(ros_domain: int, tmp_path: Path) -> None:
    publisher = subprocess.Popen([sys.executable, "-c", PUBLISHER], cwd=tmp_path)
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    try:
        node = rclpy.create_node("this_process", context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        received: list[TissueState] = []
        node.create_subscription(TissueState, "state", received.append, LATCHED)
        deadline = time.monotonic() + 60.0
        while not received and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.1)
        assert received, "nothing came within a minute"
        assert (received[0].version, received[0].frame) == (7, 42)
        assert len(received[0].positions) == 3 * 35_000
        node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)
        publisher.kill()
        publisher.wait()
