"""Node `virtual_arm`: moves as a hand at a haptic arm would, and measures the forces it gets."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from tissue_sim import conversions, node_main, qos
from tissue_sim.parameters import Spec
from tissue_sim.polled_subscriptions import PolledSubscriptions
from tissue_sim.realtime import FixedRate, Window, start_loop
from tissue_sim.whole_files import write_json

OPEN, CLOSED = 0.5, 0.0
"""Openings of the jaw [rad]."""

SPECS = (
    Spec("arm", "string", "arm", "namespace of the arm's topics"),
    Spec("rate_hz", "double", 500.0, "poses per second", "Hz", 10.0, 2000.0),
    Spec("position", "doubles", [0.0, 0.0, 0.0], "where it begins", "m", length=3),
    Spec("stroke", "doubles", [0.0, 0.0, -0.01], "to where it goes and back", "m", length=3),
    Spec("cycle", "double", 1.0, "time there and back", "s", 0.1, 100.0),
    Spec("closes_after", "double", 1.0, "when its jaw closes", "s", 0.0, 1e4),
    Spec("report", "string", "", "JSON file of what was measured, written at the end"),
)
SAMPLES = 1 << 17
LOOK_SECONDS = 0.1


class VirtualArmNode(Node):
    """Publishes measured_cp and the jaw, and takes servo_cf."""

    def __init__(self) -> None:
        super().__init__("virtual_arm")
        self._values = node_main.declare(self, SPECS)
        arm = self._values["arm"]
        self._poses = self.create_publisher(PoseStamped, f"{arm}/measured_cp", qos.POSE)
        self._jaw = self.create_publisher(JointState, f"{arm}/jaw/measured_js", qos.POSE)
        self._heard = PolledSubscriptions(self)
        self._heard.add(WrenchStamped, f"{arm}/servo_cf", self._on_force, qos.POSE_IN)
        self._rate = FixedRate(self._values["rate_hz"])
        self._latency, self._interval = Window(SAMPLES), Window(SAMPLES)
        self._forces = self._sent = 0
        self._largest = 0.0
        self._answered = self._first = self._received = 0
        self._told = False
        # Also what lets the executor notice that it shall end.
        self.create_timer(LOOK_SECONDS, self._look)
        self._stop = threading.Event()
        self._thread = start_loop(self._run, 0, self.get_logger().info)

    def close(self) -> None:
        """Fall silent, and say what was measured."""
        self._stop.set()
        self._thread.join(timeout=10.0)
        if self._values["report"]:
            write_json(Path(self._values["report"]), self.measured())

    def measured(self) -> dict[str, Any]:
        """Rate, jitter, latency and size of the forces."""
        seconds = 1e-9 * (self._received - self._first)
        return {
            "poses": self._sent,
            "forces": self._forces,
            "seconds": seconds,
            "forces_per_second": max(self._forces - 1, 0) / max(seconds, 1e-9),
            "pose_to_force_ms": _percentiles(self._latency),
            "between_forces_ms": _percentiles(self._interval),
            "largest_force": self._largest,
        }

    def _look(self) -> None:
        if self._forces and not self._told:
            self._told = True
            self.get_logger().info(f"forces on {self._values['arm']}/servo_cf")

    def _run(self) -> None:
        begun = time.perf_counter()
        position = np.array(self._values["position"])
        stroke = np.array(self._values["stroke"])
        self._rate.start()
        while self._rate.wait(self._stop):
            now = time.perf_counter() - begun
            there = 0.5 - 0.5 * np.cos(2.0 * np.pi * now / self._values["cycle"])
            pose = [*(position + there * stroke), 0.0, 0.0, 0.0, 1.0]
            stamp = conversions.stamp_of(time.time_ns())
            self._poses.publish(conversions.pose_stamped(pose, self._values["arm"], stamp))
            if self._sent % 50 == 0:
                opening = CLOSED if now > self._values["closes_after"] else OPEN
                self._jaw.publish(JointState(position=[opening]))
            self._sent += 1
            self._heard.take()

    def _on_force(self, message: WrenchStamped, info: dict[str, int]) -> None:
        self._forces += 1
        force = message.wrench.force
        self._largest = max(self._largest, float(np.linalg.norm([force.x, force.y, force.z])))
        received = info["received_timestamp"]
        if self._received:
            self._interval.add(1e-6 * (received - self._received))
        self._first = self._first or received
        self._received = received
        answered = conversions.nanoseconds_of(message.header.stamp)
        if answered != self._answered:
            self._latency.add(1e-6 * (received - answered))
        self._answered = answered


def _percentiles(window: Window) -> dict[str, float]:
    names = ("p50", "p95", "p99", "p99.9", "max")
    values = window.quantiles(0.5, 0.95, 0.99, 0.999, 1.0)
    return dict(zip(names, values, strict=True))


def main(args: list[str] | None = None) -> None:
    """Entry point."""
    sys.exit(node_main.run(VirtualArmNode, args))


if __name__ == "__main__":
    main()
