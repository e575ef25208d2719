"""Node `bag` records a session that independent readers accept, whatever happens to it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from mcap_ros2.reader import read_ros2_messages
from rclpy.node import Node
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from std_srvs.srv import Trigger

from support.bags import interrupt, start_fake, start_module, wait_for
from viz_bridge.bag_reader import BagMessage, read_bag, topic_counts
from viz_bridge.bag_recovery import check, recover
from viz_bridge.message_text import message_text
from viz_bridge.summary import summarise

EVERYTHING = {
    "/tissue/journal",
    "/tissue/state",
    "/tissue/topology",
    "/tissue/edits",
    "/tissue/status",
    "/tissue/tools",
    "/tools/hook/servo_cp",
    "/tools/hook/use",
    "/tools/hook/measured_cp",
    "/tools/hook/measured_cf",
    "/diagnostics",
}
pytestmark = pytest.mark.usefixtures("ros_domain")


@pytest.fixture
def running() -> Iterator[list[subprocess.Popen[bytes]]]:
    processes: list[subprocess.Popen[bytes]] = []
    yield processes
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.wait(10)


@pytest.fixture
def caller() -> Iterator[Node]:
    rclpy.init()
    node = rclpy.create_node("caller")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def call(node: Node, service: str) -> Trigger.Response:
    client = node.create_client(Trigger, service)
    assert client.wait_for_service(15)
    future = client.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, future, timeout_sec=15)
    answer = future.result()
    assert answer is not None
    node.destroy_client(client)
    return answer


def recorder(bag: Path, *parameters: str) -> subprocess.Popen[bytes]:
    given = [f"bag:={bag}", "min_free_gb:=0.0", *parameters]
    arguments = [word for parameter in given for word in ("-p", parameter)]
    log = bag.with_name(bag.name + ".log")
    process = start_module("viz_bridge.bag_node", "--ros-args", *arguments, log=log)
    wait_for(lambda: "recording to" in log.read_text(errors="replace"), 30, "recording")
    return process


def span(items: Iterable[BagMessage]) -> float:
    """Seconds from the first message to the last."""
    return float(np.ptp([item.log_time for item in items])) / 1e9


def size_of(bag: Path) -> int:
    return sum(path.stat().st_size for path in bag.glob("*.mcap"))


def test_a_session_is_recorded_and_read_by_others(
    tmp_path: Path, running: list[subprocess.Popen[bytes]]
) -> None:
    bag = tmp_path / "session"
    scene = tmp_path / "scene.yaml"
    scene.write_text("geometry: block\n")
    node = recorder(bag, "record_state_hz:=10.0", "notes:=[scene=block]", f"attachments:=[{scene}]")
    monitor_file = tmp_path / "monitor.json"
    monitor = start_module(
        "viz_bridge.monitor", "--ros-args", "-p", f"path:={monitor_file}", log=tmp_path / "m.log"
    )
    running += [node, monitor]
    wait_for(monitor_file.exists, 30, "the monitor's first file")
    assert start_fake("--frames", "420", "--monitors", "1").wait(60) == 0
    assert interrupt(node) == 0
    assert interrupt(monitor) == 0

    counts = topic_counts(bag)
    assert set(counts) == EVERYTHING
    assert counts["/tissue/journal"] == 420
    # 10 a second of 60, and the first of each version; what a machine stands still does not count.
    journal = list(read_bag(bag, ["/tissue/journal"]))
    stamps = [item.message.header.stamp for item in journal]
    gaps = np.diff([stamp.sec + 1e-9 * stamp.nanosec for stamp in stamps])
    assert counts["/tissue/state"] == pytest.approx(10 * np.minimum(gaps, 0.2).sum(), abs=4)
    assert counts["/tissue/edits"] == counts["/tissue/topology"] == 1
    assert check(bag).problems == []
    _read_with_rosbags(bag, counts)
    names = {item.channel.topic for item in read_ros2_messages(str(bag / "session_0.mcap"))}
    assert names == EVERYTHING
    log = (tmp_path / "session.log").read_text()
    assert "MB per minute" in log
    assert "hours" in log
    text = (bag / "metadata.yaml").read_text()
    assert "seed: '7'" in text
    assert "scene: block" in text
    assert "reliability: reliable" in text

    told = summarise(bag, monitor_file)
    assert told["frames"] == 420
    assert told["published_hz"] == pytest.approx(419 / span(journal), rel=0.02)
    assert told["cuts"][0]["opening_mm"] > 3
    assert told["grabs"][0]["moved_mm"] > 10
    assert told["pose_to_state_ms"]["poses"] > 400
    assert 0 < told["cpu_share"]["bag_node"] < 2
    assert len(told["load_average_before"]) == 3
    assert told["lost_states"] == 0
    json.dumps(told)


def _read_with_rosbags(bag: Path, counts: dict[str, int]) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    seen: dict[str, int] = {}
    with Reader(bag) as reader:
        for connection in reader.connections:
            if connection.msgtype.startswith("tissue_interfaces"):
                text = message_text(connection.msgtype)
                store.register(get_types_from_msg(text, connection.msgtype))
        for connection, _, raw in reader.messages():
            store.deserialize_cdr(raw, connection.msgtype)
            seen[connection.topic] = seen.get(connection.topic, 0) + 1
    assert seen == counts


def test_a_killed_recorder_loses_at_most_half_a_second(
    tmp_path: Path, running: list[subprocess.Popen[bytes]]
) -> None:
    bag = tmp_path / "session"
    node = recorder(bag, "record_state_hz:=60.0")
    fake = start_fake("--frames", "1200")
    running += [node, fake]
    wait_for(lambda: size_of(bag) > 400_000, 40, "half a second of recording")
    killed = time.time_ns()
    node.send_signal(signal.SIGKILL)
    node.wait(10)
    saved = recover(bag, tmp_path / "whole")
    assert saved.messages > 0
    assert check(tmp_path / "whole").problems == []
    frames = list(read_bag(tmp_path / "whole", ["/tissue/journal"]))
    assert (killed - frames[-1].log_time) / 1e9 < 0.5
    numbers = [item.message.frame for item in frames]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_services_stop_start_pause_and_split(
    tmp_path: Path, running: list[subprocess.Popen[bytes]], caller: Node
) -> None:
    bag = tmp_path / "session"
    node = recorder(bag, "record_state_hz:=60.0")
    fake = start_fake("--frames", "3000")
    running += [node, fake]
    wait_for(lambda: size_of(bag) > 150_000, 40, "some recording")
    assert not call(caller, "bag/start").success
    assert call(caller, "bag/split").success
    wait_for(lambda: len(list(bag.glob("*.mcap"))) == 2, 20, "the second file")
    assert call(caller, "bag/pause").success
    assert call(caller, "bag/pause").success
    assert "messages" in call(caller, "bag/stop").message
    assert not call(caller, "bag/stop").success
    assert call(caller, "bag/start").success
    second = tmp_path / "session_2"
    wait_for(lambda: size_of(second) > 100_000, 20, "the second bag")
    assert interrupt(node) == 0
    journal = [item.message.frame for item in read_bag(bag, ["/tissue/journal"])]
    assert len(journal) > 10
    assert [p for p in check(bag).problems if "is followed by" not in p] == []
    # What is latched comes again: the second bag can be understood alone.
    counts = topic_counts(second)
    assert counts["/tissue/topology"] == counts["/tissue/tools"] == counts["/tissue/status"] == 1


def test_a_full_disk_ends_the_recording_and_not_the_node(
    tmp_path: Path, running: list[subprocess.Popen[bytes]], caller: Node
) -> None:
    if os.getuid() != 0:
        pytest.skip("only root can make a small disk")
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("no small disk can be mounted here")
    try:
        bag = disk / "session"
        log = tmp_path / "bag.log"
        parameters = (f"bag:={bag}", "min_free_gb:=0.0", "record_state_hz:=60.0")
        arguments = [word for given in parameters for word in ("-p", given)]
        node = start_module("viz_bridge.bag_node", "--ros-args", *arguments, log=log)
        report = tmp_path / "fake.json"
        fake = start_fake("--frames", "400", "--side", "17", "--report", str(report))
        running += [node, fake]
        wait_for(lambda: "the disk is full" in log.read_text(), 60, "the full disk")
        assert node.poll() is None
        assert call(caller, "bag/stop").success
        assert check(bag).problems == []
        assert topic_counts(bag)["/tissue/state"] > 10
        assert interrupt(node) == 0
        fake.kill()
        fake.wait(10)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.parametrize(
    ("parameter", "named"),
    [
        ("record_state_hz:=-1.0", "record_state_hz"),
        ("compression:=gzip", "compression"),
        ("record_sate_hz:=10.0", "did you mean record_state_hz"),
        ("notes:=[nothing]", "key=value"),
        ("attachments:=[/no/such/file]", "/no/such/file"),
    ],
)
def test_bad_parameters_are_refused_by_name(tmp_path: Path, parameter: str, named: str) -> None:
    log = tmp_path / "log"
    arguments = ("--ros-args", "-p", f"bag:={tmp_path / 'bag'}", "-p", parameter)
    process = start_module("viz_bridge.bag_node", *arguments, log=log)
    assert process.wait(30) == 2
    assert named in log.read_text()


def test_a_bag_is_played_as_it_was_recorded(
    tmp_path: Path, running: list[subprocess.Popen[bytes]]
) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    node = recorder(first, "record_state_hz:=60.0")
    running.append(node)
    assert start_fake("--frames", "60").wait(60) == 0
    assert interrupt(node) == 0
    node = recorder(second, "record_state_hz:=60.0")
    player = start_module("viz_bridge.bag_cli", "play", str(first), log=tmp_path / "play.log")
    running += [node, player]
    assert player.wait(60) == 0
    assert interrupt(node) == 0
    topic = ["/tissue/journal"]
    recorded = list(read_bag(first, topic))
    played = list(read_bag(second, topic))
    assert [item.data for item in recorded] == [item.data for item in played]
    assert span(played) == pytest.approx(span(recorded), abs=0.5)
