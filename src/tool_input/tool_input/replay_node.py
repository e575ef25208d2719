"""Node `replay`: plays the tools' topics (or any PoseStamped) of a bag with the recorded timing."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from std_msgs.msg import Bool

from tissue_sim import node_main, qos
from tissue_sim.parameters import ParameterError, Spec
from tool_input.bag_tracks import POSE, BagError, BagTracks, Recorded

SPECS = (
    Spec("bag", "string", "", "bag directory or MCAP file"),
    Spec(
        "remap",
        "strings",
        [],
        "topics as in_bag:=published; none: tools/*/servo_cp and tools/*/use",
    ),
    Spec("rate", "double", 1.0, "seconds of the bag per second", "", 0.01, 100.0),
    Spec("loop", "bool", False, "begin again at the end"),
    Spec("frame_id", "string", "", "frame to give the poses; empty: as recorded"),
    Spec("restamp", "bool", True, "stamp poses when they are published, not as recorded"),
    Spec("match_timeout", "double", 60.0, "longest wait for somebody to listen", "s", 0.0, 3600.0),
)
POLL_SECONDS = 0.02


class ReplayNode(Node):
    """Plays one bag in a thread of its own, then ends.

    Attributes:
        exit_code: 0 when everything was played.
    """

    def __init__(self) -> None:
        super().__init__("replay")
        self._values = node_main.declare(self, SPECS)
        if not self._values["bag"]:
            raise ParameterError("no bag: give it with -p bag:=DIRECTORY")
        self._tracks = BagTracks(Path(self._values["bag"]), self._values["remap"])
        self.exit_code = 1
        self._outputs: dict[str, Publisher] = {}
        for topic, kind in self._tracks.topics.items():
            target = self._tracks.targets[topic]
            message, profile = (PoseStamped, qos.POSE) if kind == POSE else (Bool, qos.USE)
            self._outputs[topic] = self.create_publisher(message, target, profile)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._play, name="replay", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ended.set()
        self._thread.join(timeout=5.0)

    def _play(self) -> None:
        try:
            if self._matched():
                played = self._once()
                while self._values["loop"] and played and not self._ended.is_set():
                    self.get_logger().info("begins again")
                    played = self._once()
                for publisher in self._outputs.values():
                    publisher.wait_for_all_acked(Duration(seconds=1.0))
                self.exit_code = 1 if self._ended.is_set() else 0
        except BagError as error:
            self.get_logger().error(str(error))
        rclpy.try_shutdown()

    def _matched(self) -> bool:
        deadline = time.monotonic() + self._values["match_timeout"]
        while not all(output.get_subscription_count() for output in self._outputs.values()):
            if self._ended.wait(POLL_SECONDS):
                return False
            if time.monotonic() > deadline:
                silent = [o.topic for o in self._outputs.values() if not o.get_subscription_count()]
                self.get_logger().error(f"nobody listens to {', '.join(silent)}")
                return False
        return True

    def _once(self) -> int:
        """Play the bag once; how many messages were played."""
        count = 0
        origin = time.monotonic()
        for recorded in self._tracks.messages():
            due = origin + recorded.time / self._values["rate"]
            if self._ended.wait(max(0.0, due - time.monotonic())):
                return count
            self._publish(recorded)
            count += 1
        self.get_logger().info(f"{count} messages in {time.monotonic() - origin:.2f} s")
        return count

    def _publish(self, recorded: Recorded) -> None:
        output = self._outputs[recorded.topic]
        if self._tracks.topics[recorded.topic] != POSE:
            output.publish(recorded.data)
            return
        message = deserialize_message(recorded.data, PoseStamped)
        if self._values["restamp"]:
            message.header.stamp = self.get_clock().now().to_msg()
        if self._values["frame_id"]:
            message.header.frame_id = self._values["frame_id"]
        output.publish(message)


def main(args: list[str] | None = None) -> None:
    """Entry point."""
    sys.exit(node_main.run(ReplayNode, args))


if __name__ == "__main__":
    main()
