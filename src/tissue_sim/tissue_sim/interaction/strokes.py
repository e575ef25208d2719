"""The way of a blade that cuts progressively: which surface its sides have passed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissue_sim.interaction import rigid

STEP_SHARE = 0.5
"""A side is cut along when it has advanced by this share of the tissue's mean edge."""

SIDEWAYS = 4.0
"""A side that has gone so many steps is cut along even if it has hardly advanced."""

HARDLY = 0.02
"""An advance of less than this share of a step is none: a blade that slides along itself."""

FARTHEST = 0.05
"""A blade that moves farther from one frame to the next has jumped [m]; it does not cut so far."""

QUAD = np.array([[0, 2, 1], [1, 2, 3]], dtype=np.uint32)
"""Triangles of a strip: corners 0 and 1 are its side before, 2 and 3 after. They face the same way
as those of the blade, so that a node in their plane is on the same side of both."""

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
        begun: Ends of each side from where it has not been cut along [m], shape (n, 2, 3).
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
        along = np.roll(self.corners, -1, axis=0) - self.corners
        out = np.stack([along[:, 2], np.zeros(len(along)), -along[:, 0]], axis=1)
        self._outwards = out / np.linalg.norm(out, axis=1, keepdims=True)
        self.restart(self.pose)

    def restart(self, pose: NDArray[np.float64]) -> None:
        """Cut along from a pose on, whatever was before it."""
        self.pose = pose.copy()
        self.begun, self._begun_outwards = self._sides(pose)

    @property
    def outwards(self) -> NDArray[np.float64]:
        """Unit vectors out of the blade at its sides, in the tool's axes, shape (n, 3)."""
        return self._outwards

    def _sides(self, pose: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Ends of the sides [m], shape (n, 2, 3), and outward unit vectors, shape (n, 3)."""
        corners = rigid.to_world(pose, self.corners)
        ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        return ends, self._outwards @ rigid.matrix(pose[3:]).T

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
        ends, outwards = self._sides(pose)
        way = ends - self.begun
        # Halfway between then and now: a blade that turns about itself does not advance.
        halfway = 0.5 * (outwards + self._begun_outwards)
        advance = np.einsum("ijk,ik->ij", way, halfway).max(axis=1)
        slid = np.sqrt((way * way).sum(axis=2).max(axis=1)) >= SIDEWAYS * self.step
        due = advance >= np.where(slid | last, HARDLY, 1.0) * self.step
        strips = np.concatenate([self.begun[due], ends[due]], axis=1)
        anew = due | slid | (advance < -HARDLY * self.step)
        self.begun[anew], self._begun_outwards[anew] = ends[anew], outwards[anew]
        if not len(strips):
            return None
        first = 4 * np.arange(len(strips), dtype=np.uint32)[:, None, None]
        return strips.reshape(-1, 3), (first + QUAD).reshape(-1, 3)
