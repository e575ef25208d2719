"""A procedure file says what happens when, and a mistake in it is reported with its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tissue_sim.scene_file import config_folder
from tissue_sim.script_words import SCRIPTED
from tool_input.located_yaml import ProcedureError
from tool_input.motion import Motion, Pose
from tool_input.player import Player
from tool_input.procedure import ACTIONS, Event, Procedure, load_procedure, parse_procedure

TEXT = """\
title: example
units: mm
tools:
  forceps: {kind: grab, shape: sphere, size: [5], start: {position: [0, 0, 10]}}
  knife:
    kind: cut
    start: {position: [0, 0, 10], orientation: {axis: [0, 0, 2], angle_deg: 90}}
timeline:
  - {at: 0, label: go}
  - {at: 0, move: forceps, to: [0, 0, 0], for: 1}
  - {at: 1.5, press: forceps}
  - {at: 2, move: forceps, by: [3, 0, 0], turn: {rotation_vector: [0, 0, 1]}, for: 1e0}
  - {at: 3, use: knife, for: 0.5}
  - {at: 3, cut: {rectangle: {center: [0, 0, 0], along: [10, 0, 0], depth: [0, 0, 8]}}}
  - {at: 3.2, model: lr, parameters: {levels: 3}}
  - {at: 3.6, grab: forceps, radius: 4}
  - {at: 3.8, let_go: forceps}
  - {at: 4, pause: true}
  - {at: 4.1, pause: false}
  - {at: 4.2, release: forceps}
end: 5
"""


class Recorder:
    """A stage that remembers."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, object]] = []
        self.poses: dict[str, Pose] = {}

    def pose(self, tool: str, pose: Pose) -> None:
        self.poses[tool] = pose

    def use(self, tool: str, pressed: bool) -> None:
        self.calls.append((f"use {tool}", (pressed, tuple(self.poses[tool].position))))

    def act(self, event: Event) -> None:
        self.calls.append((event.action, event.target))


def test_lengths_are_metres_whatever_the_file_uses() -> None:
    in_mm = parse_procedure(TEXT)
    forceps = in_mm.tools["forceps"]
    assert forceps.size == (0.005,)
    np.testing.assert_allclose(forceps.start.position, [0, 0, 0.01])
    cut = next(event for event in in_mm.events if event.action == "cut")
    assert cut.sweep is not None
    np.testing.assert_allclose(np.ptp(cut.sweep.vertices, axis=0), [0.01, 0, 0.008])
    grab = next(event for event in in_mm.events if event.action == "grab")
    assert grab.value == pytest.approx(0.004)


def test_undo_and_redo_are_actions() -> None:
    lines = "  - {at: 4.12, undo: true}\n  - {at: 4.15, redo: true}\n  - {at: 4.2, release"
    procedure = parse_procedure(TEXT.replace("  - {at: 4.2, release", lines))
    found = [event.action for event in procedure.events if event.action in ("undo", "redo")]
    assert found == ["undo", "redo"]
    with pytest.raises(ValueError, match="must be true"):
        parse_procedure(TEXT.replace("  - {at: 4.2, release", lines.replace("true", "false", 1)))


def test_tool_rests_at_both_ends_of_a_motion_and_goes_where_it_is_sent() -> None:
    procedure = parse_procedure(TEXT)
    np.testing.assert_allclose(procedure.pose("forceps", 0.0).position, [0, 0, 0.01])
    np.testing.assert_allclose(procedure.pose("forceps", 0.5).position, [0, 0, 0.005])
    np.testing.assert_allclose(procedure.pose("forceps", 1.7).position, [0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(procedure.pose("forceps", 9.0).position, [0.003, 0, 0])
    turned = Rotation.from_quat(procedure.pose("forceps", 9.0).quaternion)
    np.testing.assert_allclose(turned.as_rotvec(), [0, 0, 1], atol=1e-12)
    knife = Rotation.from_quat(procedure.pose("knife", 0.0).quaternion)
    np.testing.assert_allclose(knife.as_rotvec(), [0, 0, np.pi / 2], atol=1e-12)
    times = np.linspace(0.0, 1.0, 1001)
    heights = np.array([procedure.pose("forceps", time).position[2] for time in times])
    speed = np.gradient(heights, times)
    assert abs(speed[0]) < 1e-4
    assert abs(speed[-1]) < 1e-4
    assert np.abs(speed).max() == pytest.approx(0.01 * 1.875, rel=1e-3)  # of minimum jerk


@settings(deadline=None, max_examples=50)
@given(st.floats(-1.0, 6.0))
def test_no_time_is_out_of_range(time: float) -> None:
    for through in ("", ", through: true"):
        path = f"path: [{{by: [1, 2, 3], for: 0.3}}, {{by: [3, 1, 0], for: 0.7}}]{through}}}"
        text = TEXT.replace("to: [0, 0, 0], for: 1}", path)
        pose = parse_procedure(text).pose("forceps", time)
        assert np.isfinite(pose.position).all()
        assert np.linalg.norm(pose.quaternion) == pytest.approx(1.0)


def test_use_is_a_press_and_a_release() -> None:
    procedure = parse_procedure(TEXT)
    assert [procedure.pressed("knife", time) for time in (2.9, 3.2, 3.6)] == [False, True, False]
    assert procedure.pressed("forceps", 4.0)
    assert not procedure.pressed("forceps", 4.3)


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(1e-3, 0.7), min_size=1, max_size=60))
def test_nothing_is_left_out_whatever_the_clock_does(steps: list[float]) -> None:
    procedure = parse_procedure(TEXT)
    smooth, jerky = Recorder(), Recorder()
    for stage, times in ((smooth, np.arange(0.0, 5.1, 0.01)), (jerky, np.cumsum(steps))):
        player = Player(procedure, stage)
        player.begin()
        for time in times:
            player.advance(float(time))
        player.advance(5.0)
        assert player.over
    assert smooth.calls == jerky.calls


def test_press_takes_effect_where_the_tool_is_at_that_time() -> None:
    moving = TEXT.replace("at: 1.5, press", "at: 0.5, press")
    stage = Recorder()
    player = Player(parse_procedure(moving), stage)
    player.begin()
    player.advance(5.0)
    used = [call for name, call in stage.calls if name == "use forceps"]
    assert used[0] == (False, (0.0, 0.0, 0.01))
    assert used[1] == (True, (0.0, 0.0, 0.005))


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("units: mm", "units: cm", 2, "allowed: m, mm"),
        ("units: mm\n", "", 1, "'units' is missing"),
        ("kind: grab", "kind: grip", 4, "allowed: grab, cut"),
        ("size: [5]", "size: [5, 5]", 4, "must have 1 numbers"),
        ("size: [5]", "size: [-5]", 4, "greater than 0"),
        ("size: [5]", "size: [five]", 4, "must be a number"),
        ("[0, 0, 10]}}", "[0, .inf, 10]}}", 4, "finite"),
        ("axis: [0, 0, 2]", "axis: [0, 0, 0]", 7, "must not be zero"),
        ("press: forceps", "press: forcep", 11, "known: forceps, knife"),
        ("press: forceps", "pres: forceps", 11, "unknown key 'pres'"),
        ("press: forceps", "press: forceps, move: knife", 11, "exactly one action"),
        ("at: 1.5", "at: .nan", 11, "finite"),
        ("at: 1.5", "at: -1", 11, "at least 0"),
        ("at: 2,", "at: 0.7,", 12, "in order of time"),
        ("to: [0, 0, 0], for: 1}", "to: [0, 0, 0], for: 2.5}", 12, "must not overlap"),
        ("to: [0, 0, 0], for: 1}", "for: 1}", 10, "to, by, turn or orientation"),
        ("to: [0, 0, 0], for: 1}", "to: [0, 0, 0]}", 10, "'for' is missing"),
        ("to: [0, 0, 0], for: 1}", "to: [0, 0, 0], for: 0}", 10, "greater than 0"),
        ("use: knife", "use: forceps", 13, "pressed already"),
        ("grab: forceps", "grab: knife", 16, "a grab tool is needed"),
        ("depth: [0, 0, 8]", "depth: [5, 0, 0]", 14, "without area"),
        ("{rectangle:", "{square:", 14, "unknown key 'square'"),
        ("pause: true", "pause: 1", 18, "true or false"),
        ("release: forceps}", "release: knife}", 20, "not pressed already"),
        ("end: 5", "end: 4", 21, "before the last step ends"),
        ("end: 5", "ends: 5", 21, "unknown key 'ends'"),
        ("end: 5", "units: m", 21, "appears twice"),
        ("title: example", "title: [example", 2, "no valid YAML"),
    ],
)
def test_mistake_is_reported_with_its_line(old: str, new: str, line: int, says: str) -> None:
    assert old in TEXT
    with pytest.raises(ProcedureError) as caught:
        parse_procedure(TEXT.replace(old, new, 1), "file.yaml")
    message = str(caught.value)
    assert message.startswith(f"file.yaml:{line}: "), message
    assert says in message, message


@pytest.mark.parametrize("content", ["", "just words", "[1, 2]", "a: &x [*x]", "\x00"])
def test_file_that_is_no_procedure_is_refused(tmp_path: Path, content: str) -> None:
    file = tmp_path / "procedure.yaml"
    file.write_text(content)
    with pytest.raises(ProcedureError, match=r"procedure\.yaml"):
        load_procedure(file)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProcedureError, match="cannot be read"):
        load_procedure(tmp_path / "none.yaml")


def test_path_passes_through_its_points_without_stopping() -> None:
    straight = np.array([0.0, 0.0, 0.0, 1.0])
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    points = [Pose(corner, straight) for corner in corners]
    stops, passes = Motion([0, 1, 2], points), Motion([0, 1, 2], points, through=True)
    for motion in (stops, passes):
        for time, pose in zip((0, 1, 2), points, strict=True):
            np.testing.assert_allclose(motion.at(time).position, pose.position, atol=1e-12)
    eps = 1e-4

    def speed(motion: Motion, time: float) -> float:
        step = motion.at(time + eps).position - motion.at(time - eps).position
        return float(np.linalg.norm(step)) / (2 * eps)

    assert speed(stops, 1.0) < 1e-3
    assert speed(passes, 1.0) > 0.5


def demo() -> Procedure:
    return load_procedure(config_folder() / "procedures" / "demo.yaml")


def test_demo_lasts_long_enough_and_moves_no_faster_than_the_simulation_lets_tools() -> None:
    procedure = demo()
    assert procedure.end * 60 >= 1200
    speeds = [motion.top_speed() for motions in procedure.motions.values() for motion in motions]
    assert max(speeds) < 0.1


SEWN = """
units: mm
tools: {}
timeline:
  - at: 1
    suture: {from: [[0, 0, 0], [0, 9, 0]], to: [[1, 0, 0], [1, 9, 0]]}
    running: true
    name: rim
    spacing: 3
  - {at: 2, suture: {pairs: [[[0, 0, 0], [1, 0, 0]]]}, length: 0.5, reach: 2, stiffness: 300}
  - {at: 3, tighten: rim, share: 0.5}
  - {at: 4, tighten: all, length: 0}
  - {at: 5, unsuture: rim}
"""


def test_stitches_are_read_with_lengths_in_the_files_units() -> None:
    procedure = parse_procedure(SEWN)
    line, pair, share, tight, out = procedure.events
    assert line.stitching is not None
    assert pair.stitching is not None
    assert line.stitching.positions[:, 1].tolist() == pytest.approx([0.0, 0.009, 0.0, 0.009])
    assert (line.stitching.spacing, line.stitching.running, line.value) == (0.003, True, -1.0)
    assert pair.stitching.positions.ravel().tolist() == pytest.approx([0, 0, 0, 0.001, 0, 0])
    assert (pair.stitching.reach, pair.stitching.stiffness, pair.value) == (0.002, 300.0, 0.0005)
    assert [(event.action, event.target, event.value) for event in (share, tight)] == [
        ("tighten", "rim", -0.5),
        ("tighten", "all", 0.0),
    ]
    assert str(out) == "unsuture rim"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("tighten: rim", "tighten: hem", "nothing was sewn as 'hem' before; allowed: rim, all"),
        ("name: rim", "name: all", "'all' is taken"),
        (", share: 0.5", "", "must have either length or share"),
        ("share: 0.5", "share: 0.5, length: 1", "either length or share"),
        ("share: 0.5", "share: -1", "must be more than 0|greater than 0"),
        ("    spacing: 3\n", "", "from and to need the key 'spacing'"),
        ("length: 0.5", "length: 0.5, spacing: 1", "pairs are stitches as they are"),
        ("to: [[1, 0, 0], [1, 9, 0]]", "to: [[1, 0, 0]]", "the same number of points"),
        ("[1, 0, 0]]]}", "[1, 0, 0], [2, 0, 0]]]}", "must be pairs of points"),
        ("length: 0.5", "length: .nan", "finite"),
    ],
)
def test_mistakes_in_stitches_are_refused(old: str, new: str, message: str) -> None:
    assert old in SEWN
    with pytest.raises(ProcedureError, match=message):
        parse_procedure(SEWN.replace(old, new, 1))


def test_a_burning_tool_is_read_with_its_radius() -> None:
    hook = "  hook: {kind: burn, shape: sphere, size: [2], start: {position: [0, 0, 10]}}\n"
    tool = parse_procedure(TEXT.replace("  knife:", f"{hook}  knife:")).tools["hook"]
    assert (tool.kind, tool.shape, tool.size) == ("burn", "sphere", (0.002,))


def test_reports_tell_what_a_script_does_from_its_labels() -> None:
    assert {*ACTIONS, "continue", "over"} == set(SCRIPTED)
