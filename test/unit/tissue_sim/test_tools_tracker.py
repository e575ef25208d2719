"""From what a source sends to the pose as used."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.small_block import pose_of
from tissue_sim.frame import ToolSample
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.interaction.tracker import ACTIVE, FREE, FROZEN, ToolLimits, ToolTracker

PERIOD = 1 / 60
LIMITS = ToolLimits(max_tool_speed=0.6, max_jump=0.05, pose_timeout=0.2, release_timeout=2.0)
STEP = LIMITS.max_tool_speed * PERIOD


class Source:
    """A source of motion and the frames it is seen in."""

    def __init__(self, spec: ToolSpec | None = None) -> None:
        self.tracker = ToolTracker((spec or ToolSpec("grasper")).checked(), LIMITS)
        self.now = 100.0
        self.let_go = False

    def pose(self, x: float, y: float = 0.0, z: float = 0.0) -> None:
        self.tracker.receive_pose(pose_of([x, y, z]), int(self.now * 1e9), self.now)

    def use(self, *levels: bool) -> None:
        for level in levels:
            self.tracker.receive_use(level)

    def frame(self, holding: bool = False, after: float = PERIOD) -> ToolSample:
        self.now += after
        sample, self.let_go = self.tracker.sample(self.now, PERIOD, holding)
        return sample


def test_the_newest_pose_is_used_with_its_stamp() -> None:
    source = Source()
    source.pose(0.1)
    source.now += 0.001
    source.pose(0.2)
    sample = source.frame()
    assert sample.pose[0] == 0.2
    assert sample.stamp == int(100.001 * 1e9)


def test_a_tool_without_a_source_is_free_and_stays_at_its_own_pose() -> None:
    source = Source(ToolSpec("grasper", pose=(1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)))
    for _ in range(500):
        sample = source.frame()
    assert source.tracker.state == FREE
    assert sample.pose[:3].tolist() == [1, 2, 3]
    assert sample.stamp == 0


def test_the_first_use_sets_the_level_without_an_edge() -> None:
    source = Source()
    source.pose(0.0)
    source.use(True)
    sample = source.frame()
    assert (sample.use, sample.edge) == (True, 0)
    source.use(False)
    assert source.frame().edge == -1


def test_an_edge_takes_effect_with_the_newest_pose_received_before_it() -> None:
    source = Source()
    source.use(False)
    source.pose(0.1)
    source.use(True)
    source.pose(0.2)
    pressed = source.frame()
    assert (pressed.edge, pressed.pose[0]) == (1, 0.1)
    assert source.frame().pose[0] == 0.2


def test_a_press_and_release_between_two_frames_are_both_seen() -> None:
    source = Source()
    source.use(False, True, False, True)
    assert [source.frame().edge for _ in range(4)] == [1, -1, 1, 0]


def test_repeated_levels_make_no_edges() -> None:
    source = Source()
    source.use(False, True, True, True, False, False)
    assert [source.frame().edge for _ in range(3)] == [1, -1, 0]


def test_what_holds_tissue_moves_at_most_at_full_speed_and_arrives() -> None:
    source = Source()
    source.pose(0.0)
    source.frame()
    source.pose(0.04)
    places = [source.frame(holding=True).pose[0] for _ in range(5)]
    np.testing.assert_allclose(places, [STEP, 2 * STEP, 3 * STEP, 4 * STEP, 0.04])


def test_what_holds_nothing_is_where_its_source_is_at_once() -> None:
    source = Source()
    source.pose(0.0)
    source.frame()
    source.pose(3.0)
    assert source.frame().pose[0] == 3.0


def test_a_steady_motion_faster_than_the_limit_lags_but_does_not_freeze() -> None:
    source = Source()
    source.pose(0.0)
    source.frame()
    for number in range(1, 60):
        source.pose(0.02 * number)
        source.frame(holding=True)
    assert source.tracker.state == ACTIVE
    assert source.tracker.pose[0] == pytest.approx(59 * STEP)


def test_a_jump_freezes_until_use_is_released() -> None:
    source = Source()
    source.use(False)
    source.pose(0.0)
    source.use(True)
    source.frame()
    source.pose(0.2)
    for _ in range(3):
        assert source.frame(holding=True).pose[0] == 0.0
    assert source.tracker.state == FROZEN
    assert "0.2" in source.tracker.reason
    assert "0.05" in source.tracker.reason
    source.pose(0.001)
    assert source.frame(holding=True).pose[0] == 0.0
    source.pose(0.2)
    source.use(False)
    released = source.frame(holding=True)
    assert (released.edge, released.pose[0]) == (-1, 0.0)
    assert source.frame().pose[0] == 0.2
    assert source.tracker.state == ACTIVE


def test_a_stale_pose_freezes_then_lets_go_once() -> None:
    source = Source()
    source.use(False)
    source.pose(0.1)
    source.use(True)
    source.frame()
    source.frame(holding=True, after=0.15)
    assert source.tracker.state == ACTIVE
    source.frame(holding=True, after=0.1)
    assert source.tracker.state == FROZEN
    assert not source.let_go
    sample = source.frame(holding=True, after=2.0)
    assert source.let_go
    assert (sample.edge, sample.use) == (-1, False)
    assert source.frame().edge == 0
    assert not source.let_go


def test_after_letting_go_a_source_must_release_and_press_again() -> None:
    source = Source()
    source.use(False)
    source.pose(0.1)
    source.use(True)
    source.frame()
    source.frame(holding=True, after=3.0)
    source.pose(0.1)
    source.use(True)
    assert source.frame().edge == 0
    source.use(False, True)
    assert [source.frame().edge for _ in range(2)] == [0, 1]


def test_a_source_that_has_been_gone_for_long_cannot_press() -> None:
    source = Source()
    source.use(False)
    source.pose(0.1)
    source.frame()
    source.frame(after=3.0)
    source.use(True)
    assert source.frame().edge == 0


def test_a_stale_tool_goes_on_when_poses_come_again() -> None:
    source = Source()
    source.pose(0.1)
    source.frame()
    source.frame(after=0.5)
    assert source.tracker.state == FROZEN
    source.pose(0.11)
    assert source.frame().pose[0] == 0.11
    assert source.tracker.state == ACTIVE


def test_several_sources_freeze_and_are_named() -> None:
    source = Source()
    source.pose(0.1)
    source.frame()
    source.tracker.set_sources(["/b/robot", "/a/mouse"])
    source.pose(0.2)
    assert source.frame().pose[0] == 0.1
    assert source.tracker.state == FROZEN
    assert "/a/mouse, /b/robot" in source.tracker.reason
    source.tracker.set_sources(["/a/mouse"])
    assert source.frame().pose[0] == 0.2


def test_while_clutched_the_source_moves_and_the_tool_does_not() -> None:
    source = Source()
    source.pose(0.1)
    source.frame()
    source.tracker.receive_clutch(True)
    source.pose(0.9)
    assert source.frame().pose[0] == 0.1
    source.tracker.receive_clutch(False)
    assert source.frame().pose[0] == pytest.approx(0.1)
    source.pose(0.95)
    assert source.frame().pose[0] == pytest.approx(0.15)


def test_scale_and_offset_map_the_source() -> None:
    source = Source(ToolSpec("grasper", scale=0.5, offset=(1.0, 0.0, 0.0)))
    source.pose(0.4)
    assert source.frame().pose[0] == pytest.approx(1.2)


def test_while_time_stands_still_what_is_held_stays() -> None:
    source = Source()
    source.pose(0.0)
    source.frame()
    source.pose(0.01)
    sample, _ = source.tracker.sample(source.now, 0.0, True)
    assert sample.pose[0] == 0.0


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.tuples(*[st.floats(-0.2, 0.2)] * 3),
            st.sampled_from([None, True, False]),
            st.floats(0.0, 0.5),
            st.booleans(),
        ),
        max_size=40,
    )
)
def test_no_source_moves_held_tissue_too_fast(
    events: list[tuple[tuple[float, float, float], bool | None, float, bool]],
) -> None:
    source = Source()
    before = source.tracker.pose.copy()
    for place, level, wait, holding in events:
        source.pose(*place)
        if level is not None:
            source.use(level)
        sample = source.frame(holding=holding, after=wait)
        assert np.isfinite(sample.pose).all()
        if holding:
            assert np.linalg.norm(sample.pose[:3] - before[:3]) <= STEP * (1 + 1e-9)
        before = sample.pose
