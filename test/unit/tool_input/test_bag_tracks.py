"""The tool topics of a bag are found, chosen and read in order; what cannot be played is said."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import Writer

from tool_input.bag_tracks import POSE, USE, BagError, BagTracks

TOPICS = {
    "/left/tools/grasper/servo_cp": POSE,
    "/left/tools/grasper/use": USE,
    "/PSM1/measured_cp": POSE,
    "/tissue/status": "tissue_interfaces/msg/Status",
}


def write_bag(path: Path, finished: bool = True) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        channels = []
        for topic, kind in TOPICS.items():
            schema = writer.register_schema(kind, "ros2msg", b"")
            channels.append(writer.register_channel(topic, "cdr", schema))
        for step in range(10):
            for number, channel in enumerate(channels):
                stamp = 1_000_000_000 + step * 8_000_000 + number
                data = f"{number} {step}".encode()
                writer.add_message(channel, stamp, data, stamp)
        if finished:
            writer.finish()


def test_tool_topics_are_found_whatever_their_namespace(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag.mcap")
    tracks = BagTracks(tmp_path / "bag.mcap")
    assert set(tracks.targets.values()) == {"tools/grasper/servo_cp", "tools/grasper/use"}
    messages = list(tracks.messages())
    assert len(messages) == 20
    assert messages[0].time == 0.0
    assert [message.time for message in messages] == sorted(message.time for message in messages)
    assert messages[-1].time == pytest.approx(0.072, abs=1e-6)
    assert {message.data.split()[0] for message in messages} == {b"0", b"1"}


def test_any_pose_is_played_where_it_is_sent(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag.mcap")
    tracks = BagTracks(tmp_path / "bag.mcap", ["/PSM1/measured_cp:=tools/hook/servo_cp"])
    assert tracks.targets == {"/PSM1/measured_cp": "tools/hook/servo_cp"}
    assert [message.data for message in tracks.messages()] == [b"2 %d" % step for step in range(10)]


def test_directory_without_metadata_is_played_too(tmp_path: Path) -> None:
    for name in ("a_0.mcap", "a_1.mcap"):
        write_bag(tmp_path / name)
    assert len(list(BagTracks(tmp_path).messages())) == 40


@pytest.mark.parametrize(
    ("remap", "says"),
    [
        (["/tissue/status:=tools/a/use"], "only geometry_msgs/msg/PoseStamped"),
        (["/none:=tools/a/use"], "no topic /none"),
        (["/PSM1/measured_cp"], "must be written as"),
    ],
)
def test_topic_that_cannot_be_played_is_named(tmp_path: Path, remap: list[str], says: str) -> None:
    write_bag(tmp_path / "bag.mcap")
    with pytest.raises(BagError, match=says):
        BagTracks(tmp_path / "bag.mcap", remap)


def test_bag_that_was_not_ended_is_to_be_recovered(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag.mcap", finished=False)
    with pytest.raises(BagError, match="tissue bag recover"):
        BagTracks(tmp_path / "bag.mcap")


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="no such bag"):
        BagTracks(tmp_path / "none")
    with pytest.raises(BagError, match=r"no \.mcap file"):
        BagTracks(tmp_path)
    (tmp_path / "text.mcap").write_text("not a bag")
    with pytest.raises(BagError, match="damaged"):
        BagTracks(tmp_path / "text.mcap")
