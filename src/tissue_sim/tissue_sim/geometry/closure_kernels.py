"""Kernels of `geometry.closure`: a disc on a grid, and what lies over each of its points.

Grids have sample (i, j) at origin + ((i + 1/2) h, (j + 1/2) h) of the disc's plane. Triangles are
given in the disc's own coordinates: two in its plane, the third along its normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.geometry.winding import _nearest_on

Reals = NDArray[np.float64]
Flags = NDArray[np.bool_]

_ON_THE_LINE = 1e-12
"""Share of a product of distances below which a point counts as lying between two corners."""

_NO_WAY = 1e-30
"""Distance [m] that keeps a sample on a corner from dividing by zero."""


class Grid(NamedTuple):
    """A disc in samples.

    Attributes:
        origin: Corner of the grid [m], shape (2,).
        spacing: Of its samples [m].
        inside: Samples that the loop winds around, shape (nx, ny).
        heights: Of the disc over its plane [m], 0 outside, shape (nx, ny).
    """

    origin: Reals
    spacing: float
    inside: Flags
    heights: Reals


@njit(cache=True, nogil=True, error_model="numpy")
def fill_disc(loop: Reals, grid: Grid) -> None:
    """Find the samples that a loop winds around, and the height of the disc there.

    The height is the mean value interpolation of the loop's heights (Floater, Computer Aided
    Geometric Design 20, 2003): with angles a_k between corners k and k + 1 as seen from a point
    and distances r_k, corner k has the weight (tan(a_(k-1) / 2) + tan(a_k / 2)) / r_k.

    Args:
        loop: Corners, counterclockwise, in the disc's coordinates [m], shape (n, 3).
        grid: Its samples and heights are the result.
    """
    origin, spacing, inside, heights = grid
    for i in range(inside.shape[0]):
        x = origin[0] + (i + 0.5) * spacing
        for j in range(inside.shape[1]):
            y = origin[1] + (j + 0.5) * spacing
            inside[i, j] = _turns(loop, x, y) > 0
            heights[i, j] = height_at(loop, x, y) if inside[i, j] else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _turns(loop: Reals, x: float, y: float) -> int:
    """How often a loop winds around a point of the plane, counterclockwise."""
    turns, last = 0, len(loop) - 1
    ax, ay = loop[last, 0] - x, loop[last, 1] - y
    for k in range(len(loop)):
        bx, by = loop[k, 0] - x, loop[k, 1] - y
        if (ay <= 0.0) != (by <= 0.0) and (ax * by > ay * bx) == (by > 0.0):
            turns += 1 if by > 0.0 else -1
        ax, ay = bx, by
    return turns


@njit(cache=True, nogil=True, error_model="numpy")
def height_at(loop: Reals, x: float, y: float) -> float:
    """Mean value interpolation of the third coordinate of a loop's corners."""
    last = len(loop) - 1
    low, high = loop[last, 2], loop[last, 2]
    total, sum_of_heights = 0.0, 0.0
    ax, ay, az = loop[last, 0] - x, loop[last, 1] - y, loop[last, 2]
    ra = np.sqrt(ax * ax + ay * ay) + _NO_WAY
    for k in range(len(loop)):
        bx, by, bz = loop[k, 0] - x, loop[k, 1] - y, loop[k, 2]
        rb = np.sqrt(bx * bx + by * by) + _NO_WAY
        # tan(a / 2) = sin a / (1 + cos a)
        both = max(ra * rb + ax * bx + ay * by, _ON_THE_LINE * ra * rb)
        half = (ax * by - ay * bx) / both
        total += half * (1.0 / ra + 1.0 / rb)
        sum_of_heights += half * (az / ra + bz / rb)
        low, high = min(low, bz), max(high, bz)
        ax, ay, az, ra = bx, by, bz, rb
    # Where a loop crosses itself the weights may add up to next to nothing.
    height = sum_of_heights / total if total != 0.0 else 0.5 * (low + high)
    return min(max(height, low), high)


@njit(cache=True, nogil=True, error_model="numpy")
def _range(low: float, high: float, origin: float, spacing: float, count: int) -> tuple[int, int]:
    """The samples between two places along one axis."""
    first = np.ceil((low - origin) / spacing - 0.5)
    last = np.floor((high - origin) / spacing - 0.5)
    return int(max(first, 0.0)), int(min(last, count - 1.0)) + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _height_over(q: Reals, t: int, x: float, y: float) -> tuple[bool, float]:
    """Whether triangle t lies over or under a point of the plane, and its height there."""
    ux, uy = q[t, 1, 0] - q[t, 0, 0], q[t, 1, 1] - q[t, 0, 1]
    vx, vy = q[t, 2, 0] - q[t, 0, 0], q[t, 2, 1] - q[t, 0, 1]
    area = ux * vy - uy * vx
    if area == 0.0:
        return False, 0.0
    px, py = x - q[t, 0, 0], y - q[t, 0, 1]
    b, c = (px * vy - py * vx) / area, (ux * py - uy * px) / area
    if b < 0.0 or c < 0.0 or b + c > 1.0:
        return False, 0.0
    return True, q[t, 0, 2] + b * (q[t, 1, 2] - q[t, 0, 2]) + c * (q[t, 2, 2] - q[t, 0, 2])


@njit(cache=True, nogil=True, error_model="numpy")
def cover(
    triangles: Reals,
    owners: NDArray[np.int32],
    margins: Reals,
    depth: float,
    grid: Grid,
    covered: NDArray[np.int32],
) -> None:
    """Mark the samples that triangles cover with the number of the first owner that does.

    Args:
        triangles: Corners in the disc's coordinates [m], shape (t, 3, 3).
        owners: Whose each triangle is, from 1, shape (t,).
        margins: Distance from each triangle within which a sample counts as covered [m].
        depth: Height over and under the disc within which it covers [m].
        grid: The disc.
        covered: Result, 0 where nothing covers; 0 on entry, shape (nx, ny).
    """
    origin, spacing, inside, heights = grid
    for t in range(len(triangles)):
        margin = margins[t]
        x, y = triangles[t, :, 0], triangles[t, :, 1]
        i0, i1 = _range(x.min() - margin, x.max() + margin, origin[0], spacing, inside.shape[0])
        j0, j1 = _range(y.min() - margin, y.max() + margin, origin[1], spacing, inside.shape[1])
        for i in range(i0, i1):
            px = origin[0] + (i + 0.5) * spacing
            for j in range(j0, j1):
                if not inside[i, j] or covered[i, j] != 0:
                    continue
                py = origin[1] + (j + 0.5) * spacing
                over, height = _height_over(triangles, t, px, py)
                if over and abs(height - heights[i, j]) <= depth:
                    covered[i, j] = owners[t]
                elif margin > 0.0:
                    square, _, _ = _nearest_on(triangles, t, px, py, heights[i, j])
                    if square <= margin * margin:
                        covered[i, j] = owners[t]


@njit(cache=True, nogil=True, error_model="numpy")
def find_exits(triangles: Reals, grid: Grid, above: Reals, below: Reals) -> None:
    """Find the surface next above and next below each sample, and whether it is left there.

    Args:
        triangles: Corners in the disc's coordinates, normals out of the tissue [m], (t, 3, 3).
        grid: The disc.
        above: Result: distance to the next surface above [m], negative if tissue begins there and
            does not end; infinite where there is none, shape (nx, ny).
        below: The same below.
    """
    origin, spacing, inside, heights = grid
    above[:], below[:] = np.inf, np.inf
    for t in range(len(triangles)):
        x, y = triangles[t, :, 0], triangles[t, :, 1]
        i0, i1 = _range(x.min(), x.max(), origin[0], spacing, inside.shape[0])
        j0, j1 = _range(y.min(), y.max(), origin[1], spacing, inside.shape[1])
        up = (x[1] - x[0]) * (y[2] - y[0]) > (x[2] - x[0]) * (y[1] - y[0])
        for i in range(i0, i1):
            for j in range(j0, j1):
                if not inside[i, j]:
                    continue
                px, py = origin[0] + (i + 0.5) * spacing, origin[1] + (j + 0.5) * spacing
                over, height = _height_over(triangles, t, px, py)
                if not over:
                    continue
                away = height - heights[i, j]
                if away >= 0.0 and away < abs(above[i, j]):
                    above[i, j] = away if up else -away
                if away < 0.0 and -away < abs(below[i, j]):
                    below[i, j] = away if up else -away


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_places(
    triangles: Reals, places: Reals, distances: Reals, nearest: NDArray[np.int64], weights: Reals
) -> None:
    """Find the closest point of some triangles to each place.

    Args:
        triangles: Corners [m], shape (t, 3, 3).
        places: Places [m], shape (n, 3).
        distances: Result [m]; infinite without triangles, shape (n,).
        nearest: Result: the triangle; -1 without triangles, shape (n,).
        weights: Result: barycentric weights of its corners, shape (n, 3).
    """
    centres, radii = np.empty((len(triangles), 3)), np.empty(len(triangles))
    for t in range(len(triangles)):
        radii[t] = 0.0
        for axis in range(3):
            centres[t, axis] = triangles[t, :, axis].sum() / 3.0
        for corner in range(3):
            away = triangles[t, corner] - centres[t]
            radii[t] = max(radii[t], np.sqrt((away * away).sum()))
    for k in range(len(places)):
        x, y, z = places[k, 0], places[k, 1], places[k, 2]
        best, triangle, second, third = np.inf, -1, 0.0, 0.0
        for t in range(len(triangles)):
            dx, dy, dz = centres[t, 0] - x, centres[t, 1] - y, centres[t, 2] - z
            # Most are farther than the closest so far, whatever their corners are.
            least = np.sqrt(dx * dx + dy * dy + dz * dz) - radii[t]
            if least > 0.0 and least * least >= best:
                continue
            square, v, w = _nearest_on(triangles, t, x, y, z)
            if square < best:
                best, triangle, second, third = square, t, v, w
        distances[k], nearest[k] = np.sqrt(best), triangle
        weights[k, 0], weights[k, 1], weights[k, 2] = 1.0 - second - third, second, third
