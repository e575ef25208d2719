"""Triangles that fill an outline in the plane, with holes, by cutting off its ears."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Ring = NDArray[np.int64]


def signed_area(ring: Reals) -> float:
    """Area inside a ring of points, shape (n, 2); negative if it runs clockwise."""
    x, y = ring.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def inside_polygon(points: Reals, ring: Reals) -> NDArray[np.bool_]:
    """Which points lie inside a ring, shape (n,): a ray crosses it an odd number of times."""
    a, b = ring, np.roll(ring, -1, axis=0)
    x, y = points[:, None, 0], points[:, None, 1]
    spans = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return np.asarray((spans & (x < at)).sum(axis=1) % 2 == 1)


def fill_polygon(points: Reals, outer: Ring, holes: list[Ring]) -> NDArray[np.int64] | None:
    """Triangles that fill an outline with holes.

    Args:
        points: Places in the plane, shape (n, 2).
        outer: Rows of the outline, in turn.
        holes: Rows of each hole.

    Returns:
        Rows of the corners, counterclockwise, shape (m, 3); None if the outline crosses itself so
        that it has no ear somewhere.
    """
    ring = outer if signed_area(points[outer]) > 0.0 else outer[::-1]
    holes = [hole if signed_area(points[hole]) < 0.0 else hole[::-1] for hole in holes]
    for hole in sorted(holes, key=lambda hole: -float(points[hole, 0].max())):
        ring = _bridged(points, ring, hole)
    triangles = np.empty((max(len(ring) - 2, 0), 3), dtype=np.int64)
    count = _clip(points, np.ascontiguousarray(ring), triangles)
    return triangles[:count] if count == len(triangles) else None


def _bridged(points: Reals, ring: Ring, hole: Ring) -> Ring:
    """The ring with a hole joined to it by a line there and back that crosses neither."""
    pairs = points[ring][:, None] - points[hole][None]
    order = np.argsort((pairs**2).sum(axis=2), axis=None)
    walls = np.concatenate([np.stack([r, np.roll(r, -1)], axis=1) for r in (ring, hole)])
    for flat in order[: 4 * len(hole)]:
        i, j = divmod(int(flat), len(hole))
        if not _crosses(points, int(ring[i]), int(hole[j]), walls):
            break
    else:
        i, j = divmod(int(order[0]), len(hole))
    turned = np.roll(hole, -j)
    return np.concatenate([ring[: i + 1], turned, turned[:1], ring[i:]])


def _crosses(points: Reals, p: int, q: int, walls: NDArray[np.int64]) -> bool:
    own = (walls == p).any(axis=1) | (walls == q).any(axis=1)
    a, b = points[walls[~own, 0]], points[walls[~own, 1]]

    def turns(u: Reals, v: Reals, w: Reals) -> Reals:
        along, to = v - u, w - u
        return np.asarray(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0])

    s, t = points[p], points[q]
    apart = turns(s, t, a) * turns(s, t, b) < 0.0
    return bool((apart & (turns(a, b, s) * turns(a, b, t) < 0.0)).any())


@njit(cache=True, nogil=True)
def _turn(points, a, b, c):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return (points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1]) - (
        points[b, 1] - points[a, 1]
    ) * (points[c, 0] - points[a, 0])


@njit(cache=True, nogil=True)
def _is_ear(points: Reals, ring: Ring, n: int, k: int) -> bool:
    a, b, c = ring[(k - 1) % n], ring[k], ring[(k + 1) % n]
    if _turn(points, a, b, c) <= 0.0:
        return False
    for m in range(n):
        p = ring[m]
        if p in (a, b, c):
            continue
        x, y = points[p]
        same = False
        for q in (a, b, c):
            same = same or (points[q, 0] == x and points[q, 1] == y)
        if same:
            continue
        if (
            _turn(points, a, b, p) >= 0.0
            and _turn(points, b, c, p) >= 0.0
            and _turn(points, c, a, p) >= 0.0
        ):
            return False
    return True


@njit(cache=True, nogil=True)
def _worth(points: Reals, ring: Ring, n: int, k: int) -> float:
    """How short the line that cuts off a corner is."""
    a, c = ring[(k - 1) % n], ring[(k + 1) % n]
    return (points[a, 0] - points[c, 0]) ** 2 + (points[a, 1] - points[c, 1]) ** 2


@njit(cache=True, nogil=True)
def _clip(points: Reals, ring: Ring, triangles: NDArray[np.int64]) -> int:
    """Cut off the ear with the shortest line until three corners are left; how many were."""
    ring = ring.copy()
    n, count = ring.shape[0], 0
    while n > 2:
        best, shortest = -1, np.inf
        for k in range(n):
            length = _worth(points, ring, n, k)
            if length < shortest and _is_ear(points, ring, n, k):
                best, shortest = k, length
        if best < 0:
            # What is left has no area but for rounding: corners in a line.
            for k in range(n):
                flatness = abs(_turn(points, ring[(k - 1) % n], ring[k], ring[(k + 1) % n]))
                if flatness < shortest:
                    best, shortest = k, flatness
            if shortest > 1e-9 * _worth(points, ring, n, best):
                return count
        triangles[count, 0] = ring[(best - 1) % n]
        triangles[count, 1] = ring[best]
        triangles[count, 2] = ring[(best + 1) % n]
        count += 1
        for m in range(best, n - 1):
            ring[m] = ring[m + 1]
        n -= 1
    return count
