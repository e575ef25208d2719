"""A recording is watched, sought in and taken over by a client; the branch replays bit for bit."""

from __future__ import annotations

import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tissue_interfaces.msg import Playback
from tissue_interfaces.srv import Grab, SetPlayback

from support.recorded_pull import pull_bag
from support.simulation_process import Client, client, eventually
from support.tissue_command import tissue
from tissue_sim import qos
from tissue_sim.session_bag import read_epochs
from viz_bridge.bag_reader import metadata_of, topic_counts

COMMAND = "from tissue_sim.cli import main; main()"
FRAMES = 900
START_SECONDS = 200.0
"""Longest wait for all processes to begin [s]; only a failing test waits so long."""

ELSEWHERE = (0.06, 0.05, 0.06)
"""Where the person puts the grasper [m]."""

ASK = SetPlayback.Request


class Viewer:
    """Somebody who follows the playing and changes it."""

    def __init__(self, node: Client) -> None:
        self.node = node
        self.told: list[Playback] = []
        node.node.create_subscription(Playback, "tissue/playback", self.told.append, qos.LATCHED)

    def ask(
        self, what: int, value: float = 0.0, tools: tuple[str, ...] = ()
    ) -> SetPlayback.Response:
        answer: SetPlayback.Response = self.node.call(
            SetPlayback, "tissue/set_playback", what=what, value=value, tools=list(tools)
        )
        return answer

    def is_at(self, seconds: float) -> bool:
        """Whether the recording stands at a time."""
        return bool(self.told[-1].time == pytest.approx(seconds))

    def branched(self) -> Playback | None:
        """What was told first after a take-over."""
        return next((told for told in self.told if told.branch), None)


@pytest.mark.usefixtures("ros_domain")
def test_a_recording_is_taken_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, _ = pull_bag(tmp_path / "recorded", frames=FRAMES, state_every=6, cut_at=30)
    command = [sys.executable, "-u", "-c", COMMAND, "replay", str(bag), "--watch", "--headless"]
    output = (tmp_path / "said.txt").open("wb")
    process = subprocess.Popen(
        [*command, "--out", str(tmp_path / "out"), "--rate", "0.5"],
        stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
    )  # fmt: skip
    try:
        with client() as node:
            node.hear("tissue/journal", "tissue/status")
            viewer = Viewer(node)
            frame = watch(viewer)
            branch = take_over(viewer, frame)
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=120) == 0, (tmp_path / "said.txt").read_text()
    finally:
        process.kill()
        process.wait()
        output.close()
    session = tmp_path / "out" / "session"
    assert metadata_of(session)["branch"] == branch
    assert metadata_of(session)["parent_bag"] == str(bag)
    monkeypatch.setattr(sys, "argv", [])
    code, said, _ = tissue(capsys, "replay", str(session), "--out", str(tmp_path / "p.npz"))
    assert code == 0, said
    assert f"branch {branch[:8]} of {bag}" in said
    assert "bit-identical" in said
    code, said, _ = tissue(capsys, "bag", "check", str(session))
    assert code == 0, said
    compare(bag, session)
    assert not (tmp_path / "out" / "watched").exists()


def watch(viewer: Viewer) -> int:
    """Pause and seek; the frame of the recording that is shown then."""
    node = viewer.node
    eventually(lambda: node.heard["tissue/journal"], START_SECONDS)
    assert (
        node.call(Grab, "tissue/grab", tool="grasper", radius=0.01).error_code == Grab.Response.BUSY
    )
    assert viewer.ask(ASK.PAUSE).success
    eventually(lambda: viewer.told and viewer.told[-1].paused)
    for seconds in (0.8, 0.3):
        assert viewer.ask(ASK.SEEK, seconds).success
        eventually(partial(viewer.is_at, seconds))
    assert viewer.told[-1].paused
    assert viewer.told[-1].duration == pytest.approx(FRAMES / 60)
    assert viewer.ask(ASK.RATE, 0.0).error_code == SetPlayback.Response.INVALID
    assert viewer.ask(ASK.SEEK, 1e3).error_code == SetPlayback.Response.INVALID
    assert (
        viewer.ask(ASK.TAKE_OVER, tools=("hook",)).error_code == SetPlayback.Response.UNKNOWN_TOOL
    )
    return int(node.last("tissue/journal").frame)


def take_over(viewer: Viewer, frame: int) -> str:
    """Take the grasper over, wait, and pull elsewhere; the branch's id."""
    node = viewer.node
    assert viewer.ask(ASK.TAKE_OVER).success
    told = eventually(viewer.branched)
    assert told is not None
    assert (list(told.taken_over), told.branch_frame) == (["grasper"], frame)
    assert viewer.ask(ASK.TAKE_OVER, tools=("grasper",)).error_code == SetPlayback.Response.INVALID
    assert viewer.ask(ASK.SEEK, 0.0).error_code == SetPlayback.Response.BRANCHED
    # It goes on as recorded until the first pose, which comes before the recording is over.
    node.next("tissue/journal", lambda entry: entry.frame >= frame + 20)
    node.place("grasper", ELSEWHERE)
    placed = node.last("tissue/journal").frame
    node.next("tissue/journal", lambda entry: entry.frame >= placed + 10)
    return str(told.branch)


def compare(bag: Path, session: Path) -> None:
    """The branch begins with the recording's frames, then it parts from them."""
    (recorded,), (branch,) = read_epochs(bag), read_epochs(session)
    same = [a.crc32 == b.crc32 for a, b in zip(recorded.entries, branch.entries, strict=False)]
    parted = same.index(False)
    frame = int(metadata_of(session)["branch_frame"])
    assert parted >= frame + 20
    assert not any(same[parted:])
    assert branch.organ == recorded.organ
    assert np.array_equal(branch.start.rest, recorded.start.rest)
    assert topic_counts(session)["/tools/grasper/servo_cp"] > 0
    assert topic_counts(session)["/tissue/state"] > frame // 6
