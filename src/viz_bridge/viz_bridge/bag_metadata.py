"""metadata.yaml of a bag directory, as rosbag2 of ROS 2 Jazzy writes it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

VERSION = 9
FILE_NAME = "metadata.yaml"


@dataclass
class TopicInfo:
    """One topic of a bag."""

    name: str
    type_name: str
    type_hash: str
    qos: list[dict[str, Any]]
    messages: int = 0


@dataclass
class FileInfo:
    """One file of a bag; times in nanoseconds since 1970."""

    name: str
    start: int = 0
    end: int = 0
    messages: int = 0

    def count(self, log_time: int) -> None:
        """Take one more message into account."""
        self.start = log_time if not self.messages else min(self.start, log_time)
        self.end = max(self.end, log_time)
        self.messages += 1


@dataclass
class BagInfo:
    """What metadata.yaml says about a bag."""

    topics: dict[str, TopicInfo] = field(default_factory=dict)
    files: list[FileInfo] = field(default_factory=list)
    custom: dict[str, str] = field(default_factory=dict)

    @property
    def messages(self) -> int:
        """Messages in all files."""
        return sum(f.messages for f in self.files)

    @property
    def start(self) -> int:
        """Time of the first message [ns since 1970]; 0 for an empty bag."""
        return min((f.start for f in self.files if f.messages), default=0)

    @property
    def seconds(self) -> float:
        """Time from the first to the last message [s]."""
        return (max((f.end for f in self.files), default=0) - self.start) / 1e9

    def document(self) -> dict[str, Any]:
        """The content of `rosbag2_bagfile_information`."""
        end = max((f.end for f in self.files), default=0)
        return {
            "version": VERSION,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": max(0, end - self.start)},
            "starting_time": {"nanoseconds_since_epoch": self.start},
            "message_count": self.messages,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic.name,
                        "type": topic.type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": topic.qos,
                        "type_description_hash": topic.type_hash,
                    },
                    "message_count": topic.messages,
                }
                for topic in self.topics.values()
            ],
            # MCAP compresses its chunks itself: for rosbag2 the files are not compressed.
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [f.name for f in self.files],
            "files": [
                {
                    "path": f.name,
                    "starting_time": {"nanoseconds_since_epoch": f.start},
                    "duration": {"nanoseconds": max(0, f.end - f.start)},
                    "message_count": f.messages,
                }
                for f in self.files
            ],
            "custom_data": dict(self.custom) or None,
            "ros_distro": "jazzy",
        }

    def text(self) -> str:
        """The record `rosbag2/serialized_metadata` of the MCAP file."""
        return yaml.safe_dump(self.document(), sort_keys=False)

    def write(self, directory: Path) -> None:
        """Write metadata.yaml, whole or not at all."""
        text = yaml.safe_dump({"rosbag2_bagfile_information": self.document()}, sort_keys=False)
        partial = directory / (FILE_NAME + ".partial")
        partial.write_text(text, encoding="utf-8")
        partial.replace(directory / FILE_NAME)


def qos_text(profiles: list[dict[str, Any]]) -> str:
    """What a channel carries as `offered_qos_profiles`."""
    return yaml.safe_dump(profiles, sort_keys=False) if profiles else ""
