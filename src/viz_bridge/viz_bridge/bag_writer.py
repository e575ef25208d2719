"""Writes a bag as rosbag2 does: a directory of MCAP files with metadata.yaml.

A thread of its own writes. Nobody who hands over a message ever waits for the disk: messages lie in
a queue bounded in bytes, and what does not fit is dropped, counted and reported. Chunks are small
and closed at least twice a second, so that a killed process loses at most half a second (see
`bag_recovery`).
"""

from __future__ import annotations

import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from mcap.writer import CompressionType, Writer

from viz_bridge.bag_metadata import FILE_NAME, BagInfo, FileInfo, TopicInfo, qos_text
from viz_bridge.message_text import message_text, type_hash
from viz_bridge.reserve_file import DiskFullError, ReserveFile

Compression = Literal["none", "lz4", "zstd"]
Notify = Callable[[str, str], None]
"""Called with "info", "warn" or "error" and a sentence; from the writer's thread."""

_COMPRESSION = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}
GB = 1e9
LIBRARY = "tissue_sim viz_bridge"


@dataclass(frozen=True)
class BagOptions:
    """How a bag is written.

    Attributes:
        compression: Of the chunks.
        chunk_bytes: A chunk is closed when it is larger [B].
        flush_seconds: A chunk is closed at least this often [s].
        queue_bytes: What may wait for the disk [B].
        min_free_gb: The bag is ended when less is free on its disk [GB].
    """

    compression: Compression = "lz4"
    chunk_bytes: int = 64 * 1024
    flush_seconds: float = 0.25
    queue_bytes: int = 256 * 1024 * 1024
    min_free_gb: float = 1.0


@dataclass
class BagCounts:
    """What became of the messages so far."""

    written: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    bytes: int = 0


@dataclass(frozen=True)
class Origin:
    """Where the messages of a topic come from.

    Attributes:
        qos: What its publishers offer, as rosbag2 writes it.
        definition: Definition of the type; empty: the one installed.
        type_hash: Likewise.
    """

    qos: Sequence[dict[str, Any]] = ()
    definition: str = ""
    type_hash: str = ""


@dataclass(frozen=True)
class _Item:
    kind: Literal["message", "attachment", "metadata", "split"]
    name: str = ""
    type_name: str = ""
    data: bytes = b""
    log_time: int = 0
    publish_time: int = 0
    values: Any = None


def _say_nothing(_level: str, _text: str) -> None:
    pass


class BagWriter:
    """Writes one bag.

    Attributes:
        directory: The bag.
        counts: Messages written and dropped by topic, and bytes on disk.
        ended: Why the bag ended by itself; empty while it is written.
    """

    def __init__(
        self, directory: Path, options: BagOptions | None = None, notify: Notify = _say_nothing
    ) -> None:
        """Make the directory and start the thread.

        Args:
            directory: Where the bag goes; must not exist, or be empty.
            options: How it is written.
            notify: Told what a person should know.

        Raises:
            ValueError: The directory is not empty.
            OSError: It cannot be made or written.
        """
        self.options = options or BagOptions()
        self.directory = Path(directory)
        if self.directory.exists() and any(self.directory.iterdir()):
            raise ValueError(
                f"{self.directory} is there already and not empty; choose another directory"
            )
        self.directory.mkdir(parents=True, exist_ok=True)
        self.counts = BagCounts()
        self.ended = ""
        self._notify = notify
        self._info = BagInfo()
        self._items: deque[_Item] = deque()
        self._queued = 0
        self._wake = threading.Condition()
        self._closing = False
        self._warned_at = 0.0
        self._refuse_full_disk()
        self._open()
        self._thread = threading.Thread(target=self._work, name="bag writer", daemon=True)
        self._thread.start()

    def write(
        self,
        topic: str,
        type_name: str,
        data: bytes,
        log_time: int,
        publish_time: int = 0,
        origin: Origin | None = None,
        wait: bool = False,
    ) -> bool:
        """Hand over one message; returns at once.

        Args:
            topic: Full name of the topic.
            type_name: Such as `std_msgs/msg/Bool`.
            data: The message in CDR.
            log_time: When it was received [ns since 1970].
            publish_time: When it was published [ns since 1970]; 0: as log_time.
            origin: Where it comes from; counts with a topic's first message.
            wait: Wait for room in the queue instead of dropping: for copies, not for recording.

        Returns:
            False where it was dropped: the queue is full, or the bag has ended.
        """
        item = _Item("message", topic, type_name, data, log_time, publish_time or log_time, origin)
        with self._wake:
            if wait:
                self._wake.wait_for(lambda: self.ended or not self._queued or self._room(item))
            # A message larger than the queue is let in when it is alone.
            full = self._queued > 0 and not self._room(item)
            if self.ended or self._closing or full:
                self.counts.dropped[topic] += 1
                return False
            self._items.append(item)
            self._queued += len(data)
            self._wake.notify_all()
        return True

    def _room(self, item: _Item) -> bool:
        return self._queued + len(item.data) <= self.options.queue_bytes

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Put a file into the bag."""
        self._order(_Item("attachment", name, media_type, data, time.time_ns()))

    def describe(self, name: str, values: dict[str, str]) -> None:
        """Put a metadata record into the bag; metadata.yaml has its entries as custom data."""
        self._order(_Item("metadata", name, values=dict(values)))

    def split(self) -> None:
        """Go on in a new file of the same bag."""
        self._order(_Item("split"))

    def close(self, timeout: float = 30.0) -> BagInfo:
        """Write what waits, end the bag, and say what is in it. May be called twice."""
        with self._wake:
            self._closing = True
            self._wake.notify_all()
        self._thread.join(timeout)
        if self._thread.is_alive():
            self._notify("error", f"{self.directory}: the disk takes longer than {timeout:g} s")
        return self._info

    def _order(self, item: _Item) -> None:
        with self._wake:
            self._items.append(item)
            self._wake.notify_all()

    def _work(self) -> None:
        try:
            self._write_until_closed()
        except DiskFullError as error:
            self._end(f"the disk is full ({error.strerror}); `tissue bag recover` mends the bag")
        except OSError as error:
            self._end(f"writing failed: {error}; `tissue bag recover` mends the bag")
        finally:
            self._finish()

    def _write_until_closed(self) -> None:
        due = time.monotonic() + self.options.flush_seconds
        while not self.ended:
            with self._wake:
                if not self._items and not self._closing:
                    self._wake.wait(max(0.0, due - time.monotonic()))
                taken = list(self._items)
                self._items.clear()
                self._queued = 0
                self._wake.notify_all()
                done = self._closing and not taken
            for index, item in enumerate(taken):
                self._take(item)
                if time.monotonic() >= due:
                    due = self._flush()
                if self._file.full:
                    rest = [i.name for i in taken[index + 1 :] if i.kind == "message"]
                    self.counts.dropped.update(rest)
                    return self._end(f"the disk is full ({self._file.full})")
            if done:
                return None
            if time.monotonic() >= due:
                due = self._flush()
        return None

    def _take(self, item: _Item) -> None:
        if item.kind == "message":
            self._put(item)
        elif item.kind == "attachment":
            self._mcap.add_attachment(
                item.log_time, item.log_time, item.name, item.type_name, item.data
            )
        elif item.kind == "metadata":
            self._mcap.add_metadata(item.name, item.values)
            self._info.custom.update(item.values)
        else:
            self._finish_file()
            self._open()

    def _put(self, item: _Item) -> None:
        try:
            channel = self._channels.get(item.name) or self._channel(item)
        except ValueError as error:
            self.counts.dropped[item.name] += 1
            if self.counts.dropped[item.name] == 1:
                self._notify("error", f"{item.name} is not recorded: {error}")
            return
        self._sequence[channel] += 1
        self._mcap.add_message(
            channel, item.log_time, item.data, item.publish_time, self._sequence[channel]
        )
        self._info.files[-1].count(item.log_time)
        self._info.topics[item.name].messages += 1
        self.counts.written[item.name] += 1

    def _channel(self, item: _Item) -> int:
        origin = item.values or Origin()
        definition = origin.definition or message_text(item.type_name)
        known = self._info.topics.get(item.name)
        if known is None:
            hashed = origin.type_hash or type_hash(item.type_name)
            known = TopicInfo(item.name, item.type_name, hashed, list(origin.qos))
        elif known.type_name != item.type_name:
            raise ValueError(f"its type was {known.type_name} and is now {item.type_name}")
        if item.type_name not in self._schemas:
            self._schemas[item.type_name] = self._mcap.register_schema(
                item.type_name, "ros2msg", definition.encode()
            )
        self._channels[item.name] = self._mcap.register_channel(
            item.name,
            "cdr",
            self._schemas[item.type_name],
            {"offered_qos_profiles": qos_text(known.qos), "topic_type_hash": known.type_hash},
        )
        self._info.topics[item.name] = known
        return self._channels[item.name]

    def _flush(self) -> float:
        self._mcap.flush()
        self.counts.bytes = self._bytes_before + self._file.tell()
        free = free_bytes(self.directory)
        if free < self.options.min_free_gb * GB:
            self._end(
                f"only {free / GB:.2f} GB are free on its disk; min_free_gb is "
                f"{self.options.min_free_gb:g}"
            )
        dropped = sum(self.counts.dropped.values())
        now = time.monotonic()
        if dropped and not self.ended and now - self._warned_at > 5.0:
            self._warned_at = now
            self._notify(
                "warn", f"{dropped} messages dropped so far: the disk is too slow for the recording"
            )
        return now + self.options.flush_seconds

    def _refuse_full_disk(self) -> None:
        free = free_bytes(self.directory)
        if free < self.options.min_free_gb * GB:
            raise ValueError(
                f"only {free / GB:.2f} GB are free where {self.directory} would be recorded; "
                f"min_free_gb is {self.options.min_free_gb:g}"
            )

    def _open(self) -> None:
        self._bytes_before = self.counts.bytes
        name = f"{self.directory.resolve().name}_{len(self._info.files)}.mcap"
        self._file = ReserveFile(self.directory / name)
        self._mcap = Writer(
            self._file,
            chunk_size=self.options.chunk_bytes,
            compression=_COMPRESSION[self.options.compression],
        )
        self._mcap.start("ros2", LIBRARY)
        self._info.files.append(FileInfo(name))
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._sequence: Counter[int] = Counter()

    def _end(self, why: str) -> None:
        with self._wake:
            self.ended = why
            waiting = [item.name for item in self._items if item.kind == "message"]
            self.counts.dropped.update(waiting)
            self._items.clear()
            self._queued = 0
        self._notify("error", f"recording to {self.directory} has ended: {why}")

    def _finish(self) -> None:
        try:
            self._finish_file()
            self._info.write(self.directory)
        except OSError as error:
            reason = error.strerror or str(error)
            self._notify(
                "error",
                f"{self.directory} could not be ended: {reason}; `tissue bag recover` mends it",
            )

    def _finish_file(self) -> None:
        try:
            self._mcap.flush()
            self._mcap.add_metadata(
                "rosbag2", {"serialized_metadata": self._info.text(), "ROS_DISTRO": "jazzy"}
            )
            self._mcap.finish()
            self.counts.bytes = self._bytes_before + self._file.tell()
        finally:
            self._file.close()


def free_bytes(directory: Path) -> int:
    """Bytes free for this user on the disk of a directory."""
    disk = os.statvfs(directory)
    return disk.f_bavail * disk.f_frsize


def bag_files(directory: Path) -> list[Path]:
    """The MCAP files of a bag in order; a single file is a bag of one.

    Raises:
        ValueError: There is none.
    """
    if directory.is_file():
        return [directory]
    files = sorted(directory.glob("*.mcap"), key=lambda path: (len(path.name), path.name))
    if not files:
        what = "holds no .mcap file" if directory.is_dir() else "is not there"
        raise ValueError(f"{directory} {what} (expected a bag: a directory with {FILE_NAME})")
    return files
