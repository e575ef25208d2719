"""Outlines: flat polygons without crossings, and points spread evenly along them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MOST_CORNERS = 1000
"""Most corners of an outline."""

CLOSEST, WIDEST = 1e-6, 1.0
"""Smallest distance of two successive corners, and largest extent of an outline [m]."""

FLATNESS = 0.01
"""Largest distance of a corner from the common plane, as a share of the outline's extent."""

SMALLEST_AREA = 1e-8
"""Smallest area of an outline [m^2]."""

SHARP = 25.0
"""A corner that turns by more degrees stays a corner; others may lie between two points."""

AREA_TOLERANCE = 0.02
"""How much the area within points along a smooth outline may differ from the outline's."""

_NARROWEST = 0.1
"""Sides that fold back by an angle below this [degrees] enclose nothing."""

_FINEST = 0.1
"""Spacing at which a curved outline is followed corner by corner, as a share of what was asked."""


class OutlineError(ValueError):
    """An outline that encloses no patch: it has no area, repeats a corner, ..."""


class CrossingError(OutlineError):
    """An outline that crosses itself."""


class NotFlatError(OutlineError):
    """An outline whose corners have no common plane."""


@dataclass(frozen=True)
class Plane:
    """A plane with axes of its own.

    Attributes:
        origin: Its origin [m], shape (3,).
        axes: Unit vectors x, y and normal as rows, right-handed, shape (3, 3).
    """

    origin: NDArray[np.float64]
    axes: NDArray[np.float64]

    def to_space(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the plane, shape (n, 2), or near it, shape (n, 3), in space [m]."""
        return np.asarray(self.origin + points @ self.axes[: points.shape[1]])

    def to_plane(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points in space in the plane's axes, the last one the height above it [m], (n, 3)."""
        return np.asarray((points - self.origin) @ self.axes.T)


def plane_of(corners: NDArray[np.float64]) -> tuple[Plane, NDArray[np.float64]]:
    """The plane of an outline that is given in space.

    Args:
        corners: Corners [m], shape (n, 3). The outline goes round the plane's normal by the right
            hand.

    Returns:
        The plane, through the mean of the corners, and the corners in it [m], shape (n, 2).

    Raises:
        OutlineError: The corners have no common plane within `FLATNESS` (`NotFlatError`), are too
            few or too many, not finite, or enclose no area.
    """
    _refuse_count(corners)
    middle = corners.mean(axis=0)
    spread = corners - middle
    extent = float(np.linalg.norm(np.ptp(corners, axis=0)))
    normal = np.cross(spread, np.roll(spread, -1, axis=0)).sum(axis=0)
    length = float(np.linalg.norm(normal))
    if not length > 1e-9 * max(extent, CLOSEST) ** 2:
        raise OutlineError("the outline encloses no area")
    normal /= length
    # The plane's x axis goes along the longest side, so that flat patches look the same anywhere.
    side = np.roll(corners, -1, axis=0) - corners
    x = side[np.argmax(np.linalg.norm(side, axis=1))]
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    plane = Plane(middle, np.stack([x, np.cross(normal, x), normal]))
    local = plane.to_plane(corners)
    off = float(np.abs(local[:, 2]).max())
    if off > FLATNESS * extent:
        raise NotFlatError(
            f"the outline is not flat: a corner is {1e3 * off:.3g} mm off the plane of the others; "
            f"allowed: {1e3 * FLATNESS * extent:.3g} mm ({100 * FLATNESS:g} % of its extent)"
        )
    return plane, np.ascontiguousarray(local[:, :2])


def checked_outline(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """An outline that encloses a patch, counterclockwise.

    Args:
        corners: Corners in the plane in either direction, the first one not repeated [m],
            shape (n, 2).

    Raises:
        OutlineError: Naming what is wrong and what is allowed; `CrossingError` if it crosses
            itself.
    """
    _refuse_count(corners)
    extent = float(np.ptp(corners, axis=0).max())
    if extent > WIDEST:
        raise OutlineError(f"the outline is {extent:.3g} m wide; allowed: up to {WIDEST:g} m")
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    if (sides < CLOSEST).any():
        at = int(np.argmin(sides))
        raise OutlineError(
            f"corners {at} and {(at + 1) % len(corners)} are at the same place; allowed: at least "
            f"{1e6 * CLOSEST:g} micrometres apart, and the first corner is not repeated at the end"
        )
    if (pair := _crossing(corners)) is not None:
        raise CrossingError(f"the outline crosses itself: sides {pair[0]} and {pair[1]} meet")
    area = signed_area(corners)
    if abs(area) < SMALLEST_AREA:
        raise OutlineError(
            f"the outline encloses {1e6 * abs(area):.3g} mm^2; allowed: at least "
            f"{1e6 * SMALLEST_AREA:g} mm^2"
        )
    return corners if area > 0.0 else np.ascontiguousarray(corners[::-1])


def signed_area(corners: NDArray[np.float64]) -> float:
    """Area within a polygon [m^2], positive if it goes round counterclockwise."""
    x, y = (corners - corners[0]).T
    return float(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def perimeter(corners: NDArray[np.float64]) -> float:
    """Length of a closed line [m]."""
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).sum())


def within(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points lie within a polygon, shape (len(points),)."""
    inside = np.zeros(len(points), dtype=np.bool_)
    x, y = points.T
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if a[1] == b[1]:
            continue
        crosses = (a[1] > y) != (b[1] > y)
        inside ^= crosses & (x < a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]))
    return inside


def distance_from(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of points from a closed line [m], shape (len(points),)."""
    nearest = np.full(len(points), np.inf)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side = b - a
        share = np.clip((points - a) @ side / (side @ side), 0.0, 1.0)
        np.minimum(nearest, np.hypot(*(points - a - share[:, None] * side).T), out=nearest)
    return nearest


def spread_along(outline: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Points spread evenly along a checked outline, sharp corners among them.

    Where an outline of many corners is curved, points come closer until the area within them is
    that of the outline within `AREA_TOLERANCE`.

    Args:
        outline: Corners, counterclockwise [m], shape (n, 2).
        spacing: Wanted distance of points along it [m].

    Returns:
        Points on the outline [m], shape (m, 2).
    """
    whole = signed_area(outline)
    step = spacing
    while step > _FINEST * spacing:
        points = _spread(outline, np.flatnonzero(_turns(outline) > SHARP), step)
        good = len(points) >= 3 and abs(signed_area(points) - whole) <= AREA_TOLERANCE * whole
        if good and _crossing(points) is None:
            return points
        step *= 0.8
    return along_sides(outline, spacing)


def along_sides(outline: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Points along each side of an outline, all corners among them; as `spread_along`."""
    return _spread(outline, np.arange(len(outline)), spacing)


def _spread(
    outline: NDArray[np.float64], kept: NDArray[np.intp], spacing: float
) -> NDArray[np.float64]:
    """Points along an outline, those between two corners that are kept at equal distances."""
    kept = kept if len(kept) else np.array([0])
    turned = np.roll(outline, -kept[0], axis=0)
    closed = np.concatenate([turned, turned[:1]])
    ways = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
    ends = np.append(ways[kept - kept[0]], ways[-1])
    places = []
    for low, high in itertools.pairwise(ends):
        pieces = max(round((high - low) / spacing), 1)
        places.append(low + (high - low) * np.arange(pieces) / pieces)
    at = np.concatenate(places)
    return np.stack([np.interp(at, ways, closed[:, axis]) for axis in range(2)], axis=1)


def _turns(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much the outline turns at each corner [degrees], shape (n,)."""
    after = np.roll(outline, -1, axis=0) - outline
    before = np.roll(after, 1, axis=0)
    turned = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return np.degrees(np.abs(np.arctan2(turned, (before * after).sum(axis=1))))


def _refuse_count(corners: NDArray[np.float64]) -> None:
    if not np.isfinite(corners).all():
        raise OutlineError("a corner of the outline is not finite")
    if not 3 <= len(corners) <= MOST_CORNERS:
        raise OutlineError(f"the outline has {len(corners)} corners; allowed: 3 to {MOST_CORNERS}")


def _crossing(corners: NDArray[np.float64]) -> tuple[int, int] | None:
    """Two sides that cross, touch or fold back on each other; None: there are none."""
    count = len(corners)
    a, b = corners, np.roll(corners, -1, axis=0)
    folds = np.flatnonzero(_turns(corners) > 180.0 - _NARROWEST)
    if len(folds):
        return (int(folds[0]) - 1) % count, int(folds[0])
    small = 1e-12 * float(np.ptp(corners, axis=0).max()) ** 2

    def side_of(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
        """On which side of each line (a, b), as rows, the points p and q lie."""
        edge = b - a
        first, second = p[None] - a[:, None], q[None] - a[:, None]
        one = edge[:, None, 0] * first[..., 1] - edge[:, None, 1] * first[..., 0]
        two = edge[:, None, 0] * second[..., 1] - edge[:, None, 1] * second[..., 0]
        one[np.abs(one) < small] = 0.0
        two[np.abs(two) < small] = 0.0
        return np.asarray(np.sign(one) * np.sign(two))

    parted = side_of(a, b)
    low, high = np.minimum(a, b), np.maximum(a, b)
    near = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2)
    meet = (parted <= 0.0) & (parted.T <= 0.0) & near
    rows = np.arange(count)
    for offset in (0, 1, -1):
        meet[rows, (rows + offset) % count] = False
    found = np.argwhere(meet)
    return (int(found[0, 0]), int(found[0, 1])) if len(found) else None
