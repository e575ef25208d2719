"""A node that is nowhere: what it publishes and asks for is written down, what it hears comes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from builtin_interfaces.msg import Time


class FakePublisher:
    """Writes down what it publishes."""

    def __init__(self, node: FakeNode, topic: str) -> None:
        self._node, self.topic = node, topic

    def publish(self, message: Any) -> None:
        self._node.published.append((self.topic, message))

    def get_subscription_count(self) -> int:
        return self._node.listeners


class FakeQueue:
    """What has come to a subscription and was not taken yet."""

    def __init__(self) -> None:
        self.messages: deque[Any] = deque()

    def __enter__(self) -> FakeQueue:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def take_message(self, *_: object) -> tuple[Any, dict[str, int]] | None:
        return (self.messages.popleft(), {}) if self.messages else None


class FakeFuture:
    """An answer that is given at once, or never."""

    def __init__(self, answer: Any, never: bool = False) -> None:
        self._answer = answer
        self._never = never

    def result(self) -> Any:
        return self._answer

    def add_done_callback(self, callback: Callable[[FakeFuture], None]) -> None:
        if not self._never:
            callback(self)


class FakeClient:
    """Writes down what it asks for, and answers what the test wants."""

    def __init__(self, node: FakeNode, name: str) -> None:
        self._node, self._name = node, name

    def service_is_ready(self) -> bool:
        return self._name not in self._node.missing

    def call_async(self, request: Any) -> FakeFuture:
        self._node.asked.append((self._name, request))
        return FakeFuture(
            self._node.answers.get(self._name, SimpleNamespace(success=True, message="")),
            never=self._name in self._node.silent,
        )


class FakeNode:
    """Stands in for an rclpy node.

    Attributes:
        published: Topic and message of all that was published.
        asked: Service and request of all that was asked for.
        answers: Answer by service; a success, if there is none.
        missing: Services that are not there.
        silent: Services that never answer.
        listeners: How many listen to each topic.
        rivals: How many others publish a topic.
        said: What was logged.
    """

    def __init__(self, acts_at_once: bool = True) -> None:
        """Begin with nothing.

        Args:
            acts_at_once: Whether a guard condition acts in the thread that triggers it; else `act`
                does, as an executor would.
        """
        self.act: Callable[[], None] = lambda: None
        self._acts_at_once = acts_at_once
        self.published: list[tuple[str, Any]] = []
        self.asked: list[tuple[str, Any]] = []
        self.answers: dict[str, Any] = {}
        self.missing: set[str] = set()
        self.silent: set[str] = set()
        self.listeners = 1
        self.rivals: dict[str, int] = {}
        self.said: list[str] = []
        self.closed: list[str] = []
        self._queues: dict[str, FakeQueue] = {}

    def hears(self, topic: str, message: Any) -> None:
        """Let a message come."""
        self._queues[topic].messages.append(message)

    def published_on(self, topic: str) -> list[Any]:
        """All that was published on a topic."""
        return [message for name, message in self.published if name == topic]

    def asked_for(self, service: str) -> list[Any]:
        """All that was asked of a service."""
        return [request for name, request in self.asked if name == service]

    # What a node has

    def create_publisher(self, _type: type, topic: str, _profile: Any) -> FakePublisher:
        return FakePublisher(self, topic)

    def destroy_publisher(self, publisher: FakePublisher) -> None:
        self.closed.append(publisher.topic)

    def create_subscription(
        self, _type: type, topic: str, callback: Callable[..., None], _profile: Any, **_: Any
    ) -> SimpleNamespace:
        queue = self._queues[topic] = FakeQueue()
        return SimpleNamespace(
            topic_name=topic, callback=callback, handle=queue, msg_type=_type, raw=False
        )

    def destroy_subscription(self, subscription: SimpleNamespace) -> None:
        del self._queues[subscription.topic_name]

    def create_client(self, _type: type, name: str) -> FakeClient:
        return FakeClient(self, name)

    def create_guard_condition(self, callback: Callable[[], None]) -> SimpleNamespace:
        self.act = callback
        return SimpleNamespace(trigger=callback if self._acts_at_once else lambda: None)

    def count_publishers(self, topic: str) -> int:
        return self.rivals.get(topic, 0)

    def resolve_topic_name(self, topic: str) -> str:
        return topic

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=Time))

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(
            info=self.said.append, warning=self.said.append, error=self.said.append
        )
