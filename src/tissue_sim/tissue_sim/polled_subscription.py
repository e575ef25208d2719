"""Subscriptions that a loop empties at a time of its own, with no executor in between."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.subscription import Subscription


class Polled(CallbackGroup):
    """Whose subscriptions no executor waits for: `messages` takes what has come.

    An executor of rclpy looks at every entity of the node each time it wakes, and holds Python's
    lock for half a millisecond and more: at 125 messages a second that keeps a real-time loop of
    the same process from running.
    """

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing was begun."""


def messages(subscription: Subscription) -> Iterator[Any]:
    """Messages that have come since the last call, oldest first; none once it is destroyed."""
    while True:
        try:
            with subscription.handle:
                taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        except InvalidHandle:
            return
        if taken is None:
            return
        yield taken[0]
