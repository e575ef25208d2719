"""One device steers one of several tools at a time; the others stay where they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tool_input.joy_mapping import CLUTCH, HOME, NEXT_TOOL, SLOW, USE
from tool_input.motion import Motion, Pose
from tool_input.velocity_integration import Response, moved_in_fixed_axes, moved_in_tool_axes
from tool_input.workspace import Workspace

_PEAK_OF_MINIMUM_JERK = 1.875
"""Greatest speed of a minimum-jerk motion as a multiple of its mean speed."""
_AT_HOME = 1e-9
"""[s] A way home that takes no longer has no length."""


@dataclass(frozen=True)
class Speeds:
    """How fast full deflection moves a tool.

    Attributes:
        linear: Speed of the tip [m/s].
        angular: Angular speed [rad/s].
        slow: Factor on both while the button for slow is down.
    """

    linear: float = 0.05
    angular: float = 1.0
    slow: float = 0.2

    def twist(self, shares: NDArray[np.float64], slow: bool) -> NDArray[np.float64]:
        """Velocity [m/s] and angular velocity [rad/s] for shares of full speed, shape (6,)."""
        factor = self.slow if slow else 1.0
        return factor * shares * np.repeat([self.linear, self.angular], 3)


@dataclass
class SteeredTool:
    """A tool of the device.

    Attributes:
        name: Its name.
        pose: Where it shall be; None before it was placed.
        home: Where it was the first time it was placed.
        used: Whether it is pressed.
    """

    name: str
    pose: Pose | None = None
    home: Pose | None = None
    used: bool = False


@dataclass
class Steering:
    """Moves the tools of a device by its deflection and its buttons.

    A tool that another one takes the device from stays where it is, pressed if it was: with one
    device a person holds tissue with one tool and goes on with another.

    Attributes:
        tools: The tools, in the order the button goes through them.
        speeds: How fast they move.
        response: From deflection to speed.
        workspace: Where they may be.
        axes: Orientation of the axes of motion; None: each tool's own.
        toggles: Whether each press of the button changes the level of use; otherwise the tool is
            pressed as long as the button is.
        active: Index of the tool that is steered.
    """

    tools: Sequence[SteeredTool]
    speeds: Speeds
    response: Response
    workspace: Workspace
    axes: Rotation | None = field(default_factory=Rotation.identity)
    toggles: bool = False
    active: int = 0
    _deflection: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6), init=False)
    _pressed: frozenset[str] = field(default=frozenset(), init=False)
    _way_home: tuple[Motion, float] | None = field(default=None, init=False)

    @property
    def tool(self) -> SteeredTool:
        """The tool that is steered."""
        return self.tools[self.active]

    def place(self, tool: SteeredTool, pose: Pose) -> None:
        """Say where a tool is, before it is steered and after a silence of the device."""
        tool.pose = pose
        tool.home = tool.home or pose

    def stop(self) -> None:
        """Stop all motion; what is pressed stays pressed."""
        self._deflection = np.zeros(6)
        self._way_home = None

    def deflect(self, deflection: NDArray[np.float64]) -> None:
        """Take how far the device is pushed, from -1 to 1 per motion, shape (6,)."""
        self._deflection = self.response.shaped(deflection)
        if self._deflection.any():
            self._way_home = None

    def press(self, pressed: frozenset[str], resumed: bool) -> None:
        """Take the buttons that are down, by their meaning.

        Args:
            pressed: Those that are.
            resumed: Whether the device was silent before: then what is down counts as pressed
                long ago, and only releases count.
        """
        begun = frozenset() if resumed else pressed - self._pressed
        ended = self._pressed - pressed
        self._pressed = pressed
        if USE in begun:
            self.tool.used = not self.tool.used if self.toggles else True
        if USE in ended and not self.toggles:
            self.tool.used = False
        if NEXT_TOOL in begun:
            self.active = (self.active + 1) % len(self.tools)
            self._way_home = None
        if HOME in begun:
            self._go_home()

    def advance(self, seconds: float) -> None:
        """Move the tool that is steered for some time [s]."""
        tool = self.tool
        if tool.pose is None or CLUTCH in self._pressed:
            return
        if self._way_home is not None:
            after = self._along_the_way_home(seconds)
        elif self._deflection.any():
            twist = self.speeds.twist(self._deflection, SLOW in self._pressed)
            after = self._moved(tool.pose, twist, seconds)
        else:
            return
        inside = self.workspace.limited(tool.pose.position, after.position)
        tool.pose = Pose(inside, after.quaternion)

    def _moved(self, pose: Pose, twist: NDArray[np.float64], seconds: float) -> Pose:
        if self.axes is None:
            return moved_in_tool_axes(pose, twist, seconds)
        return moved_in_fixed_axes(pose, twist, seconds, self.axes)

    def _go_home(self) -> None:
        """Begin a smooth motion home that is nowhere faster than full deflection."""
        pose, home = self.tool.pose, self.tool.home
        if pose is None or home is None:
            return
        factor = self.speeds.slow if SLOW in self._pressed else 1.0
        way = float(np.linalg.norm(home.position - pose.position))
        turn = Rotation.from_quat(pose.quaternion).inv() * Rotation.from_quat(home.quaternion)
        mean = max(way / self.speeds.linear, float(turn.magnitude()) / self.speeds.angular)
        seconds = _PEAK_OF_MINIMUM_JERK * mean / factor
        if seconds > _AT_HOME:
            self._way_home = (Motion([0.0, seconds], [pose, home]), 0.0)

    def _along_the_way_home(self, seconds: float) -> Pose:
        assert self._way_home is not None
        motion, time = self._way_home
        time += seconds
        self._way_home = (motion, time) if time < motion.end else None
        return motion.at(time)
