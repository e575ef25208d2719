"""Node `bag_player`: publishes what a bag holds; `tissue bag play` runs it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from tissue_sim import qos
from tissue_sim.discovery import stay_local
from viz_bridge.bag_player import PlayOptions, play
from viz_bridge.bag_reader import BagMessage, topic_types
from viz_bridge.recorded_topics import FIXED, message_class, of_tool

MATCH_SECONDS = 3.5
"""Most that is waited for subscribers: what comes before they match is lost, and the middleware
takes up to three seconds to find one."""


def profile_of(topic: str) -> QoSProfile:
    """How a topic is offered: as the node that was recorded offers it."""
    for known in FIXED:
        if topic.endswith("/" + known.name.lstrip("/")):
            return qos.STATE if known.name == "tissue/state" else known.profile
    leaf = topic.rsplit("/", 1)[-1]
    for known in of_tool("any"):
        if known.name.endswith("/" + leaf):
            return qos.USE if leaf in ("use", "clutch") else qos.POSE
    return qos.USE


class BagPlayer(Node):
    """Publishes bytes as they are."""

    def __init__(self) -> None:
        super().__init__("bag_player")
        self._by_topic: dict[str, Publisher] = {}

    def prepare(self, topics: dict[str, str]) -> None:
        """Make the publishers of all topics, by name and type."""
        for topic, type_name in topics.items():
            self._by_topic[topic] = self.create_publisher(
                message_class(type_name), topic, profile_of(topic)
            )

    def heard(self) -> bool:
        """Whether every topic has a subscriber."""
        return all(p.get_subscription_count() for p in self._by_topic.values())

    def publish(self, item: BagMessage) -> None:
        """Publish one message."""
        publisher: Any = self._by_topic[item.topic]
        publisher.publish(item.data)


def run_player(
    bag: Path, options: PlayOptions, progress: Callable[[int], None] | None = None
) -> int:
    """Play a bag until it is over or interrupted; returns the number of messages played.

    Raises:
        ValueError: The bag cannot be read, a type is not installed, or an option is not allowed.
    """
    types = topic_types(bag)
    topics = {topic: types[topic] for topic in options.topics or types}
    stay_local()
    rclpy.init()
    player = BagPlayer()
    executor = SingleThreadedExecutor()
    executor.add_node(player)
    published = 0

    def wait(until: float) -> bool:
        nonlocal published
        published += 1
        if progress is not None:
            progress(published)
        while (rest := until - time.monotonic()) > 0 and rclpy.ok():
            executor.spin_once(timeout_sec=min(rest, 0.1))
        return rclpy.ok()

    try:
        player.prepare(topics)
        latest = time.monotonic() + MATCH_SECONDS
        while not player.heard() and time.monotonic() < latest and rclpy.ok():
            executor.spin_once(timeout_sec=0.05)
        return play(bag, options, player, wait)
    except (KeyboardInterrupt, ExternalShutdownException):
        return published
    finally:
        player.destroy_node()
        rclpy.try_shutdown()
