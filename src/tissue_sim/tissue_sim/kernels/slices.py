"""Springs of eight nodes side by side, and loops over all nodes that use them.

Symbols as in `kernels.springs`. A *slice* holds eight nodes and, behind each other, the first
springs of all of them, the second ones, and so on: eight springs are a vector. What lies elsewhere,
the other ends of the springs, is fetched row by row and transposed in registers. Hardware gathers
do the same in ten times the time on processors that were mended against data sampling.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.spring_laws import Law
from tissue_sim.kernels.springs import FAST, SpringArrays
from tissue_sim.kernels.vectors import LANES, fetch_rows, load, put_rows, root, select, splat


class Slices(NamedTuple):
    """Springs by slice; lanes of shorter lists are filled up with springs without stiffness.

    Attributes:
        nodes: Node rows, eight for each slice; the row behind the last for a lane without a node,
            uint32.
        start: Place of each slice's first spring, int64.
        width: Vectors of springs of each slice, int64.
        slot: Place of each node row in `nodes`, -1 for none, shape (node_capacity + 1,).
        neighbour: Node at the other end of each spring, uint32.
        stiffness: k [N/m].
        length: l0 [m].
    """

    nodes: NDArray[np.uint32]
    start: NDArray[np.int64]
    width: NDArray[np.int64]
    slot: NDArray[np.int32]
    neighbour: NDArray[np.uint32]
    stiffness: NDArray[np.floating]
    length: NDArray[np.floating]


class Places(NamedTuple):
    """Nodes as vectors read them, shape (node_capacity + 1, 4); the last row is nobody's.

    Attributes:
        rest: Rest positions [m] and nothing.
        u: Displacements [m] and nothing.
        F: Forces [N] and nothing.
    """

    rest: NDArray[np.floating]
    u: NDArray[np.floating]
    F: NDArray[np.floating]


@njit(cache=True, nogil=True)
def add_slices(
    rows: NDArray[np.int32],
    begin: int,
    springs: SpringArrays,
    count: int,
    used: int,
    slices: Slices,
    places: Places,
) -> tuple[int, int, int]:
    """Add slices of rows[begin:], eight at a time, in place of those the nodes were in before.

    Modifies `slices` and the rest positions of `places` in place. It stops before a slice that
    there is no room for.

    Returns:
        The place in `rows` to go on with, the number of slices, and the places in use.
    """
    rest, begins, degree, other, k_of, length_of = springs
    nodes, start, width_of, slot_of, neighbour, stiffness, length = slices
    X = places.rest
    nobody = len(slot_of) - 1
    while begin < len(rows):
        end = min(begin + LANES, len(rows))
        width = 0
        for k in range(begin, end):
            width = max(width, int(degree[rows[k]]))
        if used + width * LANES > len(neighbour) or count == len(start):
            return begin, count, used
        start[count], width_of[count] = used, width
        for lane in range(LANES):
            slot = count * LANES + lane
            node = rows[begin + lane] if begin + lane < end else nobody
            nodes[slot] = node
            springs_here = 0
            if node != nobody:
                springs_here = int(degree[node])
                if slot_of[node] >= 0:
                    nodes[slot_of[node]] = nobody
                slot_of[node] = slot
                for axis in range(3):
                    X[node, axis] = rest[node, axis]
            for k in range(width):
                at = used + k * LANES + lane
                if k < springs_here:
                    entry = np.int64(begins[node]) + k
                    neighbour[at] = other[entry]
                    stiffness[at], length[at] = k_of[entry], length_of[entry]
                else:
                    neighbour[at] = node
                    stiffness[at], length[at] = 0, 1
        used += width * LANES
        count += 1
        begin = end
    return begin, count, used


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _secants(law, e):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """f(e) / e, as `kernels.spring_laws` has it for one spring."""
    one = law.one
    curved = one + e * (law.quadratic + law.cubic * e)
    above = (law.force_above + law.slope_above * (e - law.above)) / e
    below = (law.force_below + law.slope_below * (e - law.below)) / e
    return select(e > law.above, above, select(e < law.below, below, curved))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def slice_forces(
    rows: int,
    count: int,
    slices: Slices,
    places: Places,
    law: Law,
    linear: bool,
    tiny: np.floating,
    u: NDArray[np.floating],
    F: NDArray[np.floating],
) -> None:
    """Forces of the springs on nodes [0, rows) [N]. Writes `F`, shape (node_capacity, 3).

    As in `kernels.springs`, lengths are not subtracted from each other: l - l0 = q / (l + l0).
    Modifies `places` in place.

    Args:
        rows: Nodes [0, rows) take part.
        count: Number of slices.
        slices: Springs by slice.
        places: Nodes as vectors read them.
        law: The springs' law.
        linear: Whether it is f(e) = e.
        tiny: `TINY` in the precision of `u`.
        u: Displacements [m].
        F: Forces [N].
    """
    nodes, start, width, _, neighbour, stiffness, length = slices
    X, U, forces = places
    for i in range(rows):
        U[i, 0], U[i, 1], U[i, 2] = u[i, 0], u[i, 1], u[i, 2]
    for slot in range(0, count * LANES, LANES):
        X0, X1, X2, _ = fetch_rows(X, nodes, slot)
        u0, u1, u2, _ = fetch_rows(U, nodes, slot)
        F0 = F1 = F2 = splat(tiny - tiny)
        begin = start[slot // LANES]
        for at in range(begin, begin + width[slot // LANES] * LANES, LANES):
            x0, x1, x2, _ = fetch_rows(X, neighbour, at)
            v0, v1, v2, _ = fetch_rows(U, neighbour, at)
            w0, w1, w2 = v0 - u0, v1 - u1, v2 - u2
            D0, D1, D2 = x0 - X0, x1 - X1, x2 - X2
            e0, e1, e2 = D0 + w0, D1 + w1, D2 + w2
            q = (D0 + e0) * w0 + (D1 + e1) * w1 + (D2 + e2) * w2
            k, l0 = load(stiffness, at), load(length, at)
            now = root(e0 * e0 + e1 * e1 + e2 * e2 + tiny)
            pull = k * q / (now * (now + l0))
            if not linear:
                pull = pull * _secants(law, q / ((now + l0) * l0))
            F0 += pull * e0
            F1 += pull * e1
            F2 += pull * e2
        put_rows(forces, nodes, slot, (F0, F1, F2, F0))
    for i in range(rows):
        F[i, 0], F[i, 1], F[i, 2] = forces[i, 0], forces[i, 1], forces[i, 2]
