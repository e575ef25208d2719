"""The bag of a branch is a whole session: the recording up to the branch, then what was live."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from std_msgs.msg import String
from tissue_interfaces.msg import Playback, TissueState

from support.bags import ROOMY, put
from support.recorded_pull import START, pull_bag
from support.small_block import pose_of
from tissue_sim import conversions, edit_messages, journal_messages
from tissue_sim.frame import Answer, Frame
from tissue_sim.interaction.tracker import ToolLimits
from tissue_sim.journal import replay
from tissue_sim.playback.changes import SEEK, SET_PLAYBACK, TAKE_OVER, change
from tissue_sim.playback.checkpoints import Checkpoints
from tissue_sim.playback.clock import PlaybackClock
from tissue_sim.playback.played import PlayedSimulation
from tissue_sim.playback.player import Player
from tissue_sim.playback.recorded_states import RecordedStates
from tissue_sim.playback.recording import read_recording
from tissue_sim.requests import Request
from tissue_sim.session_bag import read_epochs
from viz_bridge.bag_reader import metadata_of, read_bag
from viz_bridge.bag_recovery import check
from viz_bridge.bag_writer import BagWriter
from viz_bridge.branch_bag import branch_point, write_branch

FRAMES, CUT = 40, 12
SECOND = 1_000_000_000
LATER = START + 3600 * SECOND


class WatchedBag:
    """A session in which a recording is watched, written message by message."""

    def __init__(self, parent: Path, folder: Path, namespace: str | None = None) -> None:
        self.path = folder / "watched"
        self.writer = BagWriter(self.path, ROOMY)
        self.at = LATER
        player = Player(read_recording(parent, namespace), Checkpoints(0))
        self.live = PlayedSimulation(player, PlaybackClock(), ToolLimits(), folder)
        self._switched = -1
        self.positions: NDArray[np.floating] = np.empty((0, 3))

    def frames(self, count: int) -> None:
        for number in range(count):
            self.at += SECOND // 60
            assert self.live.due(np.inf)
            frame, answer = self.live.next_frame(number / 60)
            self._put(frame)
            answer()
            self.positions = frame.positions.copy()

    def tell(self) -> None:
        state = self.live.state
        told = Playback(time=state.time, branch=state.branch, branch_frame=state.branch_frame)
        put(self.writer, "/tissue/playback", told, self.at)

    def _put(self, frame: Frame) -> None:
        entry, epoch = frame.journal, frame.journal.epoch
        stamp = conversions.stamp_of(self.at)
        if self.live.switched != self._switched:
            self._switched = self.live.switched
            mesh = self.live.simulation.mesh
            keyframe = conversions.mesh_to_topology(mesh, epoch, "organ", stamp)
            put(self.writer, "/tissue/topology", keyframe, self.at)
        edits = [
            edit_messages.edit_to_msg(applied.change.edit, epoch, "organ", stamp)
            for applied in frame.edits
        ]
        for edit in edits:
            put(self.writer, "/tissue/edits", edit, self.at)
        state = TissueState(header=conversions.header("organ", stamp), frame=entry.frame)
        state.epoch, state.version = conversions.epoch_field(epoch), entry.version
        conversions.fill_state(state, frame.positions)
        put(self.writer, "/tissue/state", state, self.at)
        message = journal_messages.entry_to_msg(entry, edits, "organ", stamp)
        put(self.writer, "/tissue/journal", message, self.at)


def test_recorded_states_are_shown_until_somebody_takes_over(tmp_path: Path) -> None:
    """Shown: the bag's shapes, at any time. Taken over: the very state that was recorded."""
    bag, seen = pull_bag(tmp_path / "bag", frames=FRAMES, state_every=5, cut_at=CUT)
    recording = read_recording(bag)
    player = Player(recording, Checkpoints(1 << 30), RecordedStates(bag, None, recording))
    live = PlayedSimulation(player, PlaybackClock(), ToolLimits(), tmp_path)

    def tick() -> tuple[int, np.ndarray]:
        while not live.due(np.inf):
            pass
        frame, answer = live.next_frame(0.0)
        answer()
        return frame.journal.frame, frame.positions.copy()

    def check_shown(number: int, shape: np.ndarray) -> None:
        rows = len(shape)
        kept = number // 5 * 5
        if kept == number:
            assert np.array_equal(shape, seen.positions[number - 1])
        elif kept > CUT:
            assert np.allclose(shape[:rows], seen.positions[kept - 1], atol=2e-3)

    for wanted in range(1, 24):
        number, shape = tick()
        assert number == wanted
        check_shown(number, shape)
    for back in (10, 15, 35):
        change(live, SEEK, back / 60)
        number, shape = tick()
        assert number == back
        check_shown(number, shape)
    assert live.simulation.mesh.version == 2
    answers: list[Answer] = []
    arguments = {"what": TAKE_OVER, "value": 0.0, "tools": ()}
    live.post(Request(SET_PLAYBACK, arguments, "r", answers.append))
    while not live.branch:
        number, shape = tick()
    assert answers[0].success
    while number < FRAMES:
        number, shape = tick()
        assert np.array_equal(shape, seen.positions[number - 1])
    assert live.player.differing == 0


def numbers(bag: Path, topic: str) -> list[int]:
    return [int(item.message.frame) for item in read_bag(bag, (topic,))]


@pytest.mark.parametrize(("namespace", "frame"), [("", CUT + 8), ("", CUT - 5), ("/left", CUT + 8)])
def test_a_branch_is_a_whole_session(tmp_path: Path, namespace: str, frame: int) -> None:
    """Its journal has every frame once and replays bit for bit; its states and times go on."""
    parent, _ = pull_bag(
        tmp_path / "parent", frames=FRAMES, state_every=2, cut_at=CUT, namespace=namespace
    )
    watched = WatchedBag(parent, tmp_path)
    watched.tell()
    watched.frames(frame + 6)
    change(watched.live, SEEK, frame / 60)
    watched.frames(1)
    change(watched.live, TAKE_OVER)
    watched.frames(2)
    watched.tell()
    watched.live.post_pose("grasper", pose_of((0.06, 0.05, 0.06)), 1, 0.0)
    watched.frames(15)
    put(watched.writer, "/script/event", String(data="late"), watched.at)
    watched.writer.close()

    target = tmp_path / "branch"
    point = write_branch(parent, watched.path, target)
    assert point is not None
    assert (point.frame, point.branch) == (frame, watched.live.simulation.epoch)
    told = metadata_of(target)
    assert (told["branch"], told["branch_frame"]) == (point.branch.hex(), str(frame))
    assert told["parent_bag"] == str(parent)

    (branch,) = read_epochs(target)
    assert [entry.frame for entry in branch.entries] == list(range(1, frame + 18))
    again = replay(branch.entries, branch.start)
    assert again.mismatches == ()
    assert np.array_equal(again.positions, watched.positions)
    assert check(target).problems == []

    states = numbers(target, "/tissue/state")
    assert states == [*range(2, frame + 1, 2), *range(frame + 1, frame + 18)]
    versions = [int(item.message.version) for item in read_bag(target, ("/tissue/edits",))]
    assert versions == [2]
    times = [item.log_time for item in read_bag(target, ("/tissue/journal",))]
    # The recording's head ends where the live part begins.
    assert np.ptp(np.diff(times)) < SECOND / 50
    assert [item.message.data for item in read_bag(target, ("/script/event",))] == ["late"]


def test_without_a_take_over_there_is_no_branch(tmp_path: Path) -> None:
    parent, _ = pull_bag(tmp_path / "parent", frames=10)
    watched = WatchedBag(parent, tmp_path)
    watched.frames(5)
    watched.tell()
    watched.writer.close()
    assert branch_point(watched.path) is None
    assert write_branch(parent, watched.path, tmp_path / "branch") is None
    assert not (tmp_path / "branch").exists()
