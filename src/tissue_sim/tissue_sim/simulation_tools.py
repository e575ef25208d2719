"""Sources of tool motion: the simulation's subscriptions for each tool."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription
from std_msgs.msg import Bool

from tissue_sim import conversions, qos
from tissue_sim.frames import Frames, UnknownFrameError
from tissue_sim.interaction.rigid import PoseError, checked_pose
from tissue_sim.live import LiveSimulation
from tissue_sim.polled_subscription import Polled, messages
from tissue_sim.simulation_topics import ToolTopics


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
        # Replaced as a whole, too.
        self._subscriptions: dict[str, tuple[Subscription, ...]] = {}
        self._polled = Polled()

    def follow(self, tools: Iterable[str]) -> None:
        """Subscribe and publish for these tools and no others."""
        wanted = list(tools)
        topics, subscriptions = dict(self.topics), dict(self._subscriptions)
        for gone in [tool for tool in topics if tool not in wanted]:
            leaving, unheard = topics.pop(gone), subscriptions.pop(gone)
            self.topics, self._subscriptions = dict(topics), dict(subscriptions)
            for subscription in unheard:
                self._node.destroy_subscription(subscription)
            leaving.destroy(self._node)
        for tool in wanted:
            if tool not in topics:
                topics[tool] = ToolTopics(self._node, tool, self._frames.organ)
                subscriptions[tool] = self._subscribe(tool)
        self.topics, self._subscriptions = topics, subscriptions

    def take(self) -> None:
        """Hand over what has come since the last frame."""
        for subscriptions in self._subscriptions.values():
            for subscription in subscriptions:
                for message in messages(subscription):
                    subscription.callback(message)

    def watch_sources(self) -> list[str]:
        """Tell the trackers who publishes poses; give the unknown tools that poses are sent to."""
        for tool in self.topics:
            infos = self._node.get_publishers_info_by_topic(f"tools/{tool}/servo_cp")
            self._live.post_sources(tool, _source_names(infos))
        self.bad_qos = dict(self._incompatible())
        prefix = self._node.resolve_topic_name("tools/_/servo_cp").removesuffix("_/servo_cp")
        unknown = []
        for topic, _ in self._node.get_topic_names_and_types():
            if topic.startswith(prefix) and topic.endswith("/servo_cp"):
                tool = topic[len(prefix) : -len("/servo_cp")]
                if tool not in self.topics and self._node.count_publishers(topic):
                    unknown.append(tool)
        return unknown

    def _incompatible(self) -> Iterator[tuple[str, str]]:
        """Topics, and who offers them so that nothing arrives; poses always do."""
        for tool in self.topics:
            for topic in (f"tools/{tool}/use", f"tools/{tool}/clutch"):
                for info in self._node.get_publishers_info_by_topic(topic):
                    result, reason = qos_check_compatible(info.qos_profile, qos.USE)
                    if result == QoSCompatibility.ERROR:
                        yield topic, (
                            f"{topic}: {', '.join(_source_names([info]))} offers an incompatible "
                            f"quality of service ({reason.rstrip('; ')})"
                        )

    def _subscribe(self, tool: str) -> tuple[Subscription, ...]:
        def on_pose(message: PoseStamped) -> None:
            self._on_pose(tool, message)

        def on_use(message: Bool) -> None:
            self._live.post_use(tool, bool(message.data))

        def on_clutch(message: Bool) -> None:
            self._live.post_clutch(tool, bool(message.data))

        made = []
        for message, name, callback, profile in (
            (PoseStamped, "servo_cp", on_pose, qos.POSE_IN),
            (Bool, "use", on_use, qos.USE),
            (Bool, "clutch", on_clutch, qos.USE),
        ):
            topic = f"tools/{tool}/{name}"
            subscription = self._node.create_subscription(
                message, topic, callback, profile, callback_group=self._polled,
                # An executor that waits for events of a subscription wakes for its messages too.
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            )  # fmt: skip
            made.append(subscription)
        return tuple(made)

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
