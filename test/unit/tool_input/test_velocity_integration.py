"""Integrated velocities against closed forms and an independent matrix exponential."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from tool_input.motion import Pose
from tool_input.velocity_integration import Response, moved_in_fixed_axes, moved_in_tool_axes

TWISTS = arrays(np.float64, 6, elements=st.floats(-3.0, 3.0))
START = Pose(np.array([0.1, -0.2, 0.3]), Rotation.from_rotvec([0.4, -0.9, 0.2]).as_quat())


def matrix(pose: Pose) -> np.ndarray:
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = Rotation.from_quat(pose.quaternion).as_matrix(), pose.position
    return whole


@settings(max_examples=60, deadline=None, derandomize=True)
@given(TWISTS, st.sampled_from([1e-9, 1e-5, 1e-3, 0.1, 2.0]))
def test_motion_in_the_tools_axes_is_the_matrix_exponential(twist: np.ndarray, time: float) -> None:
    x, y, z = twist[3:]
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    generator[:3, 3] = twist[:3]
    expected = matrix(START) @ expm(time * generator)
    np.testing.assert_allclose(matrix(moved_in_tool_axes(START, twist, time)), expected, atol=1e-11)


def test_constant_twist_is_a_screw() -> None:
    """About z with a pitch: a helix of radius v / w that rises by v_z t."""
    speed, turning, rise = 0.03, 2.0, 0.01
    origin = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    twist = np.array([speed, 0.0, rise, 0.0, 0.0, turning])
    for time in np.linspace(0.0, 5.0, 11):
        radius, angle = speed / turning, turning * time
        helix = [radius * np.sin(angle), radius * (1.0 - np.cos(angle)), rise * time]
        pose = moved_in_tool_axes(origin, twist, time)
        np.testing.assert_allclose(pose.position, helix, atol=1e-14)
        turn = Rotation.from_quat(pose.quaternion) * Rotation.from_rotvec([0, 0, -angle])
        assert turn.magnitude() < 1e-12


@settings(max_examples=30, deadline=None, derandomize=True)
@given(TWISTS)
def test_many_short_steps_end_where_one_long_one_does(twist: np.ndarray) -> None:
    axes = Rotation.from_rotvec([0.3, 0.1, -1.2])

    def in_tool_axes(pose: Pose, time: float) -> Pose:
        return moved_in_tool_axes(pose, twist, time)

    def in_fixed_axes(pose: Pose, time: float) -> Pose:
        return moved_in_fixed_axes(pose, twist, time, axes)

    for moved in (in_tool_axes, in_fixed_axes):
        pose = START
        once = moved(pose, 0.4)
        for _ in range(50):
            pose = moved(pose, 0.008)
        np.testing.assert_allclose(matrix(pose), matrix(once), atol=1e-12)


def test_in_fixed_axes_the_tip_moves_straight_while_the_tool_turns() -> None:
    axes = Rotation.from_rotvec([0.0, np.pi / 2, 0.0])
    moved = moved_in_fixed_axes(START, np.array([0.0, 0.0, 0.1, 0.0, 0.0, 1.0]), 2.0, axes)
    np.testing.assert_allclose(moved.position - START.position, [0.2, 0.0, 0.0], atol=1e-15)
    turned = Rotation.from_quat(moved.quaternion) * Rotation.from_quat(START.quaternion).inv()
    np.testing.assert_allclose(turned.as_rotvec(), [2.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("exponent", [0.0, 2.0, 5.0])
def test_response_begins_at_the_deadband_and_ends_at_full_speed(exponent: float) -> None:
    response = Response(deadband=0.2, exponent=exponent)
    given = np.array([-2.0, -1.0, -0.2, -0.1, 0.0, 0.2, 0.2 + 1e-9, 0.6, 1.0, 7.0])
    shaped = response.shaped(given)
    np.testing.assert_allclose(shaped[[0, 1, 8, 9]], [-1, -1, 1, 1])
    np.testing.assert_array_equal(np.abs(shaped[2:6]), 0.0)
    assert 0.0 < shaped[6] < 1e-8
    half = 0.5 if exponent == 0.0 else 1.0 / (1.0 + np.exp(exponent / 2.0))
    assert shaped[7] == pytest.approx(half)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    arrays(np.float64, 6, elements=st.floats(-1.0, 1.0)), st.floats(0.0, 0.9), st.floats(0.0, 10.0)
)
def test_response_is_odd_and_never_falls(
    deflection: np.ndarray, deadband: float, exponent: float
) -> None:
    response = Response(deadband, exponent)
    np.testing.assert_allclose(response.shaped(-deflection), -response.shaped(deflection))
    assert (np.diff(response.shaped(np.sort(deflection))) >= 0.0).all()
