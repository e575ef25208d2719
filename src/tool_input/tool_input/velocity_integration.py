"""From the velocity a device asks for to the pose of a tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tool_input.motion import Pose

_SMALL_ANGLE = 1e-4
"""[rad] Below it the series of the sine and cosine terms are exact to rounding."""


@dataclass(frozen=True)
class Response:
    """How far a stick is pushed as the share of full speed it asks for.

    Attributes:
        deadband: Deflections up to this are none; the rest is stretched, so that motion begins
            at zero speed.
        exponent: k of (exp(k x) - 1) / (exp(k) - 1); 0: in proportion. Finer near the middle the
            larger it is.
    """

    deadband: float = 0.05
    exponent: float = 0.0

    def shaped(self, deflection: NDArray[np.float64]) -> NDArray[np.float64]:
        """Shares of full speed for deflections, both from -1 to 1; more than 1 counts as 1."""
        size = np.minimum(np.abs(deflection), 1.0)
        size = np.maximum(size - self.deadband, 0.0) / (1.0 - self.deadband)
        if self.exponent > 0.0:
            size = np.expm1(self.exponent * size) / np.expm1(self.exponent)
        return np.asarray(np.copysign(size, deflection))


def moved_in_tool_axes(pose: Pose, twist: NDArray[np.float64], seconds: float) -> Pose:
    """The pose after a constant twist in the tool's own axes: a screw motion.

    Args:
        pose: Where the tool is.
        twist: Velocity of the tip [m/s], then angular velocity [rad/s], in the axes of the tool,
            which turn with it; shape (6,).
        seconds: How long [s].

    Returns:
        T exp(t [v, w]), by the exponential map of SE(3): exact for any time.

    References:
        Murray, Li and Sastry 1994, A Mathematical Introduction to Robotic Manipulation, 2.3.
    """
    turn = twist[3:] * seconds
    way = _mean_turn(turn) @ (twist[:3] * seconds)
    rotation = Rotation.from_quat(pose.quaternion)
    return Pose(
        pose.position + rotation.apply(way), (rotation * Rotation.from_rotvec(turn)).as_quat()
    )


def moved_in_fixed_axes(
    pose: Pose, twist: NDArray[np.float64], seconds: float, axes: Rotation
) -> Pose:
    """The pose after a constant velocity of the tip while the tool turns about its tip.

    Args:
        pose: Where the tool is.
        twist: Velocity of the tip [m/s], then angular velocity [rad/s], in the fixed axes,
            shape (6,).
        seconds: How long [s].
        axes: Orientation of the fixed axes: the organ's or a camera's.
    """
    rotation = Rotation.from_quat(pose.quaternion)
    turn = Rotation.from_rotvec(axes.apply(twist[3:] * seconds))
    return Pose(pose.position + axes.apply(twist[:3] * seconds), (turn * rotation).as_quat())


def _mean_turn(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """The mean of exp(s [turn]) over s from 0 to 1, shape (3, 3)."""
    angle = float(np.linalg.norm(turn))
    if angle < _SMALL_ANGLE:
        first, second = 0.5 - angle**2 / 24.0, 1.0 / 6.0 - angle**2 / 120.0
    else:
        first = (1.0 - np.cos(angle)) / angle**2
        second = (angle - np.sin(angle)) / angle**3
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)
