"""A device's driver that repeats its newest messages until it is unplugged."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import rclpy
from rclpy.context import Context

REPEAT_SECONDS = 0.02


class Device:
    """Publishes the newest message of each topic 50 times a second, as drivers repeat theirs.

    Attributes:
        says: The newest message of each topic.
        plugged: Whether it publishes.
    """

    def __init__(self) -> None:
        self.says: dict[str, Any] = {}
        self.plugged = True


@contextmanager
def device(
    domain: int, topics: Mapping[str, type], stamp: Callable[[Any], None] = lambda _: None
) -> Iterator[Device]:
    """A device that publishes from a context of its own.

    Args:
        domain: ROS domain.
        topics: Type of each topic it publishes.
        stamp: Called with each message before it is published.
    """
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("device", context=context)
    outputs = {topic: node.create_publisher(kind, topic, 10) for topic, kind in topics.items()}
    made, ended = Device(), threading.Event()

    def repeat() -> None:
        while not ended.wait(REPEAT_SECONDS):
            for topic, message in list(made.says.items()) if made.plugged else []:
                stamp(message)
                outputs[topic].publish(message)

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield made
    finally:
        ended.set()
        thread.join()
        node.destroy_node()
        context.try_shutdown()
