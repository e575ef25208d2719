"""Isosurface stuffing: a tetrahedral mesh with good elements from any signed-distance function.

The shape is laid over a body-centred cubic lattice. Lattice nodes that lie too close to the surface
are moved onto it, the other lattice edges that pass through the surface are cut there, and
every lattice tetrahedron that contains a piece of the inside is replaced by one of a few stencils.
All dihedral angles lie between 10.7 and 164.8 degrees, whatever the shape.

A node moved onto the surface can pinch tissue that is about one cell thin: two pieces would then
meet in a node or an edge only. Such a node is moved back to its lattice place and declared inside
(see `stuffing_pinches`), which thickens the tissue by less than half a cell, never opens a
hole, and keeps the angle bounds because every surface point stays in its permitted range.

Limitations: uniform size; parts (and gaps) thinner than about one cell are not resolved;
sharp edges of the shape are chamfered.

References:
    F. Labelle and J. R. Shewchuk, Isosurface stuffing: fast tetrahedral meshes with good dihedral
    angles, ACM Transactions on Graphics 26(3), 2007, doi 10.1145/1276377.1276448.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from tissue_sim.geometry.bcc_lattice import (
    DIRECTIONS,
    LONG_DIRECTIONS,
    BccLattice,
    bcc_lattice,
    near_nodes,
    part_of,
)
from tissue_sim.geometry.stuffing_pinches import mend_pinches
from tissue_sim.geometry.stuffing_stencils import fill

Rows = NDArray[np.int32]
Reals = NDArray[np.float64]
Signs = NDArray[np.int8]
Implicit = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Signed distance [m] of points, shape (n, 3) -> (n,), negative inside."""

WARP_LONG = 0.24999
WARP_SHORT = 0.41189
"""A cut closer to a node than this share of the edge moves the node (Labelle and Shewchuk)."""

_ROOT_STEPS = 12

_STILL = 1e-13
"""A root that a step moves by no more than this share of the edge is found."""


class StuffedMesh(NamedTuple):
    """A tetrahedral mesh made by `stuff`.

    Attributes:
        points: Node positions [m], shape (node_count, 3).
        tetrahedra: Positively oriented node quadruples, shape (tetrahedron_count, 4).
        thickened: Places where a pinch was mended by adding tissue [m], shape (n, 3).
    """

    points: NDArray[np.float64]
    tetrahedra: NDArray[np.int32]
    thickened: NDArray[np.float64]


def stuff(
    distance: Implicit,
    lower: ArrayLike,
    upper: ArrayLike,
    cell: float,
    root_steps: int = _ROOT_STEPS,
) -> StuffedMesh:
    """Fill an implicit shape with tetrahedra.

    Args:
        distance: Signed distance of the shape, negative inside. Only its zero level matters.
        lower: Lower corner of a box around the shape [m].
        upper: Upper corner of the box [m].
        cell: Length of the lattice's long edges [m], the mesh's element size.
        root_steps: Evaluations, at most, to find where an edge passes through the surface; a true
            distance, which is nearly linear along an edge, needs few.

    Returns:
        The mesh; the same input gives the same bits.

    Raises:
        ValueError: The box is wrong, the shape reaches the box's border, the distance is
            not finite, or no lattice node lies inside.
    """
    lattice = bcc_lattice(np.asarray(lower, float), np.asarray(upper, float), cell)
    values = np.asarray(distance(lattice.points), dtype=np.float64)
    _check_values(values, lattice)
    near = near_nodes(lattice, values < 0.0)
    lattice, values = part_of(lattice, near), values[near]
    sign = np.where(values < 0.0, 1, -1).astype(np.int8)
    fractions = _cut_fractions(distance, lattice, values, sign, root_steps)
    positions = lattice.points.copy()
    _warp(lattice.neighbours, DIRECTIONS * (0.5 * lattice.cell), fractions, sign, positions)
    mended = mend_pinches(lattice.neighbours, values < 0.0, sign)
    positions[mended] = lattice.points[mended]
    cuts, cut_positions = _cut_nodes(lattice, fractions, sign, positions)
    filled = fill(lattice.coordinates, lattice.neighbours, cuts, sign)
    points, tetrahedra = _keep_used(np.concatenate([positions, cut_positions]), filled)
    return StuffedMesh(points, _orient(points, tetrahedra), lattice.points[mended])


def _check_values(values: NDArray[np.float64], lattice: BccLattice) -> None:
    if values.shape != (len(lattice.coordinates),):
        raise ValueError(
            f"the distance function answered with shape {values.shape} for "
            f"{len(lattice.coordinates)} points, one number per point is wanted"
        )
    if not np.all(np.isfinite(values)):
        raise ValueError("the distance function answered with a value that is not finite")
    inside = values < 0.0
    if not inside.any():
        raise ValueError(
            f"no lattice node lies inside the shape: check the box or use a cell below "
            f"{lattice.cell} m"
        )
    if inside[np.any(lattice.neighbours < 0, axis=1)].any():
        raise ValueError("the shape reaches the border of the box: make the box larger")


def _cut_fractions(
    distance: Implicit,
    lattice: BccLattice,
    values: NDArray[np.float64],
    sign: NDArray[np.int8],
    root_steps: int,
) -> NDArray[np.float64]:
    """Find where each lattice edge passes through the surface, as a share of its length.

    Returns:
        Share of the way from the node to its neighbour, NaN where the edge is not cut,
        shape (node_count, 14).
    """
    fractions = np.full(lattice.neighbours.shape, np.nan)
    points = lattice.points
    for direction in range(0, 14, 2):
        other = lattice.neighbours[:, direction]
        start = np.flatnonzero((other >= 0) & (sign != sign[other]))
        end = other[start]
        share = _roots(distance, points[start], points[end], values[start], values[end], root_steps)
        fractions[start, direction] = share
        fractions[end, direction ^ 1] = 1.0 - share
    return fractions


def _roots(
    distance: Implicit,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    at_start: NDArray[np.float64],
    at_end: NDArray[np.float64],
    steps: int,
) -> NDArray[np.float64]:
    """Bracketed roots on segments by the Illinois rule, until they stand still."""
    shares = np.zeros(len(start))
    low, high = np.zeros(len(start)), np.ones(len(start))
    f_low, f_high = at_start.copy(), at_end.copy()
    last_side = np.zeros(len(start), dtype=np.int8)
    rows = np.arange(len(start))
    for _ in range(steps):
        if not len(rows):
            break
        share = (low * f_high - high * f_low) / (f_high - f_low)
        value = distance(start[rows] + share[:, None] * (end[rows] - start[rows]))
        moving = (np.abs(share - shares[rows]) > _STILL) & (value != 0.0)
        shares[rows] = share
        same_as_low = (value < 0.0) == (f_low < 0.0)
        side = np.where(same_as_low, 1, -1).astype(np.int8)
        repeated = side == last_side
        f_high = np.where(same_as_low, np.where(repeated, 0.5 * f_high, f_high), value)
        f_low = np.where(same_as_low, value, np.where(repeated, 0.5 * f_low, f_low))
        low = np.where(same_as_low, share, low)
        high = np.where(same_as_low, high, share)
        rows, low, high, f_low, f_high, last_side = (
            column[moving] for column in (rows, low, high, f_low, f_high, side)
        )
    return shares


@njit(cache=True)
def _warp(neighbours: Rows, steps: Reals, fractions: Reals, sign: Signs, positions: Reals) -> None:
    """Move nodes that a cut violates onto their nearest violating cut, in lattice order.

    A moved node has sign 0; the cuts on its edges vanish, so that they violate nobody else.
    Modifies `sign` and `positions` in place.
    """
    for node in range(len(sign)):
        best, nearest = -1, np.inf
        for direction in range(14):
            share = fractions[node, direction]
            limit = WARP_LONG if direction < LONG_DIRECTIONS else WARP_SHORT
            if not share < limit or sign[neighbours[node, direction]] == 0:
                continue
            length = share * (1.0 if direction < LONG_DIRECTIONS else 0.8660254037844386)
            if length < nearest:
                best, nearest = direction, length
        if best >= 0:
            sign[node] = 0
            for axis in range(3):
                positions[node, axis] += fractions[node, best] * steps[best, axis]


def _cut_nodes(
    lattice: BccLattice,
    fractions: NDArray[np.float64],
    sign: NDArray[np.int8],
    positions: NDArray[np.float64],
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Number and place the nodes on cut edges.

    Mended nodes can lie on the other side of the true surface: their cuts are put as close to it as
    the angle bounds allow.

    Returns:
        Row of the cut node per lattice edge, -1 where there is none, shape (node_count, 14); and
        the positions of the cut nodes [m].
    """
    cuts = np.full(lattice.neighbours.shape, -1, dtype=np.int32)
    places = []
    count = len(sign)
    for direction in range(0, 14, 2):
        other = lattice.neighbours[:, direction]
        start = np.flatnonzero((other >= 0) & (sign * sign[other] < 0))
        end = other[start]
        limit = WARP_LONG if direction < LONG_DIRECTIONS else WARP_SHORT
        share = fractions[start, direction]
        unknown = np.where(sign[start] > 0, limit, 1.0 - limit)
        share = np.clip(np.where(np.isnan(share), unknown, share), limit, 1.0 - limit)
        places.append(positions[start] + share[:, None] * (positions[end] - positions[start]))
        cuts[start, direction] = cuts[end, direction ^ 1] = count + np.arange(len(start))
        count += len(start)
    return cuts, np.concatenate(places)


def _keep_used(
    points: NDArray[np.float64], tetrahedra: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Drop nodes without a tetrahedron and renumber the others."""
    used = np.zeros(len(points), dtype=bool)
    used[tetrahedra] = True
    new_row = np.cumsum(used, dtype=np.int64) - 1
    return points[used], new_row[tetrahedra].astype(np.int32)


def _orient(points: NDArray[np.float64], tetrahedra: NDArray[np.int32]) -> NDArray[np.int32]:
    """Swap two corners of the tetrahedra whose volume is negative."""
    edges = points[tetrahedra[:, 1:]] - points[tetrahedra[:, :1]]
    volume = np.sum(np.cross(edges[:, 0], edges[:, 1]) * edges[:, 2], axis=1)
    flipped = tetrahedra[:, [0, 1, 3, 2]]
    return np.where((volume < 0.0)[:, None], flipped, tetrahedra)
