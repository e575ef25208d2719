"""Planning to sew a patch in: stitches spread along its rim and the edge of a hole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cut_service.suturing import (
    MOST_STITCHES,
    REACH,
    Sewing,
    SutureCode,
    SutureError,
    refuse_bad_numbers,
    stitched,
)
from tissue_sim.geometry.closure import LoopError, checked_loop, perimeter
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.holes import surface_of
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.patch_rims import Rim, rims_of
from tissue_sim.geometry.patches import Patch

Reals = NDArray[np.float64]
Rows = NDArray[np.int64]

STARTS = 360
"""Places on the edge of a hole that are tried as the first stitch's."""

FEWEST = 3
"""Fewest stitches of a rim."""


def patch_of(mesh: Mesh, patch_id: int, name: str) -> Patch:
    """The patch that is meant: by id, by name, or the only one there is.

    Raises:
        SutureError: There is no such patch, or several and none is named.
    """
    there = list(mesh.patches)
    known = ", ".join(f"{patch.id} ({patch.name})" for patch in there) or "none"
    if patch_id:
        found = [patch for patch in there if patch.id == patch_id and name in ("", patch.name)]
    else:
        found = [patch for patch in there if name in ("", patch.name)]
    if len(found) == 1:
        return found[0]
    if found:
        why = "the organ has several patches and none is named"
    else:
        why = f"there is no patch {patch_id or name or 'to be sewn'}"
    raise SutureError(SutureCode.UNKNOWN_PATCH, f"{why}; patches: {known}")


@dataclass(frozen=True)
class _Proposal:
    """Stitches from one rim of a patch.

    Attributes:
        ends: Node rows of patch and tissue of each, shape (n, 2).
        wanted_at: Places where the tissue is wanted [m], shape (n, 3).
        away: How far the tissue is from there [m], shape (n,).
        cost: Sum of squares of what lies between rim and tissue [m^2].
    """

    ends: Rows
    wanted_at: Reals
    away: Reals
    cost: float


def plan_rim(mesh: Mesh, shape: NDArray[np.floating], patch: Patch, wanted: Sewing) -> TopologyEdit:
    """Plan stitches around a patch on a deformed shape. Nothing is changed.

    Of the two sides of a patch the one whose rim is closer is sewn; of several rims, as a patch
    has that is in parts or has a hole, the longest.

    Args:
        mesh: The mesh, at the version that `shape` belongs to.
        shape: Current node positions [m], shape (node_rows, 3).
        patch: What is sewn in.
        wanted: Its positions are a closed loop around the hole, or none: then each place of the rim
            is sewn to the closest tissue of no patch, which must be within its reach.

    Raises:
        SutureError: A number is not allowed, the patch has no rim, or there is no tissue within
            reach.
    """
    refuse_bad_numbers(wanted)
    if not wanted.spacing > 0.0:
        raise SutureError(SutureCode.INVALID, "a rim needs a spacing of stitches, more than 0 m")
    places = np.asarray(shape, dtype=np.float64)
    loop = _checked(wanted.positions) if len(wanted.positions) else None
    tissue = np.unique(surface_of(mesh).tissue).astype(np.int64)
    if not len(tissue):
        raise SutureError(SutureCode.NOTHING_THERE, "there is no tissue besides patches")
    tree = cKDTree(places[tissue])
    found = []
    for rim in _longest_of_each_side(mesh, patch):
        at = _spread(places, rim, loop, wanted.spacing)
        there, cost = (places[at], 0.0) if loop is None else matched(places[at], loop)
        distances, nearest = tree.query(there)
        away = np.asarray(distances, dtype=np.float64)
        cost += float(np.square(away).sum())
        found.append(_Proposal(np.stack([at, tissue[nearest]], axis=1), there, away, cost))
    best = min(found, key=lambda proposal: proposal.cost)
    _refuse_far(best, wanted.reach or REACH)
    return stitched(mesh, places, _each_once(best.ends), wanted, closed=True)


def matched(line: Reals, loop: Reals) -> tuple[Reals, float]:
    """Places spread evenly along a loop, each opposite a place of a line that runs around it too.

    Of all starting points and both directions that with the least sum of squares of distances.

    Args:
        line: Places in turn [m], shape (n, 3).
        loop: Corners of a closed loop [m], shape (m, 3).

    Returns:
        Places on the loop [m], shape (n, 3), and that sum [m^2].
    """
    whole, count = perimeter(loop), len(line)
    starts = whole * np.arange(STARTS) / STARTS
    best, cost = line, np.inf
    for corners in (loop, loop[::-1]):
        ways = (starts[:, None] + whole * np.arange(count) / count) % whole
        places = along(corners, ways.ravel()).reshape(STARTS, count, 3)
        costs = np.square(places - line).sum(axis=(1, 2))
        first = int(np.argmin(costs))
        if costs[first] < cost:
            best, cost = places[first], float(costs[first])
    return best, cost


def along(loop: Reals, ways: Reals) -> Reals:
    """Places at so much way [m] along a closed loop, shape (k, 3)."""
    corners = np.concatenate([loop, loop[:1]])
    sides = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    reached = np.append(0.0, np.cumsum(sides))
    return np.stack([np.interp(ways, reached, corners[:, axis]) for axis in range(3)], axis=1)


def _checked(positions: Reals) -> Reals:
    try:
        return checked_loop(positions)
    except LoopError as error:
        raise SutureError(SutureCode.INVALID, str(error)) from None


def _longest_of_each_side(mesh: Mesh, patch: Patch) -> list[Rim]:
    rims = rims_of(mesh, patch)
    if not rims:
        raise SutureError(
            SutureCode.NO_RIM,
            f"{patch.name} has no rim that runs around: nothing is left of it but pieces",
        )
    sides = [[rim for rim in rims if rim.upper == upper][:1] for upper in (True, False)]
    return [rim for side in sides for rim in side]


def _spread(places: Reals, rim: Rim, loop: Reals | None, spacing: float) -> Rows:
    """Nodes of the rim that are closest to places spread evenly along it, in turn, shape (n,)."""
    line = places[rim.nodes]
    way = perimeter(line)
    longest = max(way, perimeter(loop)) if loop is not None else way
    count = max(round(min(longest / spacing, 2.0 * MOST_STITCHES)), FEWEST)
    if count > MOST_STITCHES:
        raise SutureError(
            SutureCode.INVALID, f"{count} stitches or more; allowed: up to {MOST_STITCHES}"
        )
    _, nearest = cKDTree(line).query(along(line, way * np.arange(count) / count))
    return np.asarray(rim.nodes[nearest])


def _refuse_far(proposal: _Proposal, reach: float) -> None:
    missing = int((proposal.away > reach).sum())
    if missing:
        worst = proposal.wanted_at[int(np.argmax(proposal.away))]
        where = ", ".join(f"{1e3 * value:.1f}" for value in worst)
        raise SutureError(
            SutureCode.NOTHING_THERE,
            f"no tissue within {1e3 * reach:g} mm of {missing} of {len(proposal.ends)} stitches; "
            f"the farthest, at ({where}) mm, is {1e3 * proposal.away.max():.3g} mm away from any",
        )


def _each_once(ends: Rows) -> Rows:
    """Where stitches are closer than nodes, they are made once, shape (m, 2)."""
    _, first = np.unique(ends, axis=0, return_index=True)
    return ends[np.sort(first)]
