"""Closed lines in space, and how the places of one are laid opposite those of another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Reals = NDArray[np.float64]

STARTS = 360
"""Places on a line that are tried as the one opposite the other's first."""

FINENESS = 4000
"""Places of a line that are looked at to find how far along it another place is."""


def shares_of(line: Reals) -> Reals:
    """How far along a closed line each of its corners is, as a share of its length, (n,)."""
    sides = np.linalg.norm(np.roll(line, -1, axis=0) - line, axis=1)
    return np.append(0.0, np.cumsum(sides)[:-1]) / max(float(sides.sum()), 1e-300)


def along(line: Reals, shares: Reals) -> Reals:
    """Places so far along a closed line [m], shares of its length from 0 to 1, shape (k, 3)."""
    corners = np.concatenate([line, line[:1]])
    reached = np.append(shares_of(line), 1.0)
    return np.stack([np.interp(shares, reached, corners[:, axis]) for axis in range(3)], axis=1)


def closest_shares(shares: Reals, wanted: Reals) -> NDArray[np.int64]:
    """Which of some places around a line is closest to each wanted one, by their shares, (k,)."""
    away = np.abs(shares[None] - wanted[:, None])
    return np.asarray(np.minimum(away, 1.0 - away).argmin(axis=1), dtype=np.int64)


@dataclass(frozen=True)
class Match:
    """A loop laid opposite a line: as far along the one as along the other.

    Attributes:
        loop: Corners of the loop in the sense of the line [m], shape (m, 3).
        start: Share of the loop that is opposite the beginning of the line.
        cost: Mean square of the distance between opposite places [m^2].
    """

    loop: Reals
    start: float
    cost: float

    def opposite(self, shares: Reals) -> Reals:
        """Places of the loop [m] opposite places so far along the line, shape (k, 3)."""
        return along(self.loop, (self.start + shares) % 1.0)

    def shares_at(self, places: Reals) -> Reals:
        """How far along the line is opposite those places of the loop that are closest, (k,)."""
        fine = np.arange(FINENESS) / FINENESS
        _, nearest = cKDTree(along(self.loop, fine)).query(places)
        return np.asarray((fine[nearest] - self.start) % 1.0)


def matched(line: Reals, loop: Reals, count: int) -> Match:
    """Lay a loop opposite a line.

    Of all beginnings and both senses of the loop that is taken which gives the least sum of squares
    of distances.

    Args:
        line: Corners of a closed line [m], shape (n, 3).
        loop: Corners of a closed loop [m], shape (m, 3).
        count: Places of the line that are looked at.
    """
    shares = np.arange(count) / count
    starts = np.arange(STARTS) / STARTS
    here = along(line, shares)
    found = []
    for corners in (loop, loop[::-1]):
        there = along(corners, ((starts[:, None] + shares) % 1.0).ravel())
        costs = np.square(there.reshape(STARTS, count, 3) - here).sum(axis=2).mean(axis=1)
        first = int(np.argmin(costs))
        found.append(Match(corners, float(starts[first]), float(costs[first])))
    return min(found, key=lambda match: match.cost)
