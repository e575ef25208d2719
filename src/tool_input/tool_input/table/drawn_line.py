"""A line drawn on tissue, and the surface through the wall that a cut along it follows.

The line is what the person sees: a fan of rays from the eye. The surface is ruled along these
rays, so that it is seen edge-on as the line that was drawn, and from where the rays come into the
wall to where they leave it, it lies in tissue, however oblique the view.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tool_input.table.sight import Sight, Wall

Vec3 = NDArray[np.float64]
Points = NDArray[np.float64]

MOST_RULINGS = 100
"""Rulings of a sheet: two triangles from each to the next, and a cut takes 2000 at most."""

PASSES = 4
"""How often a line is evened out, see `smoothed`."""

OVER_THE_EDGE = 3
"""How far from an end of the line tissue may end for the cut to go on over it, in spacings."""

CLOSES = 6
"""How near to its begin a line may end to be taken as closed, in spacings."""

_SHORTEST = 2
"""A shorter line is a slip of the hand, in spacings."""

_TANGENT = 4
"""Points from an end of the line whose direction is that of the end."""


class Ruled(NamedTuple):
    """A surface of straight lines, one from each near point to its far point.

    Attributes:
        near: Ends before the tissue [m], shape (n, 3).
        far: Ends in it or behind it [m], shape (n, 3).
    """

    near: Points
    far: Points

    @property
    def vertices(self) -> Points:
        """Corners of the triangles [m], shape (2 n, 3)."""
        return np.concatenate([self.near, self.far])

    @property
    def triangles(self) -> NDArray[np.uint32]:
        """Rows of `vertices`, shape (2 (n - 1), 3)."""
        count = len(self.near)
        i = np.arange(count - 1)
        first = np.stack([i, i + 1, count + i], axis=1)
        second = np.stack([i + 1, count + i + 1, count + i], axis=1)
        return np.concatenate([first, second]).astype(np.uint32)


class DrawnLine:
    """A line while it is drawn."""

    def __init__(self, eye: Vec3, forward: Vec3, start: Vec3, spacing: float) -> None:
        """Begin a line.

        Args:
            eye: Where the line is seen from [m], shape (3,).
            forward: Unit direction of the view, shape (3,).
            start: Where on the tissue it begins [m], shape (3,).
            spacing: Distance of its points and so of the rays through them [m]; also the margin
                before and behind the wall.
        """
        self._eye, self._forward, self._spacing = eye, forward, spacing
        self._distance = float((start - eye) @ forward)
        self._points = [self._in_view(start)]
        self._tip = self._points[0]
        self._walls: dict[bytes, Wall | None] = {}

    def draw(self, point: Vec3) -> None:
        """Go on to a point [m], shape (3,); it counts as where it is seen.

        Raises:
            ValueError: It is behind the eye.
        """
        self._tip = self._in_view(point)
        last = self._points[-1]
        steps = int(np.linalg.norm(self._tip - last) / self._spacing)
        if steps:
            step = (self._tip - last) * (self._spacing / np.linalg.norm(self._tip - last))
            self._points += [last + count * step for count in range(1, steps + 1)]

    def straighten(self, point: Vec3) -> None:
        """Be the straight line from where it began to a point [m], shape (3,)."""
        del self._points[1:]
        self.draw(point)

    def sheet(self, sight: Sight, depth: float | None = None, ended: bool = False) -> Ruled:
        """The surface that the line sweeps through the wall.

        Args:
            sight: The tissue as it is now; where rays were cast for an earlier sheet they are not
                cast again.
            depth: How far below the tissue's surface it reaches along the view [m]; None: through
                the first wall, whatever its thickness.
            ended: Whether the line has its full length. Then it is closed where it nearly is, or
                goes on over the edge of the tissue where that is near: a person can only begin to
                draw on tissue, and a bridge would be left there.

        Raises:
            ValueError: The line is too short, or meets no tissue.
        """
        line = np.array([*self._points, self._tip])
        if len(line) < 1 + _SHORTEST:
            raise ValueError("a cut needs a line drawn across the tissue; drag further")
        if np.linalg.norm(line[-1] - line[-2]) < 0.5 * self._spacing:
            line = np.delete(line, -2, axis=0)
        line = smoothed(line, PASSES)
        if ended and self._returns(line):
            line = np.concatenate([line, line[:1]])
        elif ended:
            line = self._over_edge(sight, self._over_edge(sight, line)[::-1])[::-1]
        seen = [self._wall(sight, point) for point in line]
        known = np.flatnonzero([wall is not None for wall in seen])
        if not len(known):
            raise ValueError("the line meets no tissue; draw it where the organ is")
        walls = np.array([wall for wall in seen if wall is not None])
        everywhere = np.arange(len(line))
        near = np.interp(everywhere, known, walls[:, 0])
        if depth is None:
            behind = np.minimum(self._spacing, 0.5 * (walls[:, 2] - walls[:, 1]))
            far = np.interp(everywhere, known, walls[:, 1] + behind)
        else:
            far = near + depth
        chosen = np.unique(np.linspace(0, len(line) - 1, MOST_RULINGS).round().astype(np.int64))
        rays = line - self._eye
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        before = np.maximum(near - self._spacing, 0.0)
        ends = (self._eye + at[:, None] * rays for at in (before, far))
        return Ruled(*(points[chosen] for points in ends))

    def _in_view(self, point: Vec3) -> Vec3:
        """Where a point is seen in the plane across the view in which the line began."""
        ray = point - self._eye
        ahead = float(ray @ self._forward)
        if ahead <= 0.0:
            raise ValueError("the line goes behind the eye; move the view away from the tissue")
        return np.asarray(self._eye + ray * (self._distance / ahead))

    def _wall(self, sight: Sight, point: Vec3) -> Wall | None:
        key = point.tobytes()
        if key not in self._walls:
            ray = point - self._eye
            self._walls[key] = sight.wall(self._eye, ray / np.linalg.norm(ray), self._spacing)
        return self._walls[key]

    def _returns(self, line: Points) -> bool:
        """Whether a line goes around something and comes back to where it began."""
        gap = float(np.linalg.norm(line[-1] - line[0]))
        return len(line) > 4 * CLOSES and gap <= CLOSES * self._spacing

    def _over_edge(self, sight: Sight, line: Points) -> Points:
        """The line, its last end moved on over the edge of the tissue where that is near."""
        wall = self._wall(sight, line[-1])
        along = line[-1] - line[-1 - min(_TANGENT, len(line) - 1)]
        length = float(np.linalg.norm(along))
        if wall is None or length == 0.0:
            return line
        steps = np.arange(1, OVER_THE_EDGE + 2)[:, None] * along * (self._spacing / length)
        for count, point in enumerate(line[-1] + steps[:-1], start=2):
            beyond = self._wall(sight, point)
            if beyond is None or beyond.near > wall.far + self._spacing:
                return np.concatenate([line, line[-1] + steps[count - 1 : count]])
        return line


def smoothed(points: Points, passes: int) -> Points:
    """Points at equal distances along a line, evened out; the ends stay.

    Args:
        points: Along the line, shape (n, d).
        passes: How often each becomes the mean of itself, twice, and its neighbours: a blur with
            a variance of passes / 2 squared steps.
    """
    points = points.copy()
    for _ in range(passes):
        points[1:-1] = 0.25 * (points[:-2] + 2.0 * points[1:-1] + points[2:])
    return points
