"""The surface a blade sweeps: what a cut follows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cut_service.errors import SweepError
from cut_service.sweep_kernels import closest_on_sweep, crossed_edges

MAX_TRIANGLES = 2000
"""More triangles than a blade's path needs.

A guard against requests that would stall the service.
"""

MAX_SIZE_RATIO = 100.0
"""A sweep this many times as large as the organ is a mistake of units."""

FARTHEST = 1e6
"""Largest coordinate of a vertex [m]: more is a mistake, and squares of much more are infinite."""

FLAT = 1e-10
"""A triangle whose area is below this share of its longest edge squared has no direction."""


@dataclass(frozen=True)
class Sweep:
    """A triangulated surface in the organ's frame. Build it with `from_arrays`, which checks it.

    Attributes:
        vertices: Positions [m], float64, shape (vertex_count, 3).
        triangles: Three vertices each, shape (triangle_count, 3); triangles without area have been
            left out.
        beyond: Corners of triangles by which the surface goes on beyond its rim [m], shape (k, 3,
            3); None: it does not. They cut nothing, but distances are to them as well.
        old: Number of triangles, the first ones, along which was cut before. An element that only
            they cross has been parted as far as it is to be, and is left alone.
        again: Ids of elements to look at nevertheless, shape (j,).
        passed: All that a blade has passed in its stroke, of which this is the part near what is
            new; None: this is all. Springs through thick tissue reach beyond that part.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    beyond: NDArray[np.float64] | None = None
    old: int = 0
    again: NDArray[np.uint32] = field(default_factory=lambda: np.empty(0, dtype=np.uint32))
    passed: Sweep | None = None

    @classmethod
    def from_arrays(cls, vertices: ArrayLike, triangles: ArrayLike) -> Sweep:
        """Check and build a sweep.

        Args:
            vertices: Positions [m], shape (vertex_count, 3) or flat.
            triangles: Vertex numbers, shape (triangle_count, 3) or flat, in any order.

        Raises:
            SweepError: Not finite or enormous, of the wrong length, without area, or naming
                vertices that are not there.
        """
        flat = np.array(vertices, dtype=np.float64).reshape(-1)
        numbers = np.array(triangles, dtype=np.int64).reshape(-1)
        if len(flat) % 3 or len(numbers) % 3:
            raise SweepError(
                f"a sweep needs three numbers per vertex and three vertices per triangle; "
                f"got {len(flat)} and {len(numbers)} numbers"
            )
        points, corners = flat.reshape(-1, 3), numbers.reshape(-1, 3)
        if not 0 < len(corners) <= MAX_TRIANGLES:
            raise SweepError(f"a sweep has {len(corners)} triangles; allowed: 1 to {MAX_TRIANGLES}")
        if not np.isfinite(points).all():
            raise SweepError("a vertex of the sweep is not finite")
        if np.abs(points).max(initial=0.0) > FARTHEST:
            raise SweepError(
                f"a vertex of the sweep is {np.abs(points).max():.3g} m away; allowed: up to "
                f"{FARTHEST:g} m (are its units metres?)"
            )
        if corners.min() < 0 or corners.max() >= len(points):
            raise SweepError(
                f"a triangle of the sweep names a vertex outside 0 to {len(points) - 1}"
            )
        solid = _has_area(points[corners])
        if not solid.any():
            raise SweepError("the sweep is degenerate: none of its triangles has an area")
        return cls(points, np.ascontiguousarray(corners[solid], dtype=np.int32))

    @classmethod
    def between(cls, first: ArrayLike, second: ArrayLike) -> Sweep:
        """The strip between two poses of a blade.

        Args:
            first: Points along the blade at first [m], shape (n, 3), n at least 2.
            second: The same points later [m], shape (n, 3).
        """
        start, end = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
        n = len(start)
        i = np.arange(n - 1)
        lower = np.stack([i, i + 1, n + i], axis=1)
        upper = np.stack([i + 1, n + i + 1, n + i], axis=1)
        return cls.from_arrays(np.concatenate([start, end]), np.concatenate([lower, upper]))

    @property
    def corners(self) -> NDArray[np.float64]:
        """Corner positions of every triangle [m], shape (triangle_count, 3, 3)."""
        return self.vertices[self.triangles]

    @property
    def measured(self) -> NDArray[np.float64]:
        """Corners of the triangles that distances are to [m], shape (m, 3, 3)."""
        corners = self.corners
        return corners if self.beyond is None else np.concatenate([corners, self.beyond])

    def crossed(
        self,
        positions: NDArray[np.float64],
        items: NDArray[np.int32],
        rows: NDArray[np.int32],
        beside: Callable[[NDArray[np.int32]], NDArray[np.int32]] = lambda rows: rows,
    ) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """Which elements it crosses, those that only what is old of it crosses left out.

        Args:
            positions: Node positions [m], shape (node_rows, 3).
            items: Four nodes of each element, shape (element_rows, 4).
            rows: Elements to look at, ascending, shape (n,).
            beside: Gives these and others that count even if only what is old crosses them,
                ascending.

        Returns:
            Rows of the elements, ascending, and their crossed edges, bits in the order of
            `EDGES`.
        """
        masks = np.zeros(len(rows), dtype=np.uint8)
        new = self.triangles[self.old :]
        crossed_edges(positions, items, rows, self.vertices, new, masks)
        rows, masks = rows[masks > 0], masks[masks > 0]
        if self.old:
            rows = beside(rows)
            masks = np.zeros(len(rows), dtype=np.uint8)
            crossed_edges(positions, items, rows, self.vertices, self.triangles, masks)
            rows, masks = rows[masks > 0], masks[masks > 0]
        return rows, masks

    @property
    def box(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper corner of the bounding box of what is new [m], shape (3,) each."""
        used = self.corners[self.old :].reshape(-1, 3)
        return used.min(axis=0), used.max(axis=0)

    def moved(self, rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> Sweep:
        """The sweep after x -> rotation x + translation.

        Rotation of shape (3, 3), translation [m] of shape (3,).
        """
        beyond = None if self.beyond is None else self.beyond @ rotation.T + translation
        moved = self.vertices @ rotation.T + translation
        passed = None if self.passed is None else self.passed.moved(rotation, translation)
        return replace(self, vertices=moved, beyond=beyond, passed=passed)

    def continued(self, width: float) -> Sweep:
        """The sweep, going on straight beyond its rim.

        A node beside the rim is then as far from the surface as if the sweep already went on.

        Args:
            width: How far [m].
        """
        edges = np.concatenate([self.triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
        third = np.concatenate([self.triangles[:, k] for k in (2, 0, 1)])
        _, first, times = np.unique(
            np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True
        )
        rim = first[times == 1]
        rim = rim[_has_area(self.corners)[rim % len(self.triangles)]]
        a, b = self.vertices[edges[rim, 0]], self.vertices[edges[rim, 1]]
        along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
        out = a - self.vertices[third[rim]]
        out -= np.einsum("ij,ij->i", out, along)[:, None] * along
        out *= width / np.linalg.norm(out, axis=1, keepdims=True)
        a, b = a - width * along, b + width * along
        wings = np.stack([a, b, b + out, a, b + out, a + out], axis=1)
        return replace(self, beyond=wings.reshape(-1, 3, 3))

    def closest(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
        """Closest points of the sweep.

        Args:
            points: Positions [m], shape (n, 3).

        Returns:
            Closest points [m], shape (n, 3), their distances [m], shape (n,), and the triangles
            they lie in, shape (n,).
        """
        places = np.ascontiguousarray(points, dtype=np.float64)
        nearest, distances = np.empty_like(places), np.empty(len(places))
        which = np.zeros(len(places), dtype=np.int32)
        closest_on_sweep(places, self.measured, nearest, distances, which)
        return nearest, distances, which

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance of points from the sweep [m], shape (n,)."""
        return self.closest(points)[1]

    def signed_distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance of points [m], shape (n,); its sign is the closest triangle normal's side."""
        nearest, distances, which = self.closest(points)
        corners = self.measured[which]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return np.copysign(distances, np.einsum("ij,ij->i", normals, points - nearest))

    def fits(self, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> bool:
        """Whether it is at most `MAX_SIZE_RATIO` times as large as a box [m], corners (3,)."""
        own_lower, own_upper = self.box
        size = np.linalg.norm(own_upper - own_lower)
        return bool(size <= MAX_SIZE_RATIO * np.linalg.norm(upper - lower))

    def check_size(self, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> None:
        """Refuse a sweep that is enormous beside the organ.

        Args:
            lower: Lower corner of the organ's bounding box [m], shape (3,).
            upper: Upper corner [m], shape (3,).

        Raises:
            SweepError: The sweep is more than `MAX_SIZE_RATIO` times as large.
        """
        if not self.fits(lower, upper):
            own_lower, own_upper = self.box
            size, organ = np.linalg.norm(own_upper - own_lower), np.linalg.norm(upper - lower)
            raise SweepError(
                f"the sweep is {size:.3g} m large and the organ {organ:.3g} m; allowed: "
                f"{MAX_SIZE_RATIO:g} times the organ (are its units metres?)"
            )


def _has_area(corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    edges = np.roll(corners, -1, axis=1) - corners
    longest = np.einsum("ijk,ijk->ij", edges, edges).max(axis=1)
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return area > FLAT * longest
