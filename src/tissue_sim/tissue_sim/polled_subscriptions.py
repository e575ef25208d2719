"""Subscriptions that are emptied at a time of the node's own, with no executor in between."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription

Receiver = Callable[[Any, dict[str, int]], None]
"""Called with a message and its info: source_timestamp and received_timestamp [ns]."""

MOST_AT_ONCE = 2000
"""Messages of one topic taken in one go: a flood must not keep the node from everything else."""


class _Never(CallbackGroup):
    """Whose entities no executor waits for."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


class PolledSubscriptions:
    """Subscriptions of a node that `take` empties.

    An executor of rclpy looks at every entity of its node each time it wakes, and holds Python's
    lock for half a millisecond and more. At hundreds of messages a second that is most of what a
    node does, and what keeps a real-time loop of the same process from running.
    """

    def __init__(self, node: Node) -> None:
        """Begin with none."""
        self._node = node
        self._group = _Never()
        # Replaced as a whole, so that another thread than the one that adds may take.
        self._by_topic: dict[str, Subscription] = {}

    def __contains__(self, topic: str) -> bool:
        return self._node.resolve_topic_name(topic) in self._by_topic

    def add(
        self, message: type, topic: str, receive: Receiver, profile: QoSProfile, raw: bool = False
    ) -> None:
        """Subscribe to a topic, unless it is subscribed to already.

        Args:
            message: Its type.
            topic: Its name.
            receive: Called by `take` with each message.
            profile: Quality of service; its depth is what may come between two calls of `take`.
            raw: Whether messages stay bytes.
        """
        if topic in self:
            return
        # An executor that waits for events of a subscription wakes for its messages too.
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        made = self._node.create_subscription(
            message, topic, receive, profile, callback_group=self._group, event_callbacks=events,
            raw=raw,
        )  # fmt: skip
        self._by_topic = {**self._by_topic, made.topic_name: made}

    def remove(self, topic: str) -> None:
        """Subscribe to a topic no more."""
        name = self._node.resolve_topic_name(topic)
        removed = self._by_topic[name]
        self._by_topic = {key: kept for key, kept in self._by_topic.items() if key != name}
        self._node.destroy_subscription(removed)

    def clear(self) -> None:
        """Subscribe to nothing any more."""
        for topic in list(self._by_topic):
            self.remove(topic)

    def take(self) -> None:
        """Hand over what has come since the last call, in the order in which it came."""
        taken: list[tuple[int, int, Subscription, tuple[Any, dict[str, int]]]] = []
        for subscription in self._by_topic.values():
            for _ in range(MOST_AT_ONCE):
                found = _next(subscription)
                if found is None:
                    break
                when = found[1].get("received_timestamp", 0)
                taken.append((when, len(taken), subscription, found))
        taken.sort(key=lambda item: item[:2])
        for _, _, subscription, (message, info) in taken:
            subscription.callback(message, info)

    def incompatible(self) -> dict[str, str]:
        """Topics of which nothing arrives from somebody, and why."""
        found: dict[str, str] = {}
        for topic, subscription in self._by_topic.items():
            for info in self._node.get_publishers_info_by_topic(topic):
                result, reason = qos_check_compatible(info.qos_profile, subscription.qos_profile)
                if result == QoSCompatibility.ERROR:
                    name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                    found[topic] = (
                        f"{topic}: {name} offers an incompatible quality of service "
                        f"({reason.rstrip('; ')})"
                    )
        return found


def _next(subscription: Subscription) -> tuple[Any, dict[str, int]] | None:
    """The oldest message that waits, with its info; None: there is none."""
    try:
        with subscription.handle:
            found: tuple[Any, dict[str, int]] | None = subscription.handle.take_message(
                subscription.msg_type, subscription.raw
            )
            return found
    except InvalidHandle:
        return None  # It was removed meanwhile.
