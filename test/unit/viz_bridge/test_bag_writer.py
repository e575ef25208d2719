"""Bags are what independent readers expect, and end cleanly whatever happens."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from std_msgs.msg import Bool, String

from support.bags import ROOMY, put, session_bag
from viz_bridge import bag_writer
from viz_bridge.bag_reader import read_bag, topic_counts
from viz_bridge.bag_recovery import check, recover
from viz_bridge.bag_writer import BagOptions, BagWriter, Compression
from viz_bridge.message_text import message_text
from viz_bridge.viewer_process import viewer_binary


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_rosbags_reads_every_message(tmp_path: Path, compression: Compression) -> None:
    bag = session_bag(tmp_path / "bag", options=BagOptions(compression, min_free_gb=0.0))
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(bag) as reader:
        for connection in reader.connections:
            if connection.msgtype.startswith("tissue_interfaces"):
                text = message_text(connection.msgtype)
                store.register(get_types_from_msg(text, connection.msgtype))
        frames = []
        for connection, _, raw in reader.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            if connection.topic == "/tissue/state":
                frames.append(message.frame)
    assert frames == list(range(1, 41))


def test_mcap_ros2_support_reads_the_same_positions(tmp_path: Path) -> None:
    bag = session_bag(tmp_path / "bag", frames=6, cut_at=3)
    ours = [item.message.positions for item in read_bag(bag, ["/tissue/state"])]
    theirs = [
        np.array(item.ros_msg.positions, dtype=np.float32)
        for item in read_ros2_messages(str(bag / "bag_0.mcap"), topics=["/tissue/state"])
    ]
    assert len(ours) == len(theirs) == 6
    assert all(map(np.array_equal, ours, theirs))


def test_rerun_accepts_the_file(tmp_path: Path) -> None:
    bag = session_bag(tmp_path / "bag", frames=6, cut_at=3)
    command = [str(viewer_binary()), "mcap", "check", str(bag / "bag_0.mcap")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines() if "/tissue/" in line]
    assert {row[3] for row in rows} >= {"/tissue/state", "/tissue/journal", "/tissue/edits"}
    assert {row[0] for row in rows} == {"ok"}


def test_metadata_says_what_the_files_hold(tmp_path: Path) -> None:
    bag = session_bag(tmp_path / "bag")
    told = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    counts = {
        entry["topic_metadata"]["name"]: entry["message_count"]
        for entry in told["topics_with_message_count"]
    }
    assert told["version"] == 9
    assert counts == topic_counts(bag)
    assert told["message_count"] == sum(counts.values())
    with (bag / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        channels = {channel.topic: channel for channel in summary.channels.values()}
        records = {record.name: record.metadata for record in reader.iter_metadata()}
    assert channels["/tissue/state"].metadata["topic_type_hash"].startswith("RIHS01_")
    inside = yaml.safe_load(records["rosbag2"]["serialized_metadata"])
    assert inside["message_count"] == told["message_count"]


def test_a_split_bag_is_one_bag(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", ROOMY)
    for number in range(6):
        put(writer, "/words", String(data=str(number)), 10 + number)
        if number % 2:
            writer.split()
    writer.close()
    assert len(list((tmp_path / "bag").glob("*.mcap"))) == 4
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 6
    words = [item.message.data for item in read_bag(tmp_path / "bag")]
    assert words == [str(number) for number in range(6)]


def test_what_does_not_fit_into_the_queue_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stuck = threading.Event()
    slow = bag_writer.BagWriter._take

    def take(self: BagWriter, item: bag_writer._Item) -> None:
        stuck.wait(20)
        slow(self, item)

    monkeypatch.setattr(bag_writer.BagWriter, "_take", take)
    writer = BagWriter(tmp_path / "bag", BagOptions(queue_bytes=1000, min_free_gb=0.0))
    kept = [put(writer, "/words", String(data="x" * 100), 1 + k) for k in range(50)]
    stuck.set()
    info = writer.close()
    assert not all(kept)
    assert info.messages == sum(kept)
    assert writer.counts.dropped["/words"] == kept.count(False)


def test_an_unknown_type_costs_only_its_own_topic(tmp_path: Path) -> None:
    said: list[str] = []
    writer = BagWriter(tmp_path / "bag", ROOMY, lambda _level, text: said.append(text))
    writer.write("/strange", "nobody/msg/Knows", b"\0\1\0\0", 1)
    put(writer, "/good", Bool(data=True), 2)
    assert writer.close().messages == 1
    assert any("/strange" in text for text in said)
    assert writer.counts.dropped["/strange"] == 1


def test_an_existing_bag_is_not_overwritten(tmp_path: Path) -> None:
    bag = session_bag(tmp_path / "bag", frames=2, cut_at=0)
    with pytest.raises(ValueError, match="not empty"):
        BagWriter(bag, ROOMY)


def test_too_little_space_is_refused_at_start(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="min_free_gb"):
        BagWriter(tmp_path / "bag", BagOptions(min_free_gb=1e9))


def test_the_bag_ends_cleanly_at_min_free_gb(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    writer = BagWriter(
        tmp_path / "bag", BagOptions(flush_seconds=0.01), lambda _level, text: said.append(text)
    )
    put(writer, "/words", String(data="last"), 1)
    monkeypatch.setattr(bag_writer, "free_bytes", lambda _directory: 0.5e9)
    writer._thread.join(10)
    assert "min_free_gb" in writer.ended
    assert not put(writer, "/words", String(data="too late"), 2)
    writer.close()
    assert any("has ended" in text for text in said)
    assert [item.message.data for item in read_bag(tmp_path / "bag")] == ["last"]


@contextlib.contextmanager
def small_disk(folder: Path, megabytes: int) -> Iterator[Path]:
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(folder)]
    if os.getuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root can make a small disk")
    if subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("no small disk can be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_ends_the_bag_with_its_index(tmp_path: Path) -> None:
    said: list[str] = []
    with small_disk(tmp_path / "disk", 6) as disk:
        options = BagOptions("none", flush_seconds=1e9, min_free_gb=0.0)
        writer = BagWriter(disk / "bag", options, lambda _level, text: said.append(text))
        accepted = sum(put(writer, "/words", String(data="x" * 100_000), 1 + k) for k in range(100))
        writer.close()
        assert "the disk is full" in writer.ended
        assert any("has ended" in text for text in said)
        written = topic_counts(disk / "bag")["/words"]
        assert written >= 40
        assert check(disk / "bag").problems == []
        assert writer.counts.dropped["/words"] == 100 - accepted + accepted - written
        assert not list((disk / "bag").glob("*.reserve"))


def test_a_disk_without_any_room_leaves_a_recoverable_bag(tmp_path: Path) -> None:
    program = f"""
import resource, sys
from std_msgs.msg import String
from support.bags import put
from viz_bridge.bag_writer import BagOptions, BagWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, 2_000_000))
options = BagOptions("none", min_free_gb=0.0)
writer = BagWriter({str(tmp_path / "bag")!r}, options, lambda level, text: print(text))
for number in range(100):
    put(writer, "/words", String(data="x" * 100_000), 1 + number)
writer.close()
"""
    environment = dict(os.environ)
    tests = Path(__file__).resolve().parents[2]
    environment["PYTHONPATH"] = f"{tests}{os.pathsep}{environment.get('PYTHONPATH', '')}"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "has ended" in done.stdout
    saved = recover(tmp_path / "bag", tmp_path / "whole")
    assert saved.messages >= 15
    assert check(tmp_path / "whole").problems == []
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 2_000_000
