"""`tissue replay --watch`: what is refused before anything starts, keys, and what is said."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from tissue_interfaces.msg import Playback, Status
from tissue_interfaces.srv import SetPlayback

from support.bags import ROOMY, session_bag
from support.recorded_pull import pull_bag, record_pull
from support.tissue_command import tissue
from tissue_sim.parameters import ParameterError
from tissue_sim.playback.parameters import PARAMETERS
from tissue_sim.playback.recording import read_recording
from tissue_sim.session import BAG, SIMULATION_PROCESS, TABLE, process_specs
from tissue_sim.terminal_keys import keys_in
from tissue_sim.watching import WatchOptions, plan_watch, recorded_parameters, told_differences
from tissue_sim.watching_keys import act_on, status_line
from viz_bridge.bag_writer import BagWriter

ASK = SetPlayback.Request


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pull_bag(tmp_path_factory.mktemp("bag") / "recorded", frames=12)[0]


def attached(folder: Path) -> Path:
    """A bag that says what its simulation was told, and on which machine."""
    writer = BagWriter(folder, ROOMY)
    values = {
        "max_jump": 0.01, "geometry": "block", "wait_for": ["tissue/journal:1"],
        "frames.camera.parent": "organ",
    }  # fmt: skip
    writer.attach("parameters.json", "application/json", json.dumps({"/sim": values}).encode())
    writer.describe("tissue_sim", {"machine": "abacus", "python": "1.2"})
    record_pull(writer, frames=3)
    writer.close()
    return folder


def torn(folder: Path) -> Path:
    """A bag whose recorder was killed."""
    path, _ = pull_bag(folder, frames=12)
    (file,) = path.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-400])
    return path


@pytest.mark.parametrize(
    ("make", "arguments", "words"),
    [
        (lambda folder: folder / "nothing", (), "is not there (expected a bag"),
        (lambda folder: folder, (), "holds no .mcap file"),
        (lambda folder: pull_bag(folder / "b", with_journal=False)[0], (), "no /tissue/journal"),
        (lambda folder: pull_bag(folder / "b", with_topology=False)[0], (), "no tissue/topology"),
        (lambda folder: torn(folder / "b"), (), "tissue bag recover"),
        (lambda folder: session_bag(folder / "b", frames=5), (), "begins at frame"),
        (lambda folder: pull_bag(folder / "b", frames=3)[0], ("--rate", "0"), "0.05 to 20"),
        (lambda folder: pull_bag(folder / "b", state_every=30)[0], ("--states",), "2.0 states"),
        (lambda folder: pull_bag(folder / "b", frames=3)[0], ("--scene", "wall"), "same organ"),
        (lambda folder: pull_bag(folder / "b", frames=3)[0], ("--scene", "x"), "no scene 'x'"),
        (lambda folder: pull_bag(folder / "b", frames=3)[0], ("--model", "lr"), "recorded model"),
        (lambda folder: pull_bag(folder / "b", frames=3)[0], ("--namespace", "x"), "namespace 'x'"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line_and_starts_nothing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    make: Any,
    arguments: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.setattr(sys, "argv", [])
    out = tmp_path / "out"
    command = ("replay", str(make(tmp_path)), "--watch", "--out", str(out), *arguments)
    code, _, errors = tissue(capsys, *command)
    assert code == 2
    assert words in errors
    assert len(errors.splitlines()) == 1
    assert not out.exists()


def test_the_session_plays_the_bag(bag: Path, tmp_path: Path) -> None:
    options = WatchOptions(bag, tmp_path / "out", rate=2.0, loop=True, memory_mb=5.0)
    plan = plan_watch(options, read_recording(bag))
    assert plan.scene.simulation["playback.bag"] == str(bag)
    assert plan.scene.simulation["playback.rate"] == 2.0
    assert plan.scene.simulation["playback.loop"] is True
    known = {spec.name: spec for spec in PARAMETERS}
    for name, value in plan.scene.simulation.items():
        assert known[name].checked(value) == value
    specs = process_specs(plan)
    assert {SIMULATION_PROCESS, BAG, TABLE} <= set(specs)
    headless = plan_watch(WatchOptions(bag, tmp_path / "out", headless=True), read_recording(bag))
    assert TABLE not in process_specs(headless)
    with pytest.raises(ParameterError, match=r"0\.05 to 20"):
        known["playback.rate"].checked(0.0)


def test_people_are_treated_as_in_the_recorded_session(bag: Path, tmp_path: Path) -> None:
    """Limits and frames hold on; what made the organ does not, since the journal has it."""
    path = attached(tmp_path / "bag")
    assert recorded_parameters(path) == {"max_jump": 0.01, "frames.camera.parent": "organ"}
    assert recorded_parameters(bag) == {}


def test_another_machine_is_told(bag: Path, tmp_path: Path) -> None:
    assert told_differences(bag) == []
    lines = told_differences(attached(tmp_path / "bag"))
    assert lines[0].startswith("recorded with machine abacus, played with ")
    assert lines[1].startswith("recorded with python 1.2, played with ")
    assert "bit for bit" in lines[-1]


class Client:
    """Remembers what was asked."""

    def __init__(self, playback: Playback | None, request: str = "") -> None:
        self.playback, self.status = playback, Status(request=request, progress=0.25)
        self.asked: list[tuple[int, float]] = []
        self.time = playback.time if playback else 0.0

    def change(self, what: int, value: float = 0.0) -> None:
        self.asked.append((what, value))


def test_keys_change_the_playing() -> None:
    playing = Playback(time=2.0, duration=6.0, rate=1.0)
    for key, asked in (
        (" ", (ASK.PAUSE, 0.0)), ("left", (ASK.SEEK, 0.0)), ("right", (ASK.SEEK, 6.0)),
        ("+", (ASK.RATE, 2.0)), ("-", (ASK.RATE, 0.5)), ("l", (ASK.LOOP, 1.0)),
        ("t", (ASK.TAKE_OVER, 0.0)),
    ):  # fmt: skip
        client: Any = Client(playing)
        assert act_on(key, client)
        assert client.asked == [asked]
    standing = Playback(time=2.0, duration=6.0, rate=16.0, paused=True, looping=True)
    for key, asked in ((" ", (ASK.RESUME, 0.0)), ("+", (ASK.RATE, 20.0)), ("l", (ASK.LOOP, 0.0))):
        client = Client(standing)
        act_on(key, client)
        assert client.asked == [asked]
    nothing: Any = Client(None)
    assert act_on("t", nothing)
    assert not act_on("q", nothing)
    assert nothing.asked == []
    assert keys_in("q\x1b[C \x1b[Dx") == ["q", "right", " ", "left", "x"]


def test_the_line_says_how_it_is_played() -> None:
    line: Any = status_line
    assert line(Client(None)) == "loading"
    playing = Playback(time=2.0, duration=6.0, rate=0.5, looping=True)
    assert line(Client(playing)) == "2.0 of 6.0 s, rate 0.5, looping"
    assert line(Client(playing, "seek")) == "on the way: 25%"
    assert line(Client(Playback(time=6.0, duration=6.0, paused=True))) == "6.0 of 6.0 s, paused"
    branch = Playback(duration=6.0, branch="a", branch_frame=90, taken_over=["grasper"])
    assert line(Client(branch)) == "live after frame 90: grasper taken over"
