"""The stencils of isosurface stuffing: what each lattice tetrahedron becomes.

A lattice tetrahedron has corners inside, outside and on the surface. What is inside becomes one to
three tetrahedra. Quadrilaterals on faces between two lattice tetrahedra are divided by a rule that
both sides apply alike, so that the mesh is conforming.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.geometry.bcc_lattice import TETRAHEDRON_DIRECTIONS

Integers = NDArray[np.int64]
Rows = NDArray[np.int32]
Signs = NDArray[np.int8]


@njit(cache=True)
def _diagonal_from_first(first: int, second: int, outside: int, coordinates: Rows) -> bool:
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
def _emit_prism(
    a: tuple[int, int, int],
    b: tuple[int, int, int],
    diagonal: tuple[bool, bool, bool],
    out: Integers,
    count: int,
) -> int:
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
def _fill_one(
    node: Integers, cut: Integers, s: Signs, coordinates: Rows, out: Integers, count: int
) -> int:
    """Write the stencil of one lattice tetrahedron.

    Args:
        node: Lattice rows of the four corners.
        cut: Rows of the cut nodes on the six edges, as a (4, 4) table.
        s: Signs of the corners.
        coordinates: Lattice coordinates.
        out: Tetrahedra so far, as tuples of rows. Modified in place.
        count: How many there are.
    """
    inside, outside, surface = np.empty(4, np.int64), np.empty(4, np.int64), -1
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
def _fill_all(
    coordinates: Rows,
    neighbours: Rows,
    cuts: Rows,
    sign: Signs,
    corner_directions: Integers,
    directions: Integers,
    out: Integers,
) -> int:
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


def fill(
    coordinates: Rows,
    neighbours: Rows,
    cuts: Rows,
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
