"""Signed-distance primitives: ellipsoid, tube, half space, smooth minimum and maximum.

Every function takes points of shape (n, 3) and answers with n signed distances, negative inside, in
the points' unit. Only additions, multiplications, divisions and square roots are
used, in a fixed order: they are rounded the same way everywhere (IEEE 754), so a shape made of
them has the same bits on every machine.

References:
    I. Quilez, distance functions, https://iquilezles.org/articles/distfunctions/ (formulas of the
    ellipsoid's first-order distance and of the quadratic smooth minimum).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

Distances = NDArray[np.float64]
Points = NDArray[np.float64]

_STRIP = 256
"""Points for which it is decided together which parts of a tube can be the nearest."""

_SLACK = 1e-9
"""Share by which bounds are widened, for rounding."""


def dot(a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
    """Scalar product over the last axis, summed in a fixed order."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def unit(vector: ArrayLike) -> NDArray[np.float64]:
    """Vector of length one in the same direction."""
    vector = np.asarray(vector, dtype=np.float64)
    return vector / np.sqrt(dot(vector, vector))


def axes_along(direction: ArrayLike, hint: ArrayLike) -> NDArray[np.float64]:
    """Right-handed orthonormal axes, rows: third along `direction`, first close to `hint`."""
    third = unit(direction)
    hint = np.asarray(hint, dtype=np.float64)
    first = unit(hint - dot(hint, third) * third)
    return np.array([first, np.cross(third, first), third])


def ellipsoid(
    points: Points, centre: ArrayLike, radii: ArrayLike, axes: ArrayLike | None = None
) -> Distances:
    """First-order distance to an ellipsoid, exact on its surface and for a sphere.

    Args:
        points: Shape (n, 3).
        centre: Shape (3,).
        radii: Half axes, shape (3,).
        axes: Directions of the half axes as orthonormal rows, the coordinate axes if left out.
    """
    local = points - np.asarray(centre, dtype=np.float64)
    if axes is not None:
        local = np.stack([dot(local, axis) for axis in np.asarray(axes)], axis=-1)
    scaled = local / np.asarray(radii, dtype=np.float64)
    gradient = scaled / np.asarray(radii, dtype=np.float64)
    level = np.sqrt(dot(scaled, scaled))
    slope = np.sqrt(dot(gradient, gradient))
    smallest = np.min(np.asarray(radii, dtype=np.float64))
    at_centre = level < 1e-9
    return np.where(at_centre, -smallest, level * (level - 1.0) / np.where(at_centre, 1.0, slope))


@njit(cache=True, nogil=True, error_model="numpy")
def _distance_to_segment(x: float, y: float, z: float, start: Points, end: Points) -> float:
    ax, ay, az = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    px, py, pz = x - start[0], y - start[1], z - start[2]
    share = (px * ax + py * ay + pz * az) / (ax * ax + ay * ay + az * az)
    share = min(max(share, 0.0), 1.0)
    px, py, pz = px - share * ax, py - share * ay, pz - share * az
    return float(np.sqrt(px * px + py * py + pz * pz))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"nnan", "nsz"})
def _middle_and_half(column: Distances) -> tuple[float, float]:
    low = high = column[0]
    for p in range(1, len(column)):
        low, high = min(low, column[p]), max(high, column[p])
    return 0.5 * (low + high), 0.5 * (high - low)


@njit(cache=True, nogil=True, error_model="numpy")
def _bounds(
    x: Distances, y: Distances, z: Distances, line: Points, radii: Distances, least: Distances
) -> float:
    """Bound the distances of points near each other to the cones of a tube.

    A point is at most half the diagonal of the points' box away from the middle of the box.

    Args:
        x: Places along x, shape (n,), n at least 1.
        y: Along y.
        z: Along z.
        line: Centre line, shape (k, 3).
        radii: One per line point.
        least: A lower bound of the distance to each cone is written here, shape (k - 1,).

    Returns:
        What the distance to the nearest cone does not exceed.
    """
    (mx, hx), (my, hy), (mz, hz) = _middle_and_half(x), _middle_and_half(y), _middle_and_half(z)
    reach, most = np.sqrt(hx * hx + hy * hy + hz * hz), np.inf
    for s in range(len(line) - 1):
        distance = _distance_to_segment(mx, my, mz, line[s], line[s + 1])
        least[s] = distance - reach - max(radii[s], radii[s + 1])
        most = min(most, distance + reach - min(radii[s], radii[s + 1]))
    return most + _SLACK * (abs(most) + reach + np.max(radii))


@njit(cache=True, nogil=True, error_model="numpy")
def _tube_kernel(points: Points, line: Points, radii: Distances, out: Distances) -> None:
    """Write the least distance to the cones between neighbouring line points to `out`.

    Points are taken a strip at a time; a cone that is farther from the whole strip than another
    one cannot be the nearest and is passed over. The inner loop runs over a strip's columns: it is
    done in vectors.
    """
    columns, least = np.empty((4, _STRIP)), np.empty(len(line) - 1)
    for first in range(0, len(points), _STRIP):
        count = min(_STRIP, len(points) - first)
        x, y, z, nearest = (
            columns[0, :count], columns[1, :count], columns[2, :count], columns[3, :count],
        )  # fmt: skip
        for p in range(count):
            x[p], y[p], z[p] = points[first + p, 0], points[first + p, 1], points[first + p, 2]
            nearest[p] = np.inf
        most = _bounds(x, y, z, line, radii, least)
        for s in range(len(line) - 1):
            if least[s] > most:
                continue
            sx, sy, sz = line[s, 0], line[s, 1], line[s, 2]
            ax, ay, az = line[s + 1, 0] - sx, line[s + 1, 1] - sy, line[s + 1, 2] - sz
            square = ax * ax + ay * ay + az * az
            radius, slope = radii[s], radii[s + 1] - radii[s]
            for p in range(count):
                px, py, pz = x[p] - sx, y[p] - sy, z[p] - sz
                share = (px * ax + py * ay + pz * az) / square
                share = min(max(share, 0.0), 1.0)
                px, py, pz = px - share * ax, py - share * ay, pz - share * az
                gap = np.sqrt(px * px + py * py + pz * pz) - (radius + share * slope)
                nearest[p] = min(nearest[p], gap)
        out[first : first + count] = nearest


def tube(points: Points, line: ArrayLike, radius: ArrayLike) -> Distances:
    """Distance to a tube with round ends.

    Args:
        points: Shape (n, 3).
        line: Centre line, shape (k, 3), k at least 2.
        radius: One radius, or one per line point, linear in between.
    """
    line = np.ascontiguousarray(line, dtype=np.float64)
    if line.ndim != 2 or line.shape[0] < 2 or line.shape[1] != 3:
        raise ValueError(f"a centre line has shape (2 or more, 3), not {line.shape}")
    radii = np.full(len(line), radius, dtype=np.float64)
    out = np.empty(len(points))
    _tube_kernel(np.ascontiguousarray(points, dtype=np.float64), line, radii, out)
    return out


def capsule(points: Points, start: ArrayLike, end: ArrayLike, radius: ArrayLike) -> Distances:
    """Distance to a straight tube with round ends; two radii make it tapered."""
    return tube(points, np.array([start, end], dtype=np.float64), radius)


def half_space(points: Points, place: ArrayLike, normal: ArrayLike) -> Distances:
    """Distance to the half space behind a plane; `normal` points out of it."""
    return dot(points - np.asarray(place, dtype=np.float64), unit(normal))


def smooth_min(a: Distances, b: Distances, width: float) -> Distances:
    """Union with a fillet: the minimum, rounded where the two differ by less than `width`."""
    if width <= 0.0:
        return np.minimum(a, b)
    blend = np.maximum(width - np.abs(a - b), 0.0)
    return np.minimum(a, b) - blend * blend / (4.0 * width)


def smooth_max(a: Distances, b: Distances, width: float) -> Distances:
    """Intersection with a rounded edge."""
    return -smooth_min(-a, -b, width)


def union(shapes: Iterable[Distances], width: float) -> Distances:
    """Smooth union of several shapes, taken in the given order."""
    return reduce(lambda a, b: smooth_min(a, b, width), shapes)


def carve(shape: Distances, tool: Distances, width: float) -> Distances:
    """Take `tool` away from `shape`, with a rounded edge."""
    return smooth_max(shape, -tool, width)


def spline(control: Sequence[ArrayLike] | NDArray[np.float64], per_span: int) -> Points:
    """Catmull-Rom curve through control points: smooth, with continuous tangents.

    Args:
        control: Points (or points with a radius) to pass through, shape (k, m), k at least 2.
        per_span: Straight pieces per span.

    Returns:
        Curve points, shape ((k - 1) * per_span + 1, m).
    """
    knots = np.asarray(control, dtype=np.float64)
    if len(knots) < 2:
        raise ValueError("a curve needs at least two control points")
    padded = np.concatenate([2 * knots[:1] - knots[1:2], knots, 2 * knots[-1:] - knots[-2:-1]])
    t = (np.arange(per_span) / per_span)[:, None]
    spans = []
    for p0, p1, p2, p3 in zip(padded[:-3], padded[1:-2], padded[2:-1], padded[3:], strict=True):
        quadratic = 2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3
        cubic = 3.0 * p1 - p0 - 3.0 * p2 + p3
        spans.append(p1 + 0.5 * t * ((p2 - p0) + t * (quadratic + t * cubic)))
    return np.concatenate([*spans, knots[-1:]])
