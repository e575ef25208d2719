"""Smooth motion of a tool through timed poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from tool_input.located_yaml import ProcedureError


@dataclass(frozen=True)
class Pose:
    """Where a tool is.

    Attributes:
        position: Position of the tip [m], shape (3,).
        quaternion: Orientation as a unit quaternion x y z w, shape (4,).
    """

    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]


class Motion:
    """A tool's way through timed poses, at rest before the first and after the last.

    Between two poses a tool that stops at each of them follows the minimum-jerk polynomial
    s = 10 u^3 - 15 u^4 + 6 u^5. A tool that passes through follows a cubic spline that is at rest
    at both ends only.

    References:
        Flash and Hogan 1985, doi 10.1523/JNEUROSCI.05-07-01688.1985 (minimum jerk).

    Attributes:
        start: Time of the first pose [s].
        end: Time of the last pose [s].
    """

    def __init__(self, times: list[float], poses: list[Pose], through: bool = False) -> None:
        """Prepare the interpolation.

        Args:
            times: Increasing times of the poses [s].
            poses: At least two.
            through: Whether the tool passes the poses in between without stopping.
        """
        if len(times) < 2 or len(times) != len(poses):
            raise ProcedureError("a motion needs at least two timed poses")
        if not (np.diff(times) > 0).all():
            raise ProcedureError("the times of a motion must increase")
        self.start, self.end = float(times[0]), float(times[-1])
        self._times = np.array(times)
        self._points = np.array([pose.position for pose in poses])
        rotations = Rotation.from_quat(np.array([pose.quaternion for pose in poses]))
        self._slerp = Slerp(np.arange(len(times)), rotations)
        self._spline = (
            CubicSpline(self._times, self._points, bc_type="clamped") if through else None
        )
        knots = np.arange(len(times), dtype=np.float64)
        self._phase = CubicSpline(self._times, knots, bc_type="clamped") if through else None

    def at(self, time: float) -> Pose:
        """The pose at a time [s]."""
        time = min(max(time, self.start), self.end)
        if self._spline is not None and self._phase is not None:
            phase = min(max(float(self._phase(time)), 0.0), len(self._times) - 1.0)
            return Pose(np.asarray(self._spline(time)), self._slerp(phase).as_quat())
        segment = min(int(np.searchsorted(self._times, time, "right")) - 1, len(self._times) - 2)
        begin, length = self._times[segment], self._times[segment + 1] - self._times[segment]
        u = (time - begin) / length
        s = min(max(u * u * u * (10.0 + u * (6.0 * u - 15.0)), 0.0), 1.0)
        point = (1.0 - s) * self._points[segment] + s * self._points[segment + 1]
        return Pose(point, self._slerp(segment + s).as_quat())

    def top_speed(self) -> float:
        """Greatest speed of the tip [m/s], sampled."""
        times = np.linspace(self.start, self.end, 40 * len(self._times))
        points = np.array([self.at(time).position for time in times])
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return float((steps / np.diff(times)).max())
