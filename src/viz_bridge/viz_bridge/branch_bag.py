"""The bag of a branch: what was played of a recording, then what people made of it.

A session in which a recording was watched and taken over is recorded like any other. From it and
from the bag that was played a third one is made: the recorded frames up to the branch, then the
live ones, as one epoch whose journal reproduces the branch from its start.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from tissue_sim.playback.recording import Recording
from tissue_sim.session_bag import read_epochs
from viz_bridge.bag_reader import BagMessage, attachments, only_namespace, read_bag, summaries
from viz_bridge.bag_recovery import origin_of
from viz_bridge.bag_writer import BagOptions, BagWriter, Origin
from viz_bridge.provenance import provenance
from viz_bridge.recorded_topics import FIXED

PLAYBACK = "tissue/playback"
METADATA = "tissue_sim/branch"
PERIOD = 16_666_667
"""From the last recorded message to the first live one [ns]."""

_OF_ORGAN = ("tissue/", "tools/", "script/", "/diagnostics", "diagnostics")
_VERSIONED = ("tissue/edits", "tissue/topology")
_NUMBERED = (*_VERSIONED, "tissue/journal", "tissue/state", "tissue/cut_request")
_LATCHED = tuple(topic.name for topic in FIXED if topic.latched and topic.name not in _NUMBERED)


@dataclass(frozen=True)
class BranchPoint:
    """Where a branch began.

    Attributes:
        branch: Its epoch, and its id.
        frame: Last frame of the recorded epoch before it.
        time: Time of the recording at about which it was told [s].
        version: Version of the mesh after that frame.
    """

    branch: bytes
    frame: int
    time: float
    version: int = 1


def branch_point(watched: Path) -> BranchPoint | None:
    """Where people took over in a recorded session; None: nowhere.

    Args:
        watched: Bag of the session in which a recording was watched.

    Raises:
        ValueError: The bag cannot be read.
    """
    topic = f"{only_namespace(watched, None)}/{PLAYBACK}"
    for item in read_bag(watched, (topic,)):
        message = item.message
        if message.branch:
            branch = bytes.fromhex(message.branch)
            return BranchPoint(branch, int(message.branch_frame), float(message.time))
    return None


def write_branch(
    parent: Path,
    watched: Path,
    target: Path,
    namespace: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> BranchPoint | None:
    """Write the bag of a branch.

    Args:
        parent: The bag that was played.
        watched: The bag of the session in which it was, and was taken over.
        target: Directory of the new bag; must not exist, or be empty.
        namespace: Namespace of the organ in the parent; None if there is only one.
        progress: Called with the number of messages written so far.

    Returns:
        Where it began; None: nobody took over, and nothing is written.

    Raises:
        ValueError: A bag cannot be read, or the target is not empty.
        OSError: The target cannot be written.
    """
    point = branch_point(watched)
    if point is None:
        return None
    prefix = only_namespace(parent, namespace) + "/"
    recording = Recording(parent.name, read_epochs(parent, namespace))
    # Told a moment later; by then the recording has not left the epoch.
    shown = max(1, min(round(point.time * recording.rate_hz), recording.frames))
    epoch = recording.epoch_at(shown)
    if point.frame:
        point = replace(point, version=epoch.entries[point.frame - 1].version)
    live_prefix = only_namespace(watched, None) + "/"
    begins, _ = _span(watched, live_prefix, point.branch, range(point.frame + 1, 1 << 62))
    head = _head(parent, prefix, live_prefix, epoch.epoch, point, begins)
    tail = _tail(watched, live_prefix, point, begins)
    writer = BagWriter(target, BagOptions(min_free_gb=0.0))
    written = 0
    try:
        writer.describe("tissue_sim", provenance())
        writer.describe(
            METADATA,
            {
                "parent_bag": str(parent.resolve()),
                "parent_epoch": epoch.epoch.hex(),
                "branch": point.branch.hex(),
                "branch_frame": str(point.frame),
            },
        )
        for name, content in attachments(watched).items():
            writer.attach(name, "application/octet-stream", content)
        for bag, messages in ((parent, head), (watched, tail)):
            origins = {
                topic.replace(prefix, live_prefix, 1) if bag is parent else topic: origin
                for topic, origin in _origins(bag).items()
            }
            for item in messages:
                writer.write(
                    item.topic, item.type_name, item.data, item.log_time, item.publish_time,
                    origins[item.topic], wait=True,
                )  # fmt: skip
                written += 1
                if progress is not None:
                    progress(written)
            if bag is parent:
                # In a file of their own, the live messages keep their own definitions.
                writer.split()
    finally:
        writer.close(timeout=600.0)
    if writer.ended:
        raise OSError(f"{target}: {writer.ended}")
    return point


def _span(bag: Path, prefix: str, epoch: bytes, frames: range) -> tuple[int, int]:
    """When the first and the last of some frames of an epoch were received [ns since 1970].

    Without any of them it is when the epoch was heard of last.
    """
    times, heard = [], 0
    for item in read_bag(bag, (f"{prefix}tissue/journal", f"{prefix}tissue/topology")):
        if epoch in item.data:
            heard = item.log_time
            if item.topic.endswith("journal") and item.message.frame in frames:
                times.append(item.log_time)
    return (min(times), max(times)) if times else (heard, heard)


def _head(
    parent: Path, prefix: str, live_prefix: str, epoch: bytes, point: BranchPoint, begins: int
) -> Iterator[BagMessage]:
    """The messages of an epoch up to the branch, as those of the branch, ending as it begins.

    What was latched before the epoch belongs to it too.
    """
    start, _ = _span(parent, prefix, epoch, range(1, 2))
    _, end = _span(parent, prefix, epoch, range(1, point.frame + 1))
    last = point.frame, point.version
    latched: dict[str, BagMessage] = {}
    for item in read_bag(parent):
        name = item.topic.removeprefix(prefix)
        if not name.startswith(_OF_ORGAN):
            continue
        if name in _NUMBERED:
            wanted = epoch in item.data and _number(name, item) <= last[name in _VERSIONED]
        else:
            wanted = start <= item.log_time <= end and name != PLAYBACK
            if name in _LATCHED and item.log_time < start:
                latched[name] = replace(item, log_time=start, publish_time=start)
        for message in (*(latched.values() if wanted else ()), *([item] if wanted else ())):
            later = begins - PERIOD - end
            yield replace(
                message,
                topic=message.topic.replace(prefix, live_prefix, 1),
                # 128 random bits stand for nothing else in a message.
                data=message.data.replace(epoch, point.branch),
                log_time=message.log_time + later,
                publish_time=message.publish_time + later,
            )
        if wanted:
            latched.clear()


def _tail(watched: Path, prefix: str, point: BranchPoint, begins: int) -> Iterator[BagMessage]:
    """What was recorded of a watched session after the branch, which is an epoch of its own."""
    for item in read_bag(watched):
        of_branch = item.topic.removeprefix(prefix) in _NUMBERED and point.branch in item.data
        if of_branch or item.log_time >= begins:
            yield item


def _number(name: str, item: BagMessage) -> int:
    """Version or frame that a message belongs to."""
    message = item.message
    return int(message.version if name in _VERSIONED else message.frame)


def _origins(bag: Path) -> dict[str, Origin]:
    return {
        channel.topic: origin_of(channel, summary.schemas[channel.schema_id])
        for summary in summaries(bag).values()
        for channel in summary.channels.values()
        if channel.schema_id in summary.schemas
    }
