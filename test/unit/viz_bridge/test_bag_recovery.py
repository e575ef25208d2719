"""Torn bags are told from whole ones, and mended."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import pytest
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from typer.testing import CliRunner

from support.bags import session_bag
from viz_bridge.bag_cli import app
from viz_bridge.bag_player import PlayOptions, check_options, schedule
from viz_bridge.bag_reader import BagError, only_namespace, read_bag, summaries, topic_counts
from viz_bridge.bag_recovery import check, recover
from viz_bridge.bag_writer import BagOptions

SMALL_CHUNKS = BagOptions("lz4", chunk_bytes=4096, min_free_gb=0.0)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return session_bag(tmp_path / "bag", options=SMALL_CHUNKS)


def torn(bag: Path, share: float) -> Path:
    data = (bag / "bag_0.mcap").read_bytes()
    target = bag.parent / "torn.mcap"
    target.write_bytes(data[: int(share * len(data))])
    return target


def messages_of_whole_chunks(bag: Path, share: float) -> int:
    """How many messages lie in chunks that end before a tear, by the index of the whole bag."""
    path = bag / "bag_0.mcap"
    data = path.read_bytes()
    (summary,) = summaries(path).values()
    count = 0
    for index in summary.chunk_indexes:
        end = index.chunk_start_offset + index.chunk_length
        if end <= int(share * len(data)):
            stream = BytesIO(data[index.chunk_start_offset : end])
            chunk = next(StreamReader(stream, skip_magic=True, emit_chunks=True).records)
            assert isinstance(chunk, Chunk)
            count += sum(isinstance(record, Message) for record in breakup_chunk(chunk))
    return count


def test_a_whole_bag_has_no_problems(bag: Path) -> None:
    findings = check(bag)
    assert findings.problems == []
    assert findings.messages == sum(topic_counts(bag).values())


@pytest.mark.parametrize("share", [0.3, 0.7, 0.99])
def test_a_torn_bag_is_refused_and_recovered_to_a_prefix(bag: Path, share: float) -> None:
    piece = torn(bag, share)
    with pytest.raises(BagError, match="tissue bag recover"):
        next(read_bag(piece))
    saved = recover(piece, bag.parent / "whole")
    assert saved.torn
    recovered = [(i.topic, i.log_time, i.data) for i in read_bag(bag.parent / "whole")]
    original = [(i.topic, i.log_time, i.data) for i in read_bag(bag)]
    assert recovered == original[: len(recovered)]
    assert len(recovered) == messages_of_whole_chunks(bag, share) > 0
    assert check(bag.parent / "whole").problems == []


@pytest.mark.parametrize(("data", "says"), [(b"", "is empty"), (b"times: [1]\n", "does not begin")])
def test_what_is_no_mcap_file_is_not_called_torn(tmp_path: Path, data: bytes, says: str) -> None:
    path = tmp_path / "notes.mcap"
    path.write_bytes(data)
    with pytest.raises(BagError, match=rf"notes\.mcap is no MCAP file: it {says}"):
        topic_counts(path)


def test_flipped_bits_are_found(bag: Path) -> None:
    path = bag / "bag_0.mcap"
    data = bytearray(path.read_bytes())
    for place in range(len(data) // 2, len(data) // 2 + 64):
        data[place] ^= 0xFF
    path.write_bytes(data)
    assert check(bag).problems


def test_a_gap_in_the_journal_is_found(tmp_path: Path) -> None:
    session_bag(tmp_path / "bag", frames=5, cut_at=0)
    from viz_bridge.bag_writer import BagWriter

    writer = BagWriter(tmp_path / "gap", BagOptions(min_free_gb=0.0))
    for item in read_bag(tmp_path / "bag", ["/tissue/journal"]):
        if item.message.frame != 3:
            writer.write(item.topic, item.type_name, item.data, item.log_time)
    writer.close()
    assert check(tmp_path / "gap").problems == ["/tissue/journal: frame 2 is followed by frame 4"]


def test_missing_metadata_is_a_problem(bag: Path) -> None:
    (bag / "metadata.yaml").unlink()
    assert any("metadata.yaml" in problem for problem in check(bag).problems)


def test_a_namespace_is_found_or_asked_for(tmp_path: Path) -> None:
    bag = session_bag(tmp_path / "left", frames=2, cut_at=0, namespace="/left")
    assert only_namespace(bag, None) == "/left"
    with pytest.raises(BagError, match="right"):
        only_namespace(bag, "right")


def test_playing_twice_as_fast_halves_the_times(bag: Path) -> None:
    normal = [due for due, _ in schedule(bag, PlayOptions(topics=("/tissue/state",)))]
    fast = [due for due, _ in schedule(bag, PlayOptions(rate=2, topics=("/tissue/state",)))]
    assert fast == pytest.approx([due / 2 for due in normal])
    later = list(schedule(bag, PlayOptions(topics=("/tissue/state",), start_offset=0.5)))
    assert 0 < len(later) < len(normal)


@pytest.mark.parametrize(
    "options", [PlayOptions(rate=0), PlayOptions(start_offset=-1), PlayOptions(topics=("/no",))]
)
def test_bad_options_of_play_are_refused(bag: Path, options: PlayOptions) -> None:
    with pytest.raises(ValueError, match=r"not allowed|has no"):
        check_options(bag, options)


def test_the_command_line_tells_recovers_and_converts(bag: Path) -> None:
    runner = CliRunner()
    told = runner.invoke(app, ["info", str(bag)])
    assert told.exit_code == 0
    assert "tissue_interfaces/msg/Journal" in told.output
    assert runner.invoke(app, ["check", str(bag)]).exit_code == 0
    piece = torn(bag, 0.5)
    assert runner.invoke(app, ["check", str(piece)]).exit_code == 1
    assert runner.invoke(app, ["recover", str(piece)]).exit_code == 0
    assert check(bag.parent / "torn_recovered").problems == []
    assert runner.invoke(app, ["to-rrd", str(bag)]).exit_code == 0
    assert (bag.parent / "bag.rrd").stat().st_size > 10_000
