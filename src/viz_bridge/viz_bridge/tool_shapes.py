"""Tools as they are drawn."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viz_bridge.cdr import Message


@dataclass
class DrawnTool:
    """One tool.

    Attributes:
        id: Its name.
        kind: "grab", "cut", "burn", "patch" or "probe".
        shape: "sphere", "box", "capsule", "rectangle" or "triangle".
        size: As in Tool.size [m].
        state: "active", "frozen" or "free".
        pose: Tip: x y z [m] and quaternion x y z w, shape (7,).
        use: Whether it is pressed.
        force: On the tool [N], shape (3,).
    """

    id: str
    kind: str
    shape: str
    size: tuple[float, ...]
    state: str = "free"
    pose: NDArray[np.float64] = field(default_factory=lambda: np.array([0, 0, 0, 0, 0, 0, 1.0]))
    use: bool = False
    force: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    @property
    def look(self) -> tuple[str, str, tuple[float, ...]]:
        """What its drawing depends on, besides its pose."""
        return self.kind, self.shape, self.size

    @property
    def tip(self) -> NDArray[np.float64]:
        """Position of its tip [m], shape (3,)."""
        return self.pose[:3]


class DrawnTools:
    """The tools of an organ, followed from tissue/tools, the journal and measured_cf."""

    def __init__(self) -> None:
        self.by_id: dict[str, DrawnTool] = {}

    def take_list(self, message: Message) -> None:
        """Follow a ToolList: tools that are not in it are gone."""
        before, self.by_id = self.by_id, {}
        for tool in message.tools:
            new = DrawnTool(
                tool.id, tool.kind, tool.shape, tuple(float(s) for s in tool.size), tool.state
            )
            p, q = tool.pose.position, tool.pose.orientation
            new.pose = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
            old = before.get(tool.id)
            if old is not None:
                new.pose, new.use, new.force = old.pose, old.use, old.force
            self.by_id[tool.id] = new

    def take_journal(self, entry: Message) -> None:
        """Follow the poses as used in a frame."""
        for sample in entry.tools:
            tool = self.by_id.get(sample.id)
            if tool is not None:
                tool.pose = np.array(sample.pose, dtype=np.float64)
                tool.use = bool(sample.use)

    def take_force(self, tool: str, message: Message) -> None:
        """Follow the force on a tool; it is given in the organ's frame, like the pose."""
        if tool in self.by_id:
            force = message.wrench.force
            self.by_id[tool].force = np.array([force.x, force.y, force.z])

    @property
    def kinds(self) -> dict[str, str]:
        """Kind by tool."""
        return {tool.id: tool.kind for tool in self.by_id.values()}


def blade_corners(tool: DrawnTool) -> NDArray[np.float64]:
    """Corners of a blade about its tip [m], in the tool's own axes, shape (3 or 4, 3)."""
    length, depth = tool.size[0], tool.size[1]
    if tool.shape == "triangle":
        return np.array([[0, 0, 0], [length, 0, depth], [0, 0, depth]], dtype=np.float64)
    x, z = length / 2, depth / 2
    return np.array([[-x, 0, -z], [x, 0, -z], [x, 0, z], [-x, 0, z]], dtype=np.float64)


def rotated(quaternion: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points turned by a quaternion x y z w, shape (n, 3)."""
    axis, w = quaternion[:3], quaternion[3]
    t = 2 * np.cross(axis, points)
    turned: NDArray[np.float64] = points + w * t + np.cross(axis, t)
    return turned
