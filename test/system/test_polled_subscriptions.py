"""Subscriptions that the node empties itself: nothing lost, in order, and no executor woken."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from support.fake_simulation import wait_for
from tissue_sim.polled_subscriptions import PolledSubscriptions

RELIABLE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def nodes(ros_domain: int) -> Iterator[tuple[Node, Node]]:
    """One that listens and one that talks."""
    context = Context()
    rclpy.init(context=context, domain_id=ros_domain)
    made = Node("listener", context=context), Node("talker", context=context)
    yield made
    for node in made:
        node.destroy_node()
    context.try_shutdown()


def test_nothing_is_lost_and_all_comes_in_order_without_waking_an_executor(
    nodes: tuple[Node, Node],
) -> None:
    listener, talker = nodes
    heard: list[str] = []
    polled = PolledSubscriptions(listener)
    publishers = []
    for topic in ("left", "right"):
        polled.add(String, topic, lambda message, _info: heard.append(message.data), RELIABLE)
        publishers.append(talker.create_publisher(String, topic, RELIABLE))
    wait_for(lambda: all(publisher.get_subscription_count() for publisher in publishers))
    executor = SingleThreadedExecutor(context=listener.context)
    executor.add_node(listener)
    turns, stop = 0, threading.Event()

    def spin() -> None:
        nonlocal turns
        while not stop.is_set():
            executor.spin_once(timeout_sec=0.5)
            turns += 1

    spinning = threading.Thread(target=spin)
    spinning.start()
    time.sleep(0.2)
    before = turns
    sent = [str(number) for number in range(400)]
    for number, text in enumerate(sent):
        publishers[number % 2].publish(String(data=text))
        time.sleep(0.001)

    def all_heard() -> bool:
        polled.take()
        return len(heard) == len(sent)

    assert turns - before < 40
    wait_for(all_heard, what="every message")
    stop.set()
    spinning.join()
    executor.shutdown()
    assert heard == sent


def test_what_cannot_arrive_is_named_and_a_removed_topic_is_silent(
    nodes: tuple[Node, Node],
) -> None:
    listener, talker = nodes
    heard: list[str] = []
    polled = PolledSubscriptions(listener)
    polled.add(String, "words", lambda message, _info: heard.append(message.data), RELIABLE)
    assert "words" in polled
    weak = talker.create_publisher(String, "words", BEST_EFFORT)
    wait_for(lambda: bool(polled.incompatible()), what="the report")
    assert "/talker offers an incompatible quality of service" in polled.incompatible()["/words"]
    talker.destroy_publisher(weak)
    wait_for(lambda: not polled.incompatible(), what="its end")
    strong = talker.create_publisher(String, "words", RELIABLE)
    wait_for(strong.get_subscription_count)
    polled.remove("words")
    strong.publish(String(data="unheard"))
    polled.take()
    assert heard == []
    assert "words" not in polled
