"""From the poses and jaw of a robot's arm to a tool."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tool_input.motion import Pose


@dataclass(frozen=True)
class ArmBase:
    """Where the arm's base stands in the organ frame.

    Attributes:
        position: Position of the base [m], shape (3,).
        rotation: Orientation of the base.
        scale: Metres the tool moves per metre of the arm.
    """

    position: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    rotation: Rotation = field(default_factory=Rotation.identity)
    scale: float = 1.0


class ArmMapping:
    """Turns the arm's poses into the tool's, with a clutch.

    While the clutch is pressed the tool stays where it is; from its release on, the tool moves as
    the arm moves, beginning where it is. Orientations always follow the arm.
    """

    def __init__(self, base: ArmBase) -> None:
        self._base = base
        self._shift = np.zeros(3)
        self._clutched = False
        self._tool: Pose | None = None
        self._arm: NDArray[np.float64] | None = None

    def tool_pose(self, arm: Pose) -> Pose:
        """The tool's pose in the organ frame for a pose of the arm in its base's frame."""
        mapped = self._mapped(arm.position)
        self._arm = np.asarray(arm.position, dtype=np.float64)
        if self._clutched and self._tool is not None:
            return self._tool
        rotation = self._base.rotation * Rotation.from_quat(arm.quaternion)
        self._tool = Pose(mapped + self._shift, rotation.as_quat())
        return self._tool

    def clutch(self, pressed: bool) -> None:
        """Take the arm off the tool, or put it back on."""
        if self._clutched and not pressed and self._tool is not None and self._arm is not None:
            self._shift = self._tool.position - self._mapped(self._arm)
        self._clutched = pressed

    def _mapped(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        turned = self._base.rotation.apply(self._base.scale * np.asarray(position))
        return np.asarray(self._base.position + turned)


class JawSwitch:
    """A jaw's opening as pressed or released, with hysteresis.

    Attributes:
        pressed: The level; None before the first opening.
    """

    def __init__(self, press_below: float, release_above: float) -> None:
        """Set the thresholds.

        Args:
            press_below: Opening [rad] below which the tool is pressed.
            release_above: Opening [rad] above which it is released.

        Raises:
            ValueError: The thresholds leave no gap.
        """
        if not press_below < release_above:
            raise ValueError(
                f"close_below = {press_below:g} rad must be less than open_above = "
                f"{release_above:g} rad"
            )
        self._press_below, self._release_above = press_below, release_above
        self.pressed: bool | None = None

    def changed(self, opening: float) -> bool:
        """Take an opening [rad]; whether the level changed (the first level counts as a change)."""
        if not np.isfinite(opening):
            return False
        level = self.pressed
        if level is None:
            level = opening < self._press_below
        elif opening < self._press_below:
            level = True
        elif opening > self._release_above:
            level = False
        changed = level != self.pressed
        self.pressed = level
        return changed
