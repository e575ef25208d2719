"""Sources of tool motion: the simulation's subscriptions for each tool."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from std_msgs.msg import Bool

from tissue_sim import conversions, qos
from tissue_sim.frames import Frames, UnknownFrameError
from tissue_sim.interaction.rigid import PoseError, checked_pose
from tissue_sim.live import LiveSimulation
from tissue_sim.polled_subscriptions import PolledSubscriptions
from tissue_sim.simulation_topics import ToolTopics

HEARD = ("servo_cp", "use", "clutch")
"""What is heard of each tool."""


class ToolSources:
    """Subscriptions and publishers of every tool.

    They come and go in the executor's thread; what comes through them is taken in the loop's, at
    the beginning of a frame.

    Attributes:
        topics: Publishers by tool; replaced as a whole, so that the loop thread may read it.
        bad_qos: Topics offered with an incompatible quality of service.
    """

    def __init__(self, node: Node, live: LiveSimulation, frames: Frames) -> None:
        self.topics: dict[str, ToolTopics] = {}
        self.bad_qos: dict[str, str] = {}
        self._node, self._live, self._frames = node, live, frames
        self._heard = PolledSubscriptions(node)

    def follow(self, tools: Iterable[str]) -> None:
        """Subscribe and publish for these tools and no others."""
        wanted = list(tools)
        topics = dict(self.topics)
        for gone in [tool for tool in topics if tool not in wanted]:
            for name in HEARD:
                self._heard.remove(f"tools/{gone}/{name}")
            leaving = topics.pop(gone)
            self.topics = dict(topics)
            leaving.destroy(self._node)
        for tool in wanted:
            if tool not in topics:
                topics[tool] = ToolTopics(self._node, tool, self._frames.organ)
                self._subscribe(tool)
        self.topics = topics

    def take(self) -> None:
        """Hand over what has come since the last frame."""
        self._heard.take()

    def watch_sources(self) -> list[str]:
        """Tell the trackers who publishes poses; give the unknown tools that poses are sent to."""
        for tool in self.topics:
            infos = self._node.get_publishers_info_by_topic(f"tools/{tool}/servo_cp")
            self._live.post_sources(tool, _source_names(infos))
        self.bad_qos = self._heard.incompatible()
        prefix = self._node.resolve_topic_name("tools/_/servo_cp").removesuffix("_/servo_cp")
        unknown = []
        for topic, _ in self._node.get_topic_names_and_types():
            if topic.startswith(prefix) and topic.endswith("/servo_cp"):
                tool = topic[len(prefix) : -len("/servo_cp")]
                if tool not in self.topics and self._node.count_publishers(topic):
                    unknown.append(tool)
        return unknown

    def _subscribe(self, tool: str) -> None:
        def on_pose(message: PoseStamped, _info: object) -> None:
            self._on_pose(tool, message)

        def on_use(message: Bool, _info: object) -> None:
            self._live.post_use(tool, bool(message.data))

        def on_clutch(message: Bool, _info: object) -> None:
            self._live.post_clutch(tool, bool(message.data))

        self._heard.add(Bool, f"tools/{tool}/use", on_use, qos.USE)
        self._heard.add(Bool, f"tools/{tool}/clutch", on_clutch, qos.USE)
        # Last, so that the pose that was sent before a press is never taken after it.
        self._heard.add(PoseStamped, f"tools/{tool}/servo_cp", on_pose, qos.POSE_IN)

    def _on_pose(self, tool: str, message: PoseStamped) -> None:
        now = time.perf_counter()
        try:
            pose = checked_pose(conversions.pose_array(message.pose))
            pose = self._frames.pose_in_organ(message.header.frame_id, pose)
        except (PoseError, UnknownFrameError) as error:
            self._live.post_refusal(tool, str(error))
            self._node.get_logger().warning(
                f"pose of tool {tool} refused: {error}", throttle_duration_sec=5.0
            )
            return
        self._live.post_pose(tool, pose, conversions.nanoseconds_of(message.header.stamp), now)


def _source_names(infos: Sequence[Any]) -> list[str]:
    """Names of the nodes that publish, each once.

    A source that was killed and started again is one source, although the middleware lists the dead
    publisher for some 20 s more. Publishers without a ROS node count one by one.
    """
    names = []
    for info in infos:
        name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
        if info.node_name.startswith("_"):
            name += f" {bytes(info.endpoint_gid[:16]).hex()}"
        names.append(name)
    return sorted(set(names))
