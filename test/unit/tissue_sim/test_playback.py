"""A recording is played, sought in, taken over and replayed, bit for bit."""

from __future__ import annotations

import copy
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.recorded_session import CUT, PRESS, RELEASE, UNDO, as_epoch, recorded_epoch
from support.small_block import CORNER, pose_of, tool_at
from support.split_edit import split_at
from tissue_sim.elastic import registry
from tissue_sim.frame import Answer, Frame, JournalEntry
from tissue_sim.interaction.tracker import ToolLimits
from tissue_sim.journal import JournalError, replay
from tissue_sim.playback.changes import (
    LOOP,
    PAUSE,
    RATE,
    RESUME,
    SEEK,
    SET_PLAYBACK,
    TAKE_OVER,
)
from tissue_sim.playback.checkpoints import Checkpoints
from tissue_sim.playback.clock import PlaybackClock
from tissue_sim.playback.played import PlayedSimulation
from tissue_sim.playback.player import Player
from tissue_sim.playback.recording import Recording
from tissue_sim.requests import PlannedEdit, Request
from tissue_sim.simulation import Simulation

ROOMY = 1 << 30
FRAMES = 40


class EveryFrame(Checkpoints):
    """Keeps the state after every frame."""

    def __init__(self, limit: int = ROOMY) -> None:
        self.now = 0.0
        super().__init__(limit, lambda: self.now)

    def offer(self, frame: int, simulation: Simulation) -> None:
        self.now += 10.0
        super().offer(frame, simulation)


@pytest.fixture(scope="module")
def session() -> Recording:
    return Recording("session", [recorded_epoch(FRAMES)])


class Watched:
    """A played simulation, and the loop around it."""

    def __init__(self, recording: Recording, folder: Path, rate: float = 1.0) -> None:
        player = Player(recording, EveryFrame())
        self.live = PlayedSimulation(
            player, PlaybackClock(rate), ToolLimits(), folder, steps_per_frame=2,
            prepare=lambda simulation: simulation.mesh.version,
        )  # fmt: skip
        self.now = 0.0
        self.frames: list[Frame] = []
        self.positions: list[np.ndarray] = []

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.now += 1 / 60
            if not self.live.due(time.perf_counter() + 10.0):
                continue
            frame, answer = self.live.next_frame(self.now)
            self.frames.append(frame)
            self.positions.append(frame.positions.copy())
            answer()

    @property
    def entries(self) -> list[JournalEntry]:
        return [frame.journal for frame in self.frames]

    @property
    def events(self) -> list[str]:
        return [event for frame in self.frames for event in frame.events]

    def ask(self, kind: str, /, **arguments: Any) -> Answer:
        answers: list[Answer] = []
        self.live.post(Request(kind, arguments, "r", answers.append))
        self.ticks(1)
        return answers[0]

    def change(self, what: str, value: float = 0.0, tools: tuple[str, ...] = ()) -> Answer:
        return self.ask(SET_PLAYBACK, what=what, value=value, tools=tools)

    def branch(self, recording: Recording) -> list[JournalEntry]:
        """The whole journal of the branch: the recording's head, and what was live."""
        branch = self.live.branch
        assert branch is not None
        epoch = bytes.fromhex(branch.id)
        head = as_epoch(recording.entries[: branch.frame], epoch)
        return head + [e for e in self.entries if e.epoch == epoch and e.frame > branch.frame]


@pytest.fixture
def watched(session: Recording, tmp_path: Path) -> Watched:
    return Watched(session, tmp_path)


def crcs(entries: list[JournalEntry]) -> list[int]:
    return [entry.crc32 for entry in entries]


@pytest.mark.parametrize("model", registry.names())
def test_a_frame_sought_is_the_frame_played(model: str) -> None:
    """Forwards and back, from kept states and from the start: with every model."""
    recording = Recording("session", [recorded_epoch(32, model)])
    wanted = crcs(recording.entries)
    for checkpoints in (EveryFrame(), Checkpoints(0)):
        player = Player(recording, checkpoints)
        for target in (UNDO + 1, 2, CUT + 1, CUT, 32, PRESS):
            player.seek(target)
            assert player.approach(np.inf)
            after = [player.play().journal.crc32 for _ in range(min(3, 33 - target))]
            assert after == wanted[target - 1 : target - 1 + len(after)]
    assert player.differing == 0


def test_what_is_shown_after_a_jump_is_an_epoch_of_its_own(watched: Watched) -> None:
    """Followers need never go back: versions and frames grow within an epoch."""
    watched.ticks(20)
    assert watched.change(SEEK, 5 / 60).success
    watched.ticks(3)
    first, second = dict.fromkeys(entry.epoch for entry in watched.entries)
    assert [e.frame for e in watched.entries if e.epoch == first] == list(range(1, 21))
    assert [e.frame for e in watched.entries if e.epoch == second][:3] == [5, 6, 7]
    assert watched.live.switched == 1
    assert watched.live.prepared == 1  # Of the mesh before the cut.


def test_kept_states_fit_into_their_limit_and_are_spread_evenly(session: Recording) -> None:
    one = EveryFrame()
    one.offer(0, session.begin(1))
    kept = EveryFrame(limit=7 * one.size)
    player = Player(session, kept)
    while not player.over:
        player.play()
        assert kept.size <= kept.limit
    assert kept.frames[0] == 0
    assert kept.frames[-1] == FRAMES
    assert max(np.diff(kept.frames)) <= FRAMES / 2
    tight = EveryFrame(limit=10)
    Player(session, tight)
    assert len(tight) == 0


@pytest.mark.parametrize(("rate", "frames"), [(0.25, 10), (1.0, 40), (3.0, 40), (20.0, 40)])
def test_the_rate_is_in_recorded_seconds(
    session: Recording, tmp_path: Path, rate: float, frames: int
) -> None:
    watched = Watched(session, tmp_path, rate)
    watched.ticks(40)
    assert watched.entries[-1].frame == frames
    assert crcs(watched.entries) == [session.entry(e.frame).crc32 for e in watched.entries]
    # Edits of frames that are not shown are published with the next that is.
    versions = [edit.change.edit.version for frame in watched.frames for edit in frame.edits]
    assert versions == list(range(2, watched.entries[-1].version + 1))


def test_pause_resume_and_loop(watched: Watched) -> None:
    watched.ticks(4)
    assert watched.change(PAUSE).success
    watched.ticks(10)
    assert len(watched.frames) == 4
    assert watched.change(RESUME).success
    watched.ticks(200)
    assert [entry.frame for entry in watched.entries] == list(range(1, FRAMES + 1))
    assert watched.live.state.paused
    assert watched.live.state.time == pytest.approx(FRAMES / 60)
    assert watched.change(LOOP, 1.0).success
    watched.change(RESUME)
    watched.ticks(FRAMES + 4)
    assert [entry.frame for entry in watched.entries[FRAMES:]] == [
        *range(1, FRAMES + 1),
        *range(1, 7),
    ]


def test_epochs_follow_one_another(tmp_path: Path) -> None:
    """After a reset the recording goes on with another epoch."""
    recording = Recording("s", [recorded_epoch(14), recorded_epoch(8, epoch=bytes(16))])
    watched = Watched(recording, tmp_path)
    watched.ticks(30)
    assert crcs(watched.entries) == crcs(recording.entries)
    assert len({entry.epoch for entry in watched.entries}) == 2
    assert watched.change(SEEK, 18 / 60).success
    assert watched.entries[-1].crc32 == recording.entry(18).crc32
    assert watched.change(SEEK, 3 / 60).success
    assert watched.entries[-1].crc32 == recording.entry(3).crc32


@pytest.mark.parametrize("frame", [0, 1, CUT - 1, UNDO + 2])
def test_a_take_over_without_input_is_the_recording(
    session: Recording, tmp_path: Path, frame: int
) -> None:
    watched = Watched(session, tmp_path)
    watched.ticks(frame)
    assert watched.change(TAKE_OVER).success
    watched.ticks(FRAMES - frame - 1)
    assert crcs(watched.entries) == crcs(session.entries)
    assert watched.live.player.differing == 0
    assert watched.live.state.branch_frame == frame
    watched.ticks(3)
    assert [entry.frame for entry in watched.entries[-3:]] == [FRAMES + 1, FRAMES + 2, FRAMES + 3]


def test_the_first_own_input_parts_the_branch_which_replays_bit_for_bit(
    session: Recording, watched: Watched
) -> None:
    """Before it, after a take-over: the recording. After it: what people did; all of it again."""
    watched.ticks(25)
    watched.change(SEEK, 6 / 60)
    assert watched.change(TAKE_OVER, tools=("left",)).success
    watched.ticks(3)
    head = watched.entries[25:]
    assert crcs(head) == crcs(session.entries[5 : 5 + len(head)])
    parted = head[-1].frame
    for step in range(30):
        place = np.add(CORNER, [0.0, 0.0006 * step, 0.0])
        watched.live.post_pose("left", pose_of(place), step + 1, watched.now)
        if step == 20:
            watched.live.post_use("left", False)
        watched.ticks(1)
    assert watched.entries[-1].crc32 != session.entry(watched.entries[-1].frame).crc32
    branch = watched.branch(session)
    assert [entry.frame for entry in branch] == list(range(1, len(branch) + 1))
    own = branch[parted:]
    recorded = session.entries[parted:]
    for entry, was in zip(own, recorded, strict=False):
        samples = {sample.tool: sample for sample in entry.inputs.tools}
        theirs = {sample.tool: sample for sample in was.inputs.tools}
        # The other tool goes on as recorded, the one taken over does not.
        assert np.array_equal(samples["right"].pose, theirs["right"].pose)
        assert not np.array_equal(samples["left"].pose, theirs["left"].pose)
    edges = [s.edge for e in own for s in e.inputs.tools if s.tool == "left"]
    # It was pressed in the recording: letting go is an edge, going on is none.
    assert [edge for edge in edges if edge] == [-1]
    again = replay(branch, copy.deepcopy(session.epoch_at(1).start))
    assert again.mismatches == ()
    assert np.array_equal(again.positions, watched.positions[-1])


def test_edits_that_no_longer_fit_are_left_out_and_said(
    session: Recording, watched: Watched
) -> None:
    """A cut in other tissue: recorded cuts and undos made after it mean something else."""
    watched.ticks(CUT - 3)
    watched.change(TAKE_OVER, tools=("right",))
    live = watched.live
    plan = split_at(live.simulation.mesh, 0.045, top=0.05)
    planned = PlannedEdit(replace(plan, author="anna"), live.simulation.epoch)
    assert watched.ask("edit", planned=planned).success
    watched.ticks(FRAMES)
    # The cut of CUT was planned on the version that the person's cut changed elsewhere: it fits if
    # what it reads is as it was. The undo would take back another edit, and the second cut was
    # planned on what came of it.
    said = " ".join(watched.events)
    assert "undo is left out" in said
    assert "split by knife is left out" in said
    assert not any(frame.lost for frame in watched.frames)
    assert replay(watched.branch(session), session.begin(1).mesh).mismatches == ()


def test_the_cuts_of_a_knife_that_was_taken_over_are_its_persons(
    session: Recording, watched: Watched
) -> None:
    watched.ticks(CUT - 3)
    watched.change(TAKE_OVER, tools=("knife",))
    watched.live.post_use("knife", False)
    watched.ticks(2)
    assert not any(frame.cuts for frame in watched.frames)
    watched.live.post_use("knife", True)
    watched.ticks(3)
    assert [cut.tool for frame in watched.frames for cut in frame.cuts] == ["knife"]
    assert watched.entries[-1].version == 1
    assert "knife is a person's" in " ".join(watched.events)


def test_a_tool_used_first_stays_where_the_recording_left_it(
    session: Recording, watched: Watched
) -> None:
    """Without a pose of its own it must not jump to where the scene had it."""
    watched.ticks(20)
    watched.change(TAKE_OVER, tools=("left",))
    watched.live.post_use("left", False)
    watched.ticks(2)
    left = watched.entries[-1].inputs.tools[0]
    assert left.tool == "left"
    assert np.array_equal(left.pose, session.entry(21).inputs.tools[0].pose)
    assert len(watched.live.simulation.holds.of_tool("left")) == 0


def test_after_the_recording_tools_stay_where_it_left_them(
    session: Recording, watched: Watched
) -> None:
    watched.change(TAKE_OVER, tools=("left",))
    watched.ticks(FRAMES + 10)
    last = {sample.tool: sample for sample in session.entries[-1].inputs.tools}
    for sample in watched.entries[-1].inputs.tools:
        assert np.array_equal(sample.pose, last[sample.tool].pose)
        assert (sample.use, sample.edge) == (last[sample.tool].use, 0)
    tool = tool_at(CORNER, "mine")
    assert watched.ask("set_tool", **tool.as_arguments()).success
    watched.live.post_pose("mine", pose_of(CORNER), 1, watched.now)
    watched.live.post_use("mine", False)
    watched.ticks(1)
    watched.live.post_use("mine", True)
    watched.ticks(1)
    assert watched.live.simulation.holds.of_tool("mine")


def test_input_before_a_take_over_is_nothing(session: Recording, watched: Watched) -> None:
    watched.live.post_pose("left", pose_of((0, 0, 0)), 1, 0.0)
    watched.live.post_use("left", True)
    watched.ticks(8)
    for kind, arguments in (
        ("grab", {"tool": "left", "radius": 0.01}),
        ("set_tool", tool_at(CORNER, "mine").as_arguments()),
        ("save", {"name": "x"}),
        ("edit", {"planned": PlannedEdit(split_at(session.begin(1).mesh, 0.03), bytes(16))}),
    ):
        answer = watched.ask(kind, **arguments)
        assert (answer.error, answer.success) == ("BUSY", False)
    watched.ticks(FRAMES)
    assert crcs(watched.entries) == crcs(session.entries)


def test_a_tool_that_was_not_taken_over_is_nobodys(watched: Watched) -> None:
    watched.ticks(8)
    watched.change(TAKE_OVER, tools=("left",))
    assert watched.ask("remove_tool", tool="right").error == "BUSY"
    watched.live.post_pose("right", pose_of((0, 0, 0)), 1, 0.0)
    watched.ticks(2)
    assert watched.live.branch is not None
    assert not watched.live.branch.parted
    assert watched.change(TAKE_OVER, tools=("right",)).success
    assert watched.ask("remove_tool", tool="right").success


def test_what_is_not_allowed_says_what_is(watched: Watched) -> None:
    watched.ticks(5)
    for what, value, tools, code, words in (
        (RATE, 0.0, (), "INVALID", "allowed: 0.05 to 20"),
        (RATE, float("nan"), (), "INVALID", "allowed: 0.05 to 20"),
        (SEEK, -1.0, (), "INVALID", "allowed: 0 to 0.666667 s"),
        (SEEK, 1.0, (), "INVALID", "allowed: 0 to 0.666667 s"),
        ("rewind", 0.0, (), "INVALID", "allowed: pause, resume"),
        (TAKE_OVER, 0.0, ("hook",), "UNKNOWN_TOOL", "tools: left, right, knife"),
    ):
        answer = watched.change(what, value, tools)
        assert (answer.success, answer.error) == (False, code)
        assert words in answer.message
    assert watched.live.branch is None
    assert watched.change(TAKE_OVER, tools=("left",)).success
    for what in (PAUSE, RESUME, SEEK, RATE, LOOP):
        assert watched.change(what, 0.1).error == "BRANCHED"
    assert "left is taken over already" in watched.change(TAKE_OVER, tools=("left",)).message
    assert watched.change(TAKE_OVER).message == "taken over: knife, right"
    assert "taken over already" in watched.change(TAKE_OVER).message
    with pytest.raises(ValueError, match=r"0\.05 to 20"):
        PlaybackClock(21.0)


def test_another_processor_is_said(session: Recording, tmp_path: Path) -> None:
    epoch = recorded_epoch(10)
    epoch.entries[4] = replace(epoch.entries[4], crc32=1)
    watched = Watched(Recording("session", [epoch]), tmp_path)
    watched.ticks(12)
    assert [event for event in watched.events if "bit for bit" in event]
    assert watched.live.player.differing == 1


def test_recordings_that_cannot_be_played() -> None:
    whole = recorded_epoch(6)
    with pytest.raises(JournalError, match="holds no frame"):
        Recording("bag", [])
    with pytest.raises(JournalError, match="begins at frame 2"):
        Recording("bag", [replace(whole, entries=whole.entries[1:])])
    with pytest.raises(JournalError, match="gap: frame 4 follows frame 2"):
        Recording("bag", [replace(whole, entries=[*whole.entries[:2], *whole.entries[3:]])])
    with pytest.raises(JournalError, match="no tissue/topology"):
        Recording("bag", [replace(whole, mesh=None)])


def test_a_reset_ends_the_recordings_part(session: Recording, watched: Watched) -> None:
    watched.ticks(RELEASE - 5)
    watched.change(TAKE_OVER)
    answers: list[Answer] = []
    watched.live.post(Request("reset", {}, "r", answers.append))
    deadline = time.monotonic() + 60
    while not answers and time.monotonic() < deadline:
        watched.ticks(1)
    assert answers[0].success
    watched.ticks(2)
    assert watched.live.branch is not None
    assert watched.entries[-1].epoch.hex() != watched.live.branch.id
    assert watched.entries[-1].version == 1
