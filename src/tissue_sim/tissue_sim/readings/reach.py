"""How far tools are from tissue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.interaction import rigid
from tissue_sim.interaction.tools import BOX, CAPSULE, GRAB, PATCH, RECTANGLE, SPHERE, TRIANGLE

Reals = NDArray[np.float64]


@dataclass(frozen=True)
class ToolReach:
    """A tool as a box in its own axes, grown by a radius.

    That is exact for spheres, capsules, boxes and rectangular blades; a triangular blade counts as
    the rectangle around it.

    Attributes:
        tool: Its id.
        pose: Of its tip, in the organ's frame, shape (7,).
        low: Lowest corner of the box [m], shape (3,).
        high: Highest corner of the box [m], shape (3,).
        radius: [m].
        holds: Whether it can hold tissue.
    """

    tool: str
    pose: Reals
    low: Reals
    high: Reals
    radius: float
    holds: bool = False

    @classmethod
    def of(
        cls, tool: str, shape: str, size: Sequence[float], pose: Reals, kind: str = ""
    ) -> ToolReach:
        """The reach of a tool.

        Args:
            tool: Its id.
            shape: As `interaction.tools.SHAPES` has them.
            size: As `interaction.tools.SIZE_WORDS` says [m].
            pose: Of its tip, shape (7,).
            kind: As `interaction.tools.SHAPES` has them; empty: one that holds nothing.

        Raises:
            ValueError: There is no such shape.
        """
        holds = kind in (GRAB, PATCH)
        if shape == SPHERE:
            return cls(tool, pose, np.zeros(3), np.zeros(3), size[0], holds)
        if shape == CAPSULE:
            return cls(tool, pose, np.zeros(3), np.array([0.0, 0.0, size[1]]), size[0], holds)
        if shape == BOX:
            half = 0.5 * np.array(size)
            return cls(tool, pose, -half, half, 0.0, holds)
        if shape in (RECTANGLE, TRIANGLE):
            half = 0.5 * np.array([size[0], 0.0, size[1]])
            rise = np.array([0.0, 0.0, half[2] if shape == TRIANGLE else 0.0])
            return cls(tool, pose, rise - half, rise + half, 0.0, holds)
        raise ValueError(f"tool {tool}: there is no shape {shape!r}")

    def distances(self, points: Reals) -> Reals:
        """Distance of points from the tool [m], 0 or less inside it, shape (n,)."""
        local = rigid.to_local(self.pose, points)
        out = local - np.clip(local, self.low, self.high)
        return np.asarray(np.linalg.norm(out, axis=1) - self.radius)
