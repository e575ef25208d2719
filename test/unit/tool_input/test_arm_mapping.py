"""An arm moves a tool as it moves itself, scaled, and lets go of it with the clutch."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tool_input.arm_mapping import ArmBase, ArmMapping, JawSwitch
from tool_input.motion import Pose
from tool_input.workspace import Workspace

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


def test_clutch_lets_the_hand_turn_back_without_turning_the_tool() -> None:
    mapping = ArmMapping(ArmBase(rotation=QUARTER))
    about_x = Rotation.from_rotvec([0.7, 0.0, 0.0])
    before = mapping.tool_pose(Pose(np.zeros(3), about_x.as_quat()))
    mapping.clutch(True)
    mapping.tool_pose(Pose(np.zeros(3), STRAIGHT))
    mapping.clutch(False)
    after = mapping.tool_pose(Pose(np.zeros(3), STRAIGHT))
    np.testing.assert_allclose(after.quaternion, before.quaternion, atol=1e-12)
    # From then on a turn of the hand about an axis turns the tool about the same axis of the room.
    turned = mapping.tool_pose(Pose(np.zeros(3), about_x.as_quat()))
    way = Rotation.from_quat(turned.quaternion) * Rotation.from_quat(before.quaternion).inv()
    np.testing.assert_allclose(way.as_rotvec(), QUARTER.apply([0.7, 0.0, 0.0]), atol=1e-12)


def test_origin_of_the_arm_is_mapped_to_the_base_position() -> None:
    base = ArmBase(np.array([1.0, 2.0, 3.0]), QUARTER, 0.5, np.array([0.1, 0.0, -0.1]))
    mapping = ArmMapping(base)
    np.testing.assert_allclose(mapping.tool_pose(arm_at(0.1, 0.0, -0.1)).position, [1, 2, 3])
    moved = mapping.tool_pose(arm_at(0.3, 0.0, -0.1)).position
    np.testing.assert_allclose(moved, [1.0, 2.1, 3.0], atol=1e-12)


def test_tool_stays_in_the_workspace_and_the_clutch_goes_on_from_its_edge() -> None:
    mapping = ArmMapping(ArmBase(), Workspace.between([-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]))
    mapping.tool_pose(arm_at(0.0, 0.0, 0.0))
    at_edge = mapping.tool_pose(arm_at(0.5, 0.05, 0.0)).position
    np.testing.assert_allclose(at_edge, [0.1, 0.05, 0.0])
    mapping.clutch(True)
    mapping.clutch(False)
    back = mapping.tool_pose(arm_at(0.45, 0.05, 0.0)).position
    np.testing.assert_allclose(back, [0.05, 0.05, 0.0], atol=1e-12)
