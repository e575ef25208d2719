"""Reads bags: messages in the order they were received, decoded with the definitions in the bag."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.records import Message as Record
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

from viz_bridge.bag_writer import bag_files
from viz_bridge.cdr import Decoder, Message

KNOWN = ("tissue/state", "tissue/topology", "tissue/journal", "tissue/edits", "tissue/status")


DAMAGE = (McapError, EOFError, OSError, RuntimeError, ValueError, struct.error, ZstdError)
"""What the reader and the decompressors raise on bytes that are no MCAP file."""


class BagError(ValueError):
    """A bag that cannot be read; the message says what to do."""


@dataclass(frozen=True)
class BagMessage:
    """One message of a bag.

    Attributes:
        topic: Full name of its topic.
        type_name: Its type.
        log_time: When it was received [ns since 1970].
        publish_time: When it was published [ns since 1970].
        data: Its bytes in CDR.
        decoder: Reads the bytes.
    """

    topic: str
    type_name: str
    log_time: int
    publish_time: int
    data: bytes
    decoder: Decoder

    @property
    def message(self) -> Message:
        """The message."""
        return self.decoder(self.data)


class Decoders:
    """A decoder per message type of a bag, made when needed."""

    def __init__(self) -> None:
        self._made: dict[tuple[str, bytes], Decoder] = {}

    def of(self, schema: Schema | None, channel: Channel) -> Decoder:
        """The decoder for a channel.

        Raises:
            BagError: The channel is not in CDR with a `ros2msg` definition.
        """
        if schema is None or schema.encoding != "ros2msg" or channel.message_encoding != "cdr":
            raise BagError(f"{channel.topic} is not recorded as ROS 2 messages")
        key = (schema.name, schema.data)
        if key not in self._made:
            self._made[key] = Decoder(schema.name, schema.data.decode())
        return self._made[key]


def summaries(bag: Path) -> dict[Path, Summary]:
    """The index of each file of a bag.

    Raises:
        BagError: A file was not ended, or is no MCAP file.
    """
    found = {}
    for path in bag_files(bag):
        with path.open("rb") as stream:
            if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise BagError(f"{path} is no MCAP file: it {_is_instead(path)}")
            stream.seek(0)
            try:
                summary = make_reader(stream).get_summary()
            except DAMAGE:
                summary = None
        if summary is None or summary.statistics is None:
            raise BagError(
                f"{path} was not ended (it has no index); `tissue bag recover` makes a whole bag "
                "of what is there"
            )
        found[path] = summary
    return found


def _is_instead(path: Path) -> str:
    return "does not begin as one" if path.stat().st_size else "is empty"


def read_bag(
    bag: Path, topics: Iterable[str] | None = None, start: int = 0
) -> Iterator[BagMessage]:
    """The messages of a bag, file by file, in the order they were received.

    Args:
        bag: Directory or file.
        topics: Full names of the topics wanted; None for all.
        start: Without those received before this time [ns since 1970].

    Raises:
        BagError: The bag was not ended or is damaged.
        ValueError: There is no bag.
    """
    wanted = list(topics) if topics is not None else None
    decoders = Decoders()
    for path in summaries(bag):
        with path.open("rb") as stream:
            try:
                for schema, channel, record in _messages(stream, wanted, start):
                    yield BagMessage(
                        channel.topic,
                        schema.name if schema is not None else "",
                        record.log_time,
                        record.publish_time,
                        record.data,
                        decoders.of(schema, channel),
                    )
            except DAMAGE as error:
                raise BagError(f"{path} is damaged: {error}") from None


def _messages(
    stream: BinaryIO, wanted: list[str] | None, start: int
) -> Iterator[tuple[Schema | None, Channel, Record]]:
    reader = make_reader(stream, validate_crcs=True)
    return reader.iter_messages(topics=wanted, starting_at=start or None)


def topic_counts(bag: Path) -> dict[str, int]:
    """Messages by full topic name."""
    counts: dict[str, int] = {}
    for summary in summaries(bag).values():
        assert summary.statistics is not None
        for number, channel in summary.channels.items():
            count = summary.statistics.channel_message_counts.get(number, 0)
            counts[channel.topic] = counts.get(channel.topic, 0) + count
    return counts


def topic_types(bag: Path) -> dict[str, str]:
    """Message types by full topic name."""
    return {
        channel.topic: summary.schemas[channel.schema_id].name
        for summary in summaries(bag).values()
        for channel in summary.channels.values()
        if channel.schema_id in summary.schemas
    }


def metadata_of(bag: Path) -> dict[str, str]:
    """What a bag says about where it comes from: seed, revision and the like.

    Raises:
        BagError: The bag was not ended.
    """
    told: dict[str, str] = {}
    for path in summaries(bag):
        with path.open("rb") as stream:
            for record in make_reader(stream).iter_metadata():
                if record.name != "rosbag2":
                    told |= record.metadata
    return told


def attachments(bag: Path) -> dict[str, bytes]:
    """The files in a bag by name; of several of a name the last.

    Raises:
        BagError: The bag was not ended.
    """
    found: dict[str, bytes] = {}
    for path in summaries(bag):
        with path.open("rb") as stream:
            found |= {item.name: item.data for item in make_reader(stream).iter_attachments()}
    return found


def organ_namespaces(topics: Iterable[str]) -> list[str]:
    """The namespaces in which there is an organ, such as "" or "/left", sorted."""
    found = set()
    for topic in topics:
        for known in KNOWN:
            if topic.endswith("/" + known):
                found.add(topic.removesuffix("/" + known))
    return sorted(found)


def only_namespace(bag: Path, wanted: str | None) -> str:
    """The namespace to look at: the one wanted, or the only one.

    Raises:
        BagError: It is not in the bag, or none is named and there are several.
    """
    found = organ_namespaces(topic_counts(bag))
    if wanted is not None:
        name = "/" + wanted.strip("/") if wanted.strip("/") else ""
        if name in found:
            return name
        raise BagError(f"{bag} has no organ in namespace {wanted!r}; it has {found or 'none'}")
    if len(found) == 1:
        return found[0]
    if not found:
        raise BagError(f"{bag} holds nothing of an organ (no topic like /tissue/state)")
    raise BagError(f"{bag} holds several organs; choose a namespace among {found}")


def read_organ(bag: Path, namespace: str | None = None) -> Iterator[tuple[str, BagMessage]]:
    """The messages about one organ with their topics relative to its namespace.

    `/diagnostics` keeps its name.

    Raises:
        BagError: As `read_bag` and `only_namespace`.
    """
    prefix = only_namespace(bag, namespace) + "/"
    for item in read_bag(bag):
        if item.topic == "/diagnostics":
            yield item.topic, item
        elif item.topic.startswith(prefix):
            yield item.topic.removeprefix(prefix), item
