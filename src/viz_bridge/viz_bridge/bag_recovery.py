"""Checks bags and mends those that were not ended."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from viz_bridge.bag_metadata import FILE_NAME
from viz_bridge.bag_reader import DAMAGE, BagError, read_bag, summaries
from viz_bridge.bag_writer import BagOptions, BagWriter, Origin, bag_files
from viz_bridge.cdr import CdrError

_JOURNAL = "/tissue/journal"


@dataclass
class Findings:
    """What a check of a bag found.

    Attributes:
        messages: Messages read.
        problems: What is wrong, in words; empty for a good bag.
        notes: What a person may want to know.
    """

    messages: int = 0
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def check(bag: Path, progress: Callable[[int], None] | None = None) -> Findings:
    """Read every message of a bag with its definition, and look for gaps in the journal.

    Args:
        bag: Directory or file.
        progress: Called with the number of messages read so far.

    Raises:
        ValueError: There is no bag.
    """
    findings = Findings()
    if bag.is_dir() and not (bag / FILE_NAME).is_file():
        bag_files(bag)
        findings.problems.append(f"{FILE_NAME} is missing; `tissue bag recover` makes it")
    broken: dict[str, int] = {}
    frames: dict[tuple[str, bytes], int] = {}
    try:
        for item in read_bag(bag):
            findings.messages += 1
            if progress is not None:
                progress(findings.messages)
            try:
                message = item.message
            except (CdrError, ValueError) as error:
                broken[item.topic] = broken.get(item.topic, 0) + 1
                if broken[item.topic] == 1:
                    findings.problems.append(f"{item.topic}: {error}")
                continue
            if item.topic.endswith(_JOURNAL):
                key = (item.topic, message.epoch.tobytes())
                before = frames.get(key)
                frame = int(message.frame)
                if before is None and frame != 1:
                    findings.notes.append(f"{item.topic} begins at frame {frame}: no replay from 1")
                elif before is not None and frame != before + 1:
                    findings.problems.append(
                        f"{item.topic}: frame {before} is followed by frame {frame}"
                    )
                frames[key] = frame
    except BagError as error:
        findings.problems.append(str(error))
    findings.problems += [
        f"{topic}: {count} messages cannot be read" for topic, count in broken.items() if count > 1
    ]
    return findings


@dataclass(frozen=True)
class Recovery:
    """What was saved of a bag."""

    messages: int
    seconds: float
    torn: tuple[str, ...]


def recover(bag: Path, target: Path, progress: Callable[[int], None] | None = None) -> Recovery:
    """Write a new, whole bag with all that can be read of one that was not ended.

    Args:
        bag: Directory or file; it is left as it is.
        target: Directory of the new bag; must not exist, or be empty.
        progress: Called with the number of messages saved so far.

    Raises:
        ValueError: There is no bag, or the target is not empty.
        OSError: The target cannot be written.
    """
    files = bag_files(bag)
    writer = BagWriter(target, BagOptions(min_free_gb=0.0))
    torn: list[str] = []
    saved = 0
    try:
        for path in files:
            known = _Definitions(path)
            for record in _records(path, torn):
                known.learn(record)
                if isinstance(record, Metadata) and record.name != "rosbag2":
                    writer.describe(record.name, dict(record.metadata))
                elif isinstance(record, Attachment):
                    writer.attach(record.name, record.media_type, record.data)
                elif isinstance(record, Message):
                    saved += _save(writer, record, *known.of(record.channel_id))
                    if progress is not None:
                        progress(saved)
            if known.unknown:
                torn.append(f"{path.name}: {known.unknown} messages whose definition is lost")
    finally:
        writer.describe("tissue_sim/recovery", {"recovered_from": str(bag)})
        info = writer.close(timeout=600.0)
    if writer.ended:
        raise OSError(f"{target}: {writer.ended}")
    return Recovery(info.messages, info.seconds, tuple(torn))


class _Definitions:
    """Channels and schemas met so far in one file, and those in its index if it has one."""

    def __init__(self, path: Path) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self.unknown = 0
        try:
            (summary,) = summaries(path).values()
        except BagError:
            return
        self._schemas.update(summary.schemas)
        self._channels.update(summary.channels)

    def learn(self, record: McapRecord) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record

    def of(self, channel_id: int) -> tuple[Channel | None, Schema | None]:
        channel = self._channels.get(channel_id)
        schema = self._schemas.get(channel.schema_id) if channel is not None else None
        self.unknown += schema is None
        return channel, schema


def _records(path: Path, torn: list[str]) -> Iterator[McapRecord]:
    """All records that can be read; damaged chunks are passed over."""
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream, emit_chunks=True).records:
                if not isinstance(record, Chunk):
                    yield record
                    continue
                try:
                    inside = breakup_chunk(record, validate_crc=True)
                except DAMAGE as error:
                    torn.append(f"{path.name}: a chunk is damaged ({error})")
                    continue
                yield from inside
        except DAMAGE as error:
            torn.append(f"{path.name}: {str(error) or 'it ends in the middle of a record'}")


def _save(
    writer: BagWriter, record: Message, channel: Channel | None, schema: Schema | None
) -> int:
    if schema is None or channel is None:
        return 0
    origin = origin_of(channel, schema)
    return writer.write(
        channel.topic,
        schema.name,
        record.data,
        record.log_time,
        record.publish_time,
        origin,
        wait=True,
    )


def origin_of(channel: Channel, schema: Schema) -> Origin:
    """Where the messages of a channel come from, for a bag they are copied into."""
    return Origin(
        _qos(channel.metadata.get("offered_qos_profiles", "")),
        schema.data.decode(),
        channel.metadata.get("topic_type_hash", ""),
    )


def _qos(text: str) -> list[dict[str, Any]]:
    try:
        profiles = yaml.safe_load(text) if text else []
    except yaml.YAMLError:
        return []
    return profiles if isinstance(profiles, list) else []
