"""What a node says about itself on /diagnostics, once a second."""

from __future__ import annotations

import time
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from tissue_sim import conversions, qos
from tissue_sim.diagnostics import Finding

PERIOD = 1.0
"""[s]"""


class DiagnosticsTopic:
    """Publishes a node's findings under its name: when they change, and once a second."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        self._due = 0.0
        self._levels: list[tuple[str, int]] = []

    def publish_when_due(self, findings: Sequence[Finding]) -> None:
        """Publish if a second has passed, or at once if a level is another than before."""
        now = time.monotonic()
        levels = [(finding.name, finding.level) for finding in findings]
        if now < self._due and levels == self._levels:
            return
        self._due, self._levels = now + PERIOD, levels
        name, stamp = self._node.get_fully_qualified_name(), self._node.get_clock().now().to_msg()
        self._publisher.publish(conversions.diagnostics(name, findings, stamp))
