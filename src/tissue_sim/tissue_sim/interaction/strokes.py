"""The way of a blade that cuts progressively: which surface its sides have passed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissue_sim.interaction import rigid

STEP_SHARE = 0.25
"""A side is cut along when it has advanced by this share of the tissue's mean edge."""

SIDEWAYS = 4.0
"""A side that has gone so many steps is cut along even if it has hardly advanced."""

HARDLY = 0.02
"""An advance of less than this share of a step is none: a blade that slides along itself."""

FARTHEST = 0.05
"""A blade that moves farther from one frame to the next has jumped [m]; it does not cut so far."""

QUAD = np.array([[0, 1, 2], [1, 3, 2]], dtype=np.uint32)
"""Triangles of a strip: corners 0 and 1 are its side before, 2 and 3 after."""

Triangles = NDArray[np.uint32]


@dataclass
class Stroke:
    """One press of a blade.

    Every side of the blade remembers from where it has not been cut along yet. Side k goes from
    corner k to the next one. A strip is swept by a side that advances: that moves out of the blade
    in its plane. Sides that follow or slide along themselves cut nothing, and a blade that is moved
    across its plane cuts nothing.

    Attributes:
        id: Of the stroke.
        corners: Of the blade in the tool's axes [m], shape (n, 3).
        step: A side is cut along when it has advanced so far [m].
        pose: Of the tool in the last frame, shape (7,).
        begun: Pose from which each side has not been cut along, shape (n, 7).
        count: Strips handed out so far.
        cutting: Whether the tissue is open; before, the blade pushes it.
    """

    id: str
    corners: NDArray[np.float64]
    step: float
    pose: NDArray[np.float64]
    begun: NDArray[np.float64] = field(init=False)
    count: int = 0
    cutting: bool = True

    def __post_init__(self) -> None:
        self.restart(self.pose)

    def restart(self, pose: NDArray[np.float64]) -> None:
        """Cut along from a pose on, whatever was before it."""
        self.pose = pose.copy()
        self.begun = np.tile(pose, (len(self.corners), 1))

    @property
    def outwards(self) -> NDArray[np.float64]:
        """Unit vectors out of the blade at its sides, in the tool's axes, shape (n, 3)."""
        along = np.roll(self.corners, -1, axis=0) - self.corners
        out = np.stack([along[:, 2], np.zeros(len(along)), -along[:, 0]], axis=1)
        unit: NDArray[np.float64] = out / np.linalg.norm(out, axis=1, keepdims=True)
        return unit

    def jumped(self, pose: NDArray[np.float64]) -> float:
        """How far the blade has come since the last frame, if that is too far [m]; else 0."""
        was, now = rigid.to_world(self.pose, self.corners), rigid.to_world(pose, self.corners)
        way = float(np.linalg.norm(now - was, axis=1).max())
        return way if way > FARTHEST else 0.0

    def follow(
        self, pose: NDArray[np.float64], last: bool = False
    ) -> tuple[NDArray[np.float64], Triangles] | None:
        """Go on to a pose; the strips to cut now, if any has become wide enough.

        A strip begins exactly where the one before it of the same side ended.

        Args:
            pose: Of the tool, shape (7,).
            last: Whether narrow strips are handed out as well, because the stroke ends.

        Returns:
            Corners [m], four a strip (its side before, then after), and triangles.
        """
        self.pose = pose.copy()
        sides = self._due(pose, last)
        if not len(sides):
            return None
        strips = []
        for side in sides:
            ends = self.corners[[side, (side + 1) % len(self.corners)]]
            strips += [rigid.to_world(self.begun[side], ends), rigid.to_world(pose, ends)]
            self.begun[side] = pose
        first = 4 * np.arange(len(sides), dtype=np.uint32)[:, None, None]
        return np.concatenate(strips), (first + QUAD).reshape(-1, 3)

    def _due(self, pose: NDArray[np.float64], last: bool) -> list[int]:
        now, turned = rigid.to_world(pose, self.corners), rigid.matrix(pose[3:])
        due = []
        for side in range(len(self.corners)):
            ends = [side, (side + 1) % len(self.corners)]
            way = now[ends] - rigid.to_world(self.begun[side], self.corners[ends])
            # Halfway between then and now: a blade that turns about itself does not advance.
            halfway = 0.5 * (turned + rigid.matrix(self.begun[side, 3:]))
            advance = float((way @ halfway @ self.outwards[side]).max())
            travel = float(np.linalg.norm(way, axis=1).max())
            slid = travel >= SIDEWAYS * self.step
            if advance >= (HARDLY if slid or last else 1.0) * self.step:
                due.append(side)
            elif slid or advance < -HARDLY * self.step:
                self.begun[side] = pose
        return due
