"""Planning to sew a patch in: stitches spread along its rim and the edge of a hole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cut_service.loops import closest_shares, matched, shares_of
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
        cost: Mean square of the length of the stitches [m^2].
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
    tissue = _Tissue.of(mesh, places)
    found = []
    for rim in _longest_of_each_side(mesh, patch):
        shares = _spread(places[rim.nodes], loop, wanted.spacing)
        if loop is None:
            found.append(_to_the_closest(places, rim, shares, tissue))
        else:
            found += _to_the_loop(places, rim, shares, loop, tissue)
    best = min(found, key=lambda proposal: proposal.cost)
    _refuse_far(best, wanted.reach or REACH)
    return stitched(mesh, places, _each_once(best.ends), wanted, closed=True)


@dataclass(frozen=True)
class _Tissue:
    """Nodes of the surface that are of no patch.

    Attributes:
        nodes: Their rows, shape (n,).
        tree: Where they are.
    """

    nodes: Rows
    tree: cKDTree

    @classmethod
    def of(cls, mesh: Mesh, places: Reals) -> _Tissue:
        nodes = np.unique(surface_of(mesh).tissue).astype(np.int64)
        if not len(nodes):
            raise SutureError(SutureCode.NOTHING_THERE, "there is no tissue besides patches")
        return cls(nodes, cKDTree(places[nodes]))

    def closest(self, wanted: Reals) -> tuple[Rows, Reals]:
        """The nodes closest to places [m], and how far they are away [m]."""
        distances, nearest = self.tree.query(wanted)
        return self.nodes[nearest], np.asarray(distances, dtype=np.float64)


def _to_the_closest(places: Reals, rim: Rim, shares: Reals, tissue: _Tissue) -> _Proposal:
    at = rim.nodes[closest_shares(shares_of(places[rim.nodes]), shares)]
    there, away = tissue.closest(places[at])
    return _proposal(places, at, there, places[at], away)


def _to_the_loop(
    places: Reals, rim: Rim, shares: Reals, loop: Reals, tissue: _Tissue
) -> list[_Proposal]:
    """Stitches from the rim's nodes to what is opposite, and from the tissue's.

    Both are at nodes. Whichever are chosen first, the others are those closest to what is opposite
    them: where the one mesh is coarse, stitches do not pull along the edge.
    """
    line = places[rim.nodes]
    own, match = shares_of(line), matched(line, loop, len(shares))
    at = closest_shares(own, shares)
    wanted = match.opposite(own[at])
    there, away = tissue.closest(wanted)
    rim_first = _proposal(places, rim.nodes[at], there, wanted, away)
    wanted = match.opposite(shares)
    there, away = tissue.closest(wanted)
    at = closest_shares(own, match.shares_at(places[there]))
    return [rim_first, _proposal(places, rim.nodes[at], there, wanted, away)]


def _proposal(places: Reals, at: Rows, there: Rows, wanted: Reals, away: Reals) -> _Proposal:
    cost = float(np.square(places[at] - places[there]).sum(axis=1).mean())
    return _Proposal(np.stack([at, there], axis=1), wanted, away, cost)


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


def _spread(line: Reals, loop: Reals | None, spacing: float) -> Reals:
    """Shares of a closed line that are evenly apart, as many as there are stitches, (n,)."""
    longest = perimeter(line)
    if loop is not None:
        longest = max(longest, perimeter(loop))
    count = max(round(min(longest / spacing, 2.0 * MOST_STITCHES)), FEWEST)
    if count > MOST_STITCHES:
        raise SutureError(
            SutureCode.INVALID, f"{count} stitches or more; allowed: up to {MOST_STITCHES}"
        )
    return np.arange(count) / count


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
