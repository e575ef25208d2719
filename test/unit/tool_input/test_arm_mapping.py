"""An arm moves a tool as it moves itself, scaled, and lets go of it with the clutch."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tool_input.arm_mapping import ArmBase, ArmMapping, JawSwitch
from tool_input.motion import Pose

QUARTER = Rotation.from_rotvec([0, 0, np.pi / 2])
STRAIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def arm_at(x: float, y: float, z: float) -> Pose:
    return Pose(np.array([x, y, z]), STRAIGHT)


def test_base_and_scale_place_the_tool() -> None:
    mapping = ArmMapping(ArmBase(np.array([0.0, 0.0, 1.0]), QUARTER, scale=0.5))
    tool = mapping.tool_pose(arm_at(0.2, 0.0, 0.1))
    np.testing.assert_allclose(tool.position, [0.0, 0.1, 1.05], atol=1e-12)
    np.testing.assert_allclose(tool.quaternion, QUARTER.as_quat(), atol=1e-12)


def test_clutch_holds_the_tool_and_goes_on_without_a_jump() -> None:
    mapping = ArmMapping(ArmBase(scale=2.0))
    before = mapping.tool_pose(arm_at(0.1, 0.0, 0.0)).position
    mapping.clutch(True)
    np.testing.assert_array_equal(mapping.tool_pose(arm_at(0.3, 0.2, 0.0)).position, before)
    mapping.clutch(False)
    np.testing.assert_allclose(mapping.tool_pose(arm_at(0.3, 0.2, 0.0)).position, before)
    moved = mapping.tool_pose(arm_at(0.35, 0.2, 0.0)).position
    np.testing.assert_allclose(moved - before, [0.1, 0.0, 0.0], atol=1e-12)


def test_trembling_jaw_presses_once() -> None:
    jaw = JawSwitch(press_below=0.1, release_above=0.3)
    openings = [0.5, 0.2, 0.11, 0.09, 0.12, 0.09, 0.28, 0.12, 0.31, 0.29, 0.2]
    edges = [(opening, jaw.pressed) for opening in openings if jaw.changed(opening)]
    assert edges == [(0.5, False), (0.09, True), (0.31, False)]


def test_jaw_that_is_not_finite_changes_nothing() -> None:
    jaw = JawSwitch(0.1, 0.3)
    assert jaw.changed(0.05)
    assert not jaw.changed(float("nan"))
    assert jaw.pressed


def test_thresholds_without_a_gap_are_refused() -> None:
    with pytest.raises(ValueError, match="must be less than"):
        JawSwitch(0.3, 0.3)
