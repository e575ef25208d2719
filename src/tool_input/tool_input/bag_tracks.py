"""Tool motion out of a bag: which topics, and their messages in order of time."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader

POSE = "geometry_msgs/msg/PoseStamped"
USE = "std_msgs/msg/Bool"
DAMAGED = (McapError, OSError, struct.error, UnicodeDecodeError)
"""What the reader raises on files that were cut off; OSError where it seeks before their start."""

TYPES = {POSE: "servo_cp", USE: "use"}


class BagError(ValueError):
    """A bag that cannot be played."""


@dataclass(frozen=True)
class Recorded:
    """A recorded message.

    Attributes:
        time: When it was received, since the first of the bag [s].
        topic: Topic in the bag.
        data: Serialised message (CDR).
    """

    time: float
    topic: str
    data: bytes


class BagTracks:
    """The tool topics of a bag.

    Attributes:
        topics: Type of each topic played, by its name in the bag.
        targets: Topic each is published on.
    """

    def __init__(self, path: Path, remaps: Sequence[str] = ()) -> None:
        """Look into a bag.

        Args:
            path: An MCAP file or a bag directory.
            remaps: Topics to play as "topic in the bag:=topic to publish"; empty: every
                `tools/<tool>/servo_cp` and `tools/<tool>/use`, under the same names.

        Raises:
            BagError: The bag cannot be read, or has no such topic.
        """
        self._files = bag_files(path)
        there = self._recorded_types()
        wanted = _remaps(remaps) if remaps else _tool_topics(there)
        if not wanted:
            raise BagError(
                f"{path}: no tools/<tool>/servo_cp in it; its topics: {', '.join(sorted(there))}. "
                "Name a PoseStamped topic with remap"
            )
        for topic in wanted:
            if topic not in there:
                raise BagError(f"{path}: no topic {topic}; there are {', '.join(sorted(there))}")
            if there[topic] not in TYPES:
                raise BagError(
                    f"{path}: {topic} is a {there[topic]}; only {' and '.join(TYPES)} can be played"
                )
        self.topics: dict[str, str] = {topic: there[topic] for topic in wanted}
        self.targets: Mapping[str, str] = wanted

    def messages(self) -> Iterator[Recorded]:
        """All messages in order of time.

        Raises:
            BagError: A file is damaged.
        """
        first: int | None = None
        for file in self._files:
            with file.open("rb") as stream:
                try:
                    for _, channel, message in make_reader(stream).iter_messages(
                        topics=list(self.topics)
                    ):
                        first = message.log_time if first is None else first
                        seconds = 1e-9 * (message.log_time - first)
                        yield Recorded(seconds, channel.topic, message.data)
                except DAMAGED as error:
                    raise _damaged(file, error) from None

    def _recorded_types(self) -> dict[str, str]:
        types: dict[str, str] = {}
        for file in self._files:
            try:
                with file.open("rb") as stream:
                    types |= _types(make_reader(stream))
            except (FileNotFoundError, PermissionError) as error:
                raise BagError(f"{file}: cannot be read: {error}") from None
            except DAMAGED as error:
                raise _damaged(file, error) from None
        return types


def bag_files(path: Path) -> list[Path]:
    """The MCAP files of a bag in order.

    Raises:
        BagError: There are none.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise BagError(f"{path}: no such bag")
    try:
        content = yaml.safe_load((path / "metadata.yaml").read_text(encoding="utf-8"))
        names = content["rosbag2_bagfile_information"]["relative_file_paths"]
        files = [path / name for name in names]
    except (OSError, yaml.YAMLError, KeyError, TypeError):
        files = sorted(path.glob("*.mcap"))
    if not files:
        raise BagError(f"{path}: no .mcap file in it")
    return files


def _types(reader: McapReader) -> dict[str, str]:
    summary = reader.get_summary()
    if summary is None:
        raise McapError("it has no summary: it was not ended properly")
    schemas = summary.schemas
    return {
        channel.topic: schemas[channel.schema_id].name
        for channel in summary.channels.values()
        if channel.schema_id in schemas
    }


def _damaged(file: Path, error: Exception) -> BagError:
    reason = str(error) or type(error).__name__
    return BagError(f"{file}: damaged or not ended ({reason}); mend it with: tissue bag recover")


def _tool_topics(types: Mapping[str, str]) -> dict[str, str]:
    found = {}
    for topic, kind in types.items():
        parts = topic.strip("/").split("/")
        if len(parts) >= 3 and parts[-3] == "tools" and TYPES.get(kind) == parts[-1]:
            found[topic] = "/".join(parts[-3:])
    return found


def _remaps(texts: Sequence[str]) -> dict[str, str]:
    wanted: dict[str, str] = {}
    for text in texts:
        source, arrow, target = text.partition(":=")
        if not (arrow and source.strip() and target.strip()):
            raise BagError(f"remap {text!r} must be written as topic_in_the_bag:=topic_to_publish")
        wanted[source.strip()] = target.strip()
    return wanted
