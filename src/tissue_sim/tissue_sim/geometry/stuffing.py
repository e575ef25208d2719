"""Isosurface stuffing: a tetrahedral mesh with good elements from any signed-distance function.

The shape is laid over a body-centred cubic lattice. Lattice nodes that lie too close to the surface
are moved onto it, the other lattice edges that pass through the surface are cut there, and
every lattice tetrahedron that contains a piece of the inside is replaced by one of a few stencils.
All dihedral angles lie between 10.7 and 164.8 degrees, whatever the shape.

A node moved onto the surface can pinch tissue that is about one cell thin: two pieces would then
meet in a node or an edge only. Such a node is moved back to its lattice place and declared inside
(see `_mend_pinches`), which thickens the tissue by less than half a cell, never opens a hole, and
keeps the angle bounds because every surface point stays in its permitted range.

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
    LINK_EDGES,
    LINK_TRIANGLES,
    LONG_DIRECTIONS,
    TETRAHEDRON_DIRECTIONS,
    BccLattice,
    bcc_lattice,
)

Implicit = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Signed distance [m] of points, shape (n, 3) -> (n,), negative inside."""

WARP_LONG = 0.24999
WARP_SHORT = 0.41189
"""A cut closer to a node than this share of the edge moves the node (Labelle and Shewchuk)."""

_ROOT_STEPS = 12


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


def stuff(distance: Implicit, lower: ArrayLike, upper: ArrayLike, cell: float) -> StuffedMesh:
    """Fill an implicit shape with tetrahedra.

    Args:
        distance: Signed distance of the shape, negative inside. Only its zero level matters.
        lower: Lower corner of a box around the shape [m].
        upper: Upper corner of the box [m].
        cell: Length of the lattice's long edges [m], the mesh's element size.

    Returns:
        The mesh; the same input gives the same bits.

    Raises:
        ValueError: The box is wrong, the shape reaches the box's border, the distance is
            not finite, or no lattice node lies inside.
    """
    lattice = bcc_lattice(np.asarray(lower, float), np.asarray(upper, float), cell)
    values = np.asarray(distance(lattice.points), dtype=np.float64)
    _check_values(values, lattice)
    sign = np.where(values < 0.0, 1, -1).astype(np.int8)
    fractions = _cut_fractions(distance, lattice, values, sign)
    positions = lattice.points
    _warp(lattice.neighbours, DIRECTIONS * (0.5 * lattice.cell), fractions, sign, positions)
    mended = _mend_pinches(lattice.neighbours, values < 0.0, LINK_TRIANGLES, LINK_EDGES, sign)
    positions[mended] = lattice.points[mended]
    cuts, cut_positions = _cut_nodes(lattice, fractions, sign, positions)
    tetrahedra = _fill(lattice.coordinates, lattice.neighbours, cuts, sign)
    points, tetrahedra = _keep_used(np.concatenate([positions, cut_positions]), tetrahedra)
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
    distance: Implicit, lattice: BccLattice, values: NDArray[np.float64], sign: NDArray[np.int8]
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
        share = _roots(distance, points[start], points[end], values[start], values[end])
        fractions[start, direction] = share
        fractions[end, direction ^ 1] = 1.0 - share
    return fractions


def _roots(
    distance: Implicit,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    at_start: NDArray[np.float64],
    at_end: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Bracketed roots on segments by the Illinois rule, a fixed number of steps for all."""
    low, high = np.zeros(len(start)), np.ones(len(start))
    f_low, f_high = at_start.copy(), at_end.copy()
    last_side = np.zeros(len(start), dtype=np.int8)
    share = low
    for _ in range(_ROOT_STEPS if len(start) else 0):
        share = (low * f_high - high * f_low) / (f_high - f_low)
        value = distance(start + share[:, None] * (end - start))
        same_as_low = (value < 0.0) == (f_low < 0.0)
        side = np.where(same_as_low, 1, -1).astype(np.int8)
        repeated = side == last_side
        f_high = np.where(same_as_low, np.where(repeated, 0.5 * f_high, f_high), value)
        f_low = np.where(same_as_low, value, np.where(repeated, 0.5 * f_low, f_low))
        low = np.where(same_as_low, share, low)
        high = np.where(same_as_low, high, share)
        last_side = side
    return share


@njit(cache=True)
def _warp(neighbours, steps, fractions, sign, positions):  # type: ignore[no-untyped-def]
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


@njit(cache=True)
def _components(cells, edge_cells, joined):  # type: ignore[no-untyped-def]
    """Count the groups of marked cells of a node's link that are joined across link edges."""
    label = np.arange(len(cells))
    for _ in range(len(cells)):
        changed = False
        for edge in range(len(joined)):
            if joined[edge]:
                a, b = edge_cells[edge, 0], edge_cells[edge, 1]
                low = min(label[a], label[b])
                if label[a] != low or label[b] != low:
                    label[a] = low
                    label[b] = low
                    changed = True
        if not changed:
            break
    count = 0
    for cell in range(len(cells)):
        if cells[cell] and label[cell] == cell:
            count += 1
    return count


@njit(cache=True)
def _is_pinched(around, triangles, edges):  # type: ignore[no-untyped-def]
    """Whether inside or outside around a surface node falls apart into several pieces.

    Around the node its 14 neighbours form a triangulated sphere, the link. Link triangles with
    an inside neighbour carry tissue, those with an outside neighbour or with none inside
    carry outside. The surface is a disc at the node exactly if each of both is one piece
    joined across link edges.

    Args:
        around: Signs of the 14 neighbours.
        triangles: Link triangles, shape (24, 3).
        edges: Link edges with their triangles, shape (36, 4).
    """
    tissue = np.zeros(len(triangles), dtype=np.bool_)
    outside = np.zeros(len(triangles), dtype=np.bool_)
    for t in range(len(triangles)):
        a, b, c = around[triangles[t, 0]], around[triangles[t, 1]], around[triangles[t, 2]]
        tissue[t] = a > 0 or b > 0 or c > 0
        outside[t] = a < 0 or b < 0 or c < 0 or not tissue[t]
    tissue_joined = np.zeros(len(edges), dtype=np.bool_)
    outside_joined = np.zeros(len(edges), dtype=np.bool_)
    for e in range(len(edges)):
        first, second = edges[e, 0], edges[e, 1]
        a, b = around[edges[e, 2]], around[edges[e, 3]]
        on_surface = a == 0 and b == 0
        tissue_joined[e] = a > 0 or b > 0 or (on_surface and tissue[first] and tissue[second])
        outside_joined[e] = (
            a < 0 or b < 0 or (on_surface and not tissue[first] and not tissue[second])
        )
    if _components(tissue, edges, tissue_joined) > 1:
        return True
    return _components(outside, edges, outside_joined) > 1


@njit(cache=True)
def _mend_pinches(neighbours, was_inside, triangles, edges, sign):  # type: ignore[no-untyped-def]
    """Declare surface nodes inside where tissue or outside would only touch itself.

    Nodes that were inside before they were moved come first, then any. Tissue is only added,
    so the sweeps end. Modifies `sign` in place.

    Returns:
        Rows of the nodes declared inside, which belong at their lattice places again.
    """
    mended = np.zeros(len(sign), dtype=np.bool_)
    around = np.empty(14, dtype=np.int8)
    only_former_inside = True
    while True:
        changed = False
        for node in range(len(sign)):
            if sign[node] != 0 or (only_former_inside and not was_inside[node]):
                continue
            for direction in range(14):
                around[direction] = sign[neighbours[node, direction]]
            if _is_pinched(around, triangles, edges):
                sign[node] = 1
                mended[node] = True
                changed = True
        if changed:
            only_former_inside = True
        elif only_former_inside:
            only_former_inside = False
        else:
            return np.flatnonzero(mended)


def _cut_nodes(
    lattice: BccLattice,
    fractions: NDArray[np.float64],
    sign: NDArray[np.int8],
    positions: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Number and place the nodes on cut edges.

    Mended nodes can lie on the other side of the true surface: their cuts are put as close to it as
    the angle bounds allow.

    Returns:
        Row of the cut node per lattice edge, -1 where there is none, shape (node_count, 14); and
        the positions of the cut nodes [m].
    """
    cuts = np.full(lattice.neighbours.shape, -1, dtype=np.int64)
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


@njit(cache=True)
def _diagonal_from_first(first, second, outside, coordinates):  # type: ignore[no-untyped-def]
    """Choose the diagonal of a cut lattice face, the same from both sides.

    The face has corners `first` and `second` inside and one outside. If the inside edge is long,
    the parity rule decides: the diagonal leaves the corner of which an even number of coordinates
    exceed the outside corner's. Otherwise it leaves the corner whose cut edge is short (with the
    other choice the smallest angle falls to 8 degrees).

    Returns:
        True if the diagonal runs from `first` to the cut on the edge second-outside.
    """
    long_inside, greater, first_cut_is_long = 0, 0, 0
    for axis in range(3):
        a, b = coordinates[first, axis], coordinates[second, axis]
        c = coordinates[outside, axis]
        long_inside += abs(a - b) == 2
        greater += a > c
        first_cut_is_long += abs(a - c) == 2
    if long_inside == 1:
        return greater % 2 == 0
    return first_cut_is_long == 0


@njit(cache=True)
def _emit_prism(a, b, diagonal, out, count):  # type: ignore[no-untyped-def]
    """Split the prism a0 a1 a2 - b0 b1 b2 into three tetrahedra.

    `diagonal[k]` says that side k (a_k, a_k+1, b_k+1, b_k) has the diagonal a_k - b_k+1; the three
    must not all be equal (no such split exists).
    """
    k = 0
    while not (diagonal[k] and not diagonal[(k + 2) % 3]):
        k += 1
    i, j, m = k, (k + 1) % 3, (k + 2) % 3
    out[count] = (a[i], b[i], b[j], b[m])
    if diagonal[j]:
        out[count + 1] = (a[i], a[j], a[m], b[m])
        out[count + 2] = (a[i], a[j], b[m], b[j])
    else:
        out[count + 1] = (a[i], a[j], a[m], b[j])
        out[count + 2] = (a[i], a[m], b[m], b[j])
    return count + 3


@njit(cache=True)
def _fill_one(node, cut, s, coordinates, out, count):  # type: ignore[no-untyped-def]
    """Write the stencil of one lattice tetrahedron.

    Args:
        node: Lattice rows of the four corners.
        cut: Rows of the cut nodes on the six edges, as a (4, 4) table.
        s: Signs of the corners.
        coordinates: Lattice coordinates.
        out: Tetrahedra so far, as tuples of rows. Modified in place.
        count: How many there are.
    """
    inside, outside, surface = np.empty(4, np.int64), np.empty(4, np.int64), np.int64(-1)
    n_in, n_out = 0, 0
    for corner in range(4):
        if s[corner] > 0:
            inside[n_in] = corner
            n_in += 1
        elif s[corner] < 0:
            outside[n_out] = corner
            n_out += 1
        else:
            surface = corner
    if n_in == 0:
        return count
    i0, i1, o0, o1 = inside[0], inside[1], outside[0], outside[1]
    if n_out == 0:
        out[count] = (node[0], node[1], node[2], node[3])
        return count + 1
    if n_in == 1:
        corners = node.copy()
        for k in range(n_out):
            corners[outside[k]] = cut[i0, outside[k]]
        out[count] = (corners[0], corners[1], corners[2], corners[3])
        return count + 1
    first = _diagonal_from_first(node[i0], node[i1], node[o0], coordinates)
    if n_in == 2 and n_out == 1:
        apex = node[surface]
        if first:
            out[count] = (node[i0], node[i1], cut[i1, o0], apex)
            out[count + 1] = (node[i0], cut[i1, o0], cut[i0, o0], apex)
        else:
            out[count] = (node[i0], node[i1], cut[i0, o0], apex)
            out[count + 1] = (node[i1], cut[i1, o0], cut[i0, o0], apex)
        return count + 2
    if n_in == 3:
        i2 = inside[2]
        a = (node[i0], node[i1], node[i2])
        b = (cut[i0, o0], cut[i1, o0], cut[i2, o0])
        second = _diagonal_from_first(node[i1], node[i2], node[o0], coordinates)
        third = _diagonal_from_first(node[i2], node[i0], node[o0], coordinates)
        return _emit_prism(a, b, (first, second, third), out, count)
    # Two inside, two outside: the prism's third side is on the surface and its diagonal is free.
    other = _diagonal_from_first(node[i0], node[i1], node[o1], coordinates)
    a = (cut[i0, o0], node[i0], cut[i0, o1])
    b = (cut[i1, o0], node[i1], cut[i1, o1])
    return _emit_prism(a, b, (not first, other, first), out, count)


@njit(cache=True)
def _fill_all(coordinates, neighbours, cuts, sign, corner_directions, directions, out):  # type: ignore[no-untyped-def]
    """Fill every lattice tetrahedron, returning how many tetrahedra were written to `out`."""
    count = 0
    node, s = np.empty(4, np.int64), np.empty(4, np.int8)
    cut = np.empty((4, 4), np.int64)
    for even in range(len(sign)):
        if coordinates[even, 0] & 1:
            continue
        for kind in range(len(directions)):
            node[0] = even
            complete = True
            for corner in range(1, 4):
                node[corner] = neighbours[even, corner_directions[kind, corner]]
                complete &= node[corner] >= 0
            if not complete:
                continue
            for corner in range(4):
                s[corner] = sign[node[corner]]
            if s.max() <= 0:
                continue
            for a in range(4):
                for b in range(4):
                    if a != b:
                        cut[a, b] = cuts[node[a], directions[kind, a, b]]
            count = _fill_one(node, cut, s, coordinates, out, count)
    return count


def _fill(
    coordinates: NDArray[np.int64],
    neighbours: NDArray[np.int64],
    cuts: NDArray[np.int64],
    sign: NDArray[np.int8],
) -> NDArray[np.int64]:
    """Replace each lattice tetrahedron that holds tissue by its stencil."""
    # 24 lattice tetrahedra meet at a node, at most three elements come of each.
    out = np.empty((72 * int(np.sum(sign > 0)), 4), dtype=np.int64)
    corner_directions = TETRAHEDRON_DIRECTIONS[:, 0, :]
    count = _fill_all(
        coordinates, neighbours, cuts, sign, corner_directions, TETRAHEDRON_DIRECTIONS, out
    )
    return out[:count]


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
