"""Node `difference`: a second model beside a running session, and how far the two are apart."""

from __future__ import annotations

import math
import sys
import threading
import traceback
from collections import deque
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from tissue_interfaces.msg import (
    HeldNodes,
    Journal,
    Material,
    TissueState,
    ToolList,
    Topology,
    TopologyEdit,
)

from tissue_sim import conversions, qos
from tissue_sim.compare.subject import parse_subject
from tissue_sim.node_main import declare, run
from tissue_sim.parameters import Spec
from tissue_sim.polled_subscriptions import PolledSubscriptions
from viz_bridge.difference_follower import Compared, DifferenceFollower
from viz_bridge.recorded_topics import DIFFERENCE

SPECS = (
    Spec("model", "string", "finite_element", "the second model: NAME[:PARAMETER=VALUE,...][@EFFORT"
         "]; without an effort it makes as many steps as the session"),
    Spec("keep_up", "bool", False, "whether frames in which tools only move are passed over while "
         "newer ones wait"),
)  # fmt: skip

TOPICS = (
    ("tissue/topology", Topology, qos.LATCHED),
    ("tissue/edits", TopologyEdit, qos.EDITS),
    ("tissue/state", TissueState, DIFFERENCE.profile),
    ("tissue/journal", Journal, qos.JOURNAL),
    ("tissue/tools", ToolList, qos.LATCHED),
    ("tissue/material", Material, qos.LATCHED),
    ("tissue/held_nodes", HeldNodes, qos.LATCHED),
)
TAKING_PERIOD = 0.005
BEHIND = 1.0
"""From here on it is worth a warning that the second model lags [s]."""


class DifferenceNode(Node):
    """Messages in the executor's thread, the second model in a thread of its own.

    Attributes:
        exit_code: What the process ends with.
    """

    def __init__(self) -> None:
        super().__init__("difference")
        values = declare(self, SPECS)
        self.exit_code = 0
        self._follower = DifferenceFollower(parse_subject(values["model"]), values["keep_up"])
        self._newest: Compared | None = None
        self._inbox: deque[tuple[str, Any]] = deque()
        self._wake = threading.Event()
        self._closing = False
        self._difference = self.create_publisher(TissueState, DIFFERENCE.name, qos.STATE)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        self._heard = PolledSubscriptions(self)
        for name, message, profile in TOPICS:
            self._heard.add(message, name, self._receiver(name), profile)
        self.create_timer(TAKING_PERIOD, self._heard.take)
        self.create_timer(1.0, self._report)
        self._thread = threading.Thread(target=self._work, name="second model", daemon=True)
        self._thread.start()
        self.get_logger().info(f"{self._follower.subject.name} beside the session")

    def close(self) -> None:
        """Let the frame be that is played, and end."""
        self._closing = True
        self._wake.set()
        self._thread.join(timeout=10.0)

    def _receiver(self, topic: str) -> Any:
        def receive(message: Any, _: dict[str, int]) -> None:
            self._inbox.append((topic, message))
            self._wake.set()

        return receive

    def _work(self) -> None:
        try:
            while not self._closing:
                self._wake.wait()
                self._wake.clear()
                played = True
                while played and not self._closing:
                    while self._inbox:
                        self._follower.take(*self._inbox.popleft())
                    played, compared = self._follower.advance()
                    if compared is not None:
                        self._publish(compared)
        except Exception as error:
            if not self.context.ok():
                return  # Ctrl-C took the publishers away in the middle of a frame.
            self.exit_code = 1
            self.get_logger().fatal(f"the second model failed: {type(error).__name__}: {error}")
            traceback.print_exc()
            self.context.try_shutdown()

    def _publish(self, compared: Compared) -> None:
        entry = compared.entry
        message = TissueState(
            header=conversions.header("organ", conversions.stamp_of(compared.stamp)),
            sim_time=float(entry.sim_time), version=entry.version, frame=entry.frame,
            scalar_name=f"difference from {self._follower.subject.name}", scalar_unit="m",
        )  # fmt: skip
        message.epoch = conversions.epoch_field(entry.epoch)
        conversions.fill_state(message, compared.positions)
        conversions.fill(message.scalar, compared.distance)
        self._newest = compared
        self._difference.publish(message)

    def _report(self) -> None:
        follower, newest = self._follower, self._newest
        status = DiagnosticStatus(
            level=DiagnosticStatus.OK,
            name=f"{self.get_fully_qualified_name()}: second model",
            message=f"{follower.subject.name} follows",
            hardware_id="software",
        )
        if newest is None:
            status.message = "no session yet"
        if follower.lag > BEHIND:
            status.level = DiagnosticStatus.WARN
            status.message = f"{follower.subject.name} is {follower.lag:.1f} s behind the session"
        deaf = self._heard.incompatible()
        if follower.problem or deaf:
            status.level = DiagnosticStatus.WARN
            status.message = "; ".join(filter(None, (follower.problem, *deaf.values())))
        status.values = [KeyValue(key=key, value=text) for key, text in self._figures(newest)]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _figures(self, newest: Compared | None) -> list[tuple[str, str]]:
        follower = self._follower
        lengths = (math.nan,) * 3 if newest is None else (newest.mean, newest.p95, newest.largest)
        names = ("mean [mm]", "p95 [mm]", "largest [mm]")
        return [
            *((key, f"{1e3 * value:.6g}") for key, value in zip(names, lengths, strict=True)),
            ("of the worst", f"{math.nan if newest is None else newest.relative:.4g}"),
            ("lag [s]", f"{follower.lag:.3f}"),
            ("frames waiting", str(follower.waiting)),
            ("frames compared", str(follower.compared)),
            ("frames without a shape", str(follower.unseen)),
            ("began at frame", str(follower.joined)),
        ]


def main(args: list[str] | None = None) -> None:
    """Follow until interrupted."""
    sys.exit(run(DifferenceNode, args))


if __name__ == "__main__":
    main()
