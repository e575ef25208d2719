"""The surface that a blade has passed in one stroke, carried along by the tissue it has cut."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from cut_service.errors import SweepError
from cut_service.sweep import MAX_TRIANGLES, Sweep
from cut_service.work import Plan

ANCHORS = 4
"""Nodes that carry a point of the surface."""

MOST = 4 * MAX_TRIANGLES
"""Triangles remembered of a stroke: minutes of it."""

Points = NDArray[np.float64]
Rows = NDArray[np.int32]


class Swept:
    """Strips of one stroke, in the order they came.

    A strip as narrow as a frame's motion rarely parts an element, and one that stands alone would
    leave the elements whole into which the strip before it reached. So what is planned is the new
    strips together with the older ones near them: elements that were crossed in part before are now
    crossed whole, and the rim of the cut is carried on. Of the elements that only older strips
    cross, those at the rim are looked at again, and the others are left alone: what
    stands out of a lip must not be cut off once more.

    Tissue moves meanwhile. A point that has been planned with is carried by the nodes nearest to
    it, those of both lips, so that older strips stay where the cut is.

    Attributes:
        points: Where the surface's points are now [m], shape (n, 3).
        triangles: Three points each, shape (m, 3), oldest first.
        new: Number of triangles that have not been cut along, at the end of `triangles`.
        unfinished: Ids of the elements at the rim, shape (u,).
    """

    def __init__(self, reach: float) -> None:
        """Begin with nothing.

        Args:
            reach: How near to a new strip an older one is planned with again [m]; twice the
                tissue's edge, or more.
        """
        self.reach = reach
        self.points: Points = np.empty((0, 3))
        self.triangles: Rows = np.empty((0, 3), dtype=np.int32)
        self.new = 0
        self.unfinished: NDArray[np.uint32] = np.empty(0, dtype=np.uint32)
        self._rows: Rows = np.empty((0, ANCHORS), dtype=np.int32)
        self._weights: Points = np.empty((0, ANCHORS))
        self._offsets: Points = np.empty((0, 3))
        self._known: dict[bytes, int] = {}

    def add(self, vertices: ArrayLike, triangles: ArrayLike) -> None:
        """Add a strip; corners at the same place as earlier ones are the same points.

        So it goes on from the edge of the one before, wherever the tissue has taken that.

        Args:
            vertices: Corners [m], shape (k, 3) or flat.
            triangles: Three corners each, shape (j, 3) or flat.

        Raises:
            SweepError: See `Sweep.from_arrays`; nothing is added.
        """
        strip = Sweep.from_arrays(vertices, triangles)
        rows = np.empty(len(strip.vertices), dtype=np.int32)
        fresh: list[Points] = []
        for k, corner in enumerate(strip.vertices):
            key = corner.tobytes()
            if key not in self._known:
                self._known[key] = len(self.points) + len(fresh)
                fresh.append(corner)
            rows[k] = self._known[key]
        if fresh:
            count = len(fresh)
            self.points = np.concatenate([self.points, np.array(fresh)])
            self._rows = np.concatenate([self._rows, np.full((count, ANCHORS), -1, np.int32)])
            self._weights = np.concatenate([self._weights, np.zeros((count, ANCHORS))])
            self._offsets = np.concatenate([self._offsets, np.zeros((count, 3))])
        self.triangles = np.concatenate([self.triangles, rows[strip.triangles]])
        self.new += len(strip.triangles)
        self._forget()

    def sweep(self) -> Sweep:
        """The new strips and the older ones near them, the newest `MAX_TRIANGLES` of those.

        It goes on beyond its rim: whether a node at the blade's edge belongs to the cut must not
        depend on how far the blade has come, or the next strip would choose another one beside it.

        Raises:
            SweepError: Nothing is new.
        """
        chosen = self.triangles[self._near()][-MAX_TRIANGLES:]
        if not self.new:
            raise SweepError("no strip is new")
        used, corners = np.unique(chosen, return_inverse=True)
        triangles = np.ascontiguousarray(corners.reshape(chosen.shape), dtype=np.int32)
        old = max(0, len(triangles) - self.new)
        strips = Sweep(
            self.points[used],
            triangles,
            old=old,
            again=self.unfinished,
            passed=Sweep(self.points.copy(), self.triangles),
        )
        return strips.continued(0.5 * self.reach)

    def carry(self, positions: NDArray[np.floating], alive: NDArray[np.bool_]) -> None:
        """Move the points with the tissue.

        Args:
            positions: Of all nodes now [m], shape (node_rows, 3).
            alive: Which nodes there are, shape (node_rows or more,).
        """
        held = (self._rows >= 0).all(axis=1)
        rows = np.minimum(self._rows, len(positions) - 1)
        held = held & (rows == self._rows).all(axis=1) & alive[rows].all(axis=1)
        places = np.asarray(positions[self._rows[held]], dtype=np.float64)
        moved = np.einsum("ij,ijk->ik", self._weights[held], places)
        self.points[held] = moved + self._offsets[held]
        # Without its nodes a point stays where they left it.
        self._rows[~held] = -1

    def planned(
        self,
        positions: NDArray[np.floating],
        alive: NDArray[np.bool_],
        made: Plan | None,
    ) -> None:
        """Take note that everything has been planned with; the tissue carries it from now on.

        Args:
            positions: Of all nodes after the edit, in the shape it was planned on [m], shape
                (node_rows, 3).
            alive: Which nodes there are, shape (node_rows or more,).
            made: The plan that was applied; None: nothing was parted, and what is new remains so.
        """
        # Snapping has moved nodes without moving the tissue.
        points = np.unique(self.triangles[self._near()])
        self._anchor(points, positions, alive)
        if made is not None:
            left = np.setdiff1d(self.unfinished, made.edit.read_elements)
            self.unfinished = np.union1d(left, made.unfinished).astype(np.uint32)
            self.new = 0
        elif self.new:
            self._keep_new_near()

    def _keep_new_near(self) -> None:
        """What has parted nothing so far from the blade never will: it counts as old."""
        corners = self.points[self.triangles[-self.new :]]
        lower, upper = corners.min(axis=1), corners.max(axis=1)
        near = ((lower - self.reach <= upper[-1]) & (upper + self.reach >= lower[-1])).all(axis=1)
        self.new -= int(np.argmax(near))

    def _near(self) -> NDArray[np.bool_]:
        """Which triangles are new or within `reach` of a new one, shape (m,)."""
        count = len(self.triangles)
        near = np.arange(count) >= count - self.new
        if not self.new or near.all():
            return near
        corners = self.points[self.triangles]
        lower, upper = corners.min(axis=1), corners.max(axis=1)
        low, high = lower[near] - self.reach, upper[near] + self.reach
        for axis_low, axis_high in zip(low, high, strict=True):
            near |= ((lower <= axis_high) & (upper >= axis_low)).all(axis=1)
        return near

    def _anchor(
        self, points: Rows, positions: NDArray[np.floating], alive: NDArray[np.bool_]
    ) -> None:
        places = self.points[points]
        low, high = places.min(axis=0) - self.reach, places.max(axis=0) + self.reach
        around = ((positions >= low) & (positions <= high)).all(axis=1) & alive[: len(positions)]
        rows = np.flatnonzero(around)
        self._rows[points] = -1
        if len(rows) < ANCHORS:
            return
        there = positions[rows].astype(np.float64)
        found = cKDTree(there).query(places, ANCHORS)
        far, nearest = np.asarray(found[0]), np.asarray(found[1])
        weights = 1.0 / (far**2 + (0.1 * self.reach) ** 2)
        weights /= weights.sum(axis=1, keepdims=True)
        held = far.max(axis=1) <= self.reach
        kept, nearest = points[held], nearest[held]
        self._rows[kept], self._weights[kept] = rows[nearest], weights[held]
        middles = np.einsum("ij,ijk->ik", weights[held], there[nearest])
        self._offsets[kept] = places[held] - middles

    def _forget(self) -> None:
        """Forget the oldest half of a stroke that goes on for minutes."""
        if len(self.triangles) <= MOST or self.new > MOST // 2:
            return
        used, corners = np.unique(self.triangles[-(MOST // 2) :], return_inverse=True)
        self.triangles = corners.reshape(-1, 3).astype(np.int32)
        place = {int(old): new for new, old in enumerate(used)}
        self._known = {key: place[row] for key, row in self._known.items() if row in place}
        self.points, self._offsets = self.points[used], self._offsets[used]
        self._rows, self._weights = self._rows[used], self._weights[used]
