"""Plays topics out of a bag at the times they were recorded."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from viz_bridge.bag_reader import BagMessage, read_bag, topic_counts


@dataclass(frozen=True)
class PlayOptions:
    """How a bag is played; the flags of `ros2 bag play`.

    Attributes:
        rate: Times faster than recorded.
        topics: Full names of the topics to play; empty for all.
        loop: Begin again at the end.
        start_offset: Skip so many seconds.
    """

    rate: float = 1.0
    topics: tuple[str, ...] = ()
    loop: bool = False
    start_offset: float = 0.0


class Publisher(Protocol):
    """Publishes bytes."""

    def publish(self, item: BagMessage) -> None:
        """Publish one message of a bag."""


def check_options(bag: Path, options: PlayOptions) -> None:
    """Refuse what cannot be played.

    Raises:
        ValueError: A value is not allowed, or a topic is not in the bag.
    """
    if not 0.01 <= options.rate <= 100.0:
        raise ValueError(f"rate {options.rate:g} is not allowed; allowed: 0.01 to 100")
    if options.start_offset < 0:
        raise ValueError(f"start offset {options.start_offset:g} s is not allowed; at least 0")
    known = topic_counts(bag)
    unknown = [topic for topic in options.topics if topic not in known]
    if unknown:
        raise ValueError(f"{bag} has no {', '.join(unknown)}; it has {', '.join(sorted(known))}")


def schedule(bag: Path, options: PlayOptions) -> Iterator[tuple[float, BagMessage]]:
    """Messages of one turn and when each is due, in seconds after the turn's beginning."""
    start: int | None = None
    for item in read_bag(bag, options.topics or None):
        start = item.log_time if start is None else start
        recorded = (item.log_time - start) / 1e9
        if recorded >= options.start_offset:
            yield (recorded - options.start_offset) / options.rate, item


def play(
    bag: Path,
    options: PlayOptions,
    publisher: Publisher,
    wait: Callable[[float], bool],
) -> int:
    """Play a bag.

    Args:
        bag: Directory or file.
        options: How.
        publisher: Takes the messages.
        wait: Waits until a steady time [s] (time.monotonic); False ends playing.

    Returns:
        Number of messages played.

    Raises:
        ValueError: The bag cannot be read, or an option is not allowed.
    """
    check_options(bag, options)
    played = 0
    while True:
        begun, before = time.monotonic(), played
        for due, item in schedule(bag, options):
            if not wait(begun + due):
                return played
            publisher.publish(item)
            played += 1
        if not options.loop or played == before:
            return played
