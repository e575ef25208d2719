"""From the poses and jaw of a robot's arm to a tool."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tissue_sim.interaction import rigid
from tool_input.motion import Pose
from tool_input.workspace import Workspace


@dataclass(frozen=True)
class ArmBase:
    """Where the arm's base stands in the organ frame.

    Attributes:
        position: Position of the base [m], shape (3,).
        rotation: Orientation of the base.
        scale: Metres the tool moves per metre of the arm.
        arm_origin: The arm's place, in its base's frame, that is mapped to `position` [m]: the
            middle of where the arm works, for instance, shape (3,).
    """

    position: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    rotation: Rotation = field(default_factory=Rotation.identity)
    scale: float = 1.0
    arm_origin: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))


class ArmMapping:
    """Turns the arm's poses into the tool's, with a clutch, within a workspace.

    While the clutch is pressed the tool stays as it is; from its release on it moves and turns as
    the arm does, beginning where and as it is.
    """

    def __init__(self, base: ArmBase, workspace: Workspace | None = None) -> None:
        """Begin with the clutch let in.

        Args:
            base: How the arm's frame lies in the organ's.
            workspace: Where the tool may be; None: anywhere.
        """
        self._base = base
        self._workspace = workspace
        self._shift = np.zeros(3)
        self._turn = rigid.IDENTITY[3:]
        self._axes = base.scale * base.rotation.as_matrix()
        self._quaternion = base.rotation.as_quat()
        self._clutched = False
        self._tool: Pose | None = None
        self._arm: Pose | None = None

    def tool_pose(self, arm: Pose) -> Pose:
        """The tool's pose in the organ frame for a pose of the arm in its base's frame."""
        self._arm = arm
        if self._clutched and self._tool is not None:
            return self._tool
        position = self._position(arm) + self._shift
        if self._workspace is not None:
            position = self._workspace.nearest(position)
        self._tool = Pose(position, rigid.multiply(self._rotation(arm), self._turn))
        return self._tool

    @property
    def clutched(self) -> bool:
        """Whether the arm is off the tool."""
        return self._clutched

    def hand_pose(self, arm: Pose) -> Pose:
        """The hand in the organ frame, in the tool's metres, whatever clutch and workspace do."""
        return Pose(self._position(arm), self._rotation(arm))

    def clutch(self, pressed: bool) -> None:
        """Take the arm off the tool, or put it back on."""
        if self._clutched and not pressed and self._tool is not None and self._arm is not None:
            self._shift = self._tool.position - self._position(self._arm)
            # On the right: a turn of the hand about an axis of the room turns the tool about it.
            back = rigid.conjugate(self._rotation(self._arm))
            self._turn = rigid.multiply(back, self._tool.quaternion)
        self._clutched = pressed

    def _position(self, arm: Pose) -> NDArray[np.float64]:
        way = np.asarray(arm.position) - self._base.arm_origin
        return np.asarray(self._base.position + self._axes @ way)

    def _rotation(self, arm: Pose) -> NDArray[np.float64]:
        return rigid.multiply(self._quaternion, arm.quaternion)


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
