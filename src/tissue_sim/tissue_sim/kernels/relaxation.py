"""The loop of a relaxation pass, and the list of springs it follows.

Symbols as in `kernels.springs`. For a spring of limits l0 (1 - eps) and l0 (1 + eps), of which L is
the one it is beyond, the share of the edge that is too much needs one root and one division:

    q = l^2 - l0^2,    p = l^2 - L^2 = q - (L^2 - l0^2),    (l - L) / l = p / (l (l + L)).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST, SpringArrays

REMOVED_LENGTH = 1e15
"""Rest length [m] of a spring that is there no more: it is never outside its limits."""


BLOCK = 16
"""Springs that are left out, or looked at, together."""


class SpringList(NamedTuple):
    """Springs in the order of a pass; behind the last of them as many tombstones as a block has.

    Attributes:
        first, second: Node rows of each spring's ends, uint32.
        edge: D = X_second - X_first [m], shape (n, 3).
        length: l0 [m]; `REMOVED_LENGTH` for a tombstone.
    """

    first: NDArray[np.uint32]
    second: NDArray[np.uint32]
    edge: NDArray[np.floating]
    length: NDArray[np.floating]


@njit(cache=True, nogil=True)
def list_springs(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    rank: NDArray[np.int32],
    springs: SpringArrays,
    spring_of: NDArray[np.int32],
    used: int,
    out: SpringList,
    place_of: NDArray[np.int32],
) -> int:
    """List the springs of nodes[begin:end] that those before have not, each at its earlier end.

    Writes `out` from place `used` on, and `place_of`, the place of each spring row in the list.

    Returns:
        Length of the list.
    """
    for place in range(begin, end):
        i = nodes[place]
        for entry in range(springs.start[i], springs.start[i] + springs.degree[i]):
            j = springs.neighbour[entry]
            if 0 <= rank[j] < place:
                continue
            out.first[used], out.second[used], out.length[used] = i, j, springs.length[entry]
            for axis in range(3):
                out.edge[used, axis] = springs.rest[j, axis] - springs.rest[i, axis]
            place_of[spring_of[entry]] = used
            used += 1
    return used


@njit(cache=True, nogil=True)
def relist(
    rows: NDArray[np.int32],
    removed: NDArray[np.bool_],
    ends: NDArray[np.int32],
    lengths: NDArray[np.float64],
    rest: NDArray[np.floating],
    used: int,
    out: SpringList,
    place_of: NDArray[np.int32],
) -> int:
    """Bury, change or append springs. Modifies `out` and `place_of` in place.

    Args:
        rows: Rows of the springs.
        removed: Which of them are there no more.
        ends: Node rows of each spring row, shape (spring_rows, 2).
        lengths: Rest length of each spring row [m].
        rest: Rest positions in the kernels' precision [m], shape (node_capacity, 3).
        used: Length of the list.
        out: The list, with room for all.
        place_of: Place of each spring row in it, -1 for none.

    Returns:
        Length of the list afterwards.
    """
    for k in range(len(rows)):
        spring = rows[k]
        place = place_of[spring]
        if removed[k]:
            if place >= 0:
                out.length[place] = REMOVED_LENGTH
            continue
        if place < 0:
            place = used
            used += 1
            place_of[spring] = place
            out.first[place], out.second[place] = ends[spring, 0], ends[spring, 1]
        out.length[place] = lengths[spring]
        i, j = out.first[place], out.second[place]
        for axis in range(3):
            out.edge[place, axis] = rest[j, axis] - rest[i, axis]
    return used


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _too_much(spring, edge, length, limits, tiny, w0, w1, w2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Share of the present edge that is beyond a spring's limit, negative if it is too short."""
    D0, D1, D2 = edge[spring, 0], edge[spring, 1], edge[spring, 2]
    q = (D0 + D0 + w0) * w0 + (D1 + D1 + w1) * w1 + (D2 + D2 + w2) * w2
    l0 = length[spring]
    squared = l0 * l0
    longer, shorter = limits[1] * squared, limits[2] * squared
    if shorter <= q <= longer:
        return tiny - tiny
    if q > tiny - tiny:
        p, limit = q - longer, l0 + limits[0] * l0
    else:
        p, limit = q - shorter, l0 - limits[0] * l0
    now = np.sqrt(max(squared + q, tiny))
    return p / (now * (now + limit))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def relax_springs(
    rows: int,
    used: int,
    springs: SpringList,
    number: int,
    since: int,
    prescribed: NDArray[np.bool_],
    limits: NDArray[np.floating],
    tiny: np.floating,
    moved_in: NDArray[np.int32],
    seen: NDArray[np.floating],
    u: NDArray[np.floating],
) -> int:
    """One relaxation pass. Modifies `u`, `moved_in` and `seen` in place.

    A spring outside [l0 (1 - eps), l0 (1 + eps)] is put at that limit by moving its ends along it.
    The test needs no square root: l > l0 (1 + eps) is q > l0^2 eps (2 + eps), and l < l0 (1 - eps)
    is q < -l0^2 eps (2 - eps).

    A block none of whose ends has moved since the pass before began is left out: its springs were
    found inside their limits then, and still are. The result is bit for bit that of looking at all.

    Args:
        rows: Node rows in use.
        used: Springs of the list.
        springs: Springs in the order of the pass.
        number: Counts passes, from 1.
        since: Blocks none of whose ends moved in this pass or a later one are left out; 0: none.
        prescribed: Nodes that do not move; the other end takes all.
        limits: eps, eps (2 + eps), -eps (2 - eps), and the share of the excess that each of two
            free ends takes.
        tiny: `TINY` in the precision of `u`.
        moved_in: Last pass during or before which each node moved, shape (node_capacity,).
        seen: Displacements when the last pass began [m], shape (node_capacity, 3).
        u: Displacements [m].

    Returns:
        Number of springs that were outside their limits.
    """
    first, second, edge, length = springs
    for i in range(rows):
        if u[i, 0] != seen[i, 0] or u[i, 1] != seen[i, 1] or u[i, 2] != seen[i, 2]:
            seen[i, 0], seen[i, 1], seen[i, 2] = u[i, 0], u[i, 1], u[i, 2]
            moved_in[i] = number
    outside = 0
    for begin in range(0, used, BLOCK):
        newest = moved_in[first[begin]]
        for spring in range(begin, begin + BLOCK):
            newest = max(newest, moved_in[first[spring]], moved_in[second[spring]])
        if newest < since:
            continue
        for spring in range(begin, begin + BLOCK):
            a, b = first[spring], second[spring]
            w0, w1, w2 = u[b, 0] - u[a, 0], u[b, 1] - u[a, 1], u[b, 2] - u[a, 2]
            excess = _too_much(spring, edge, length, limits, tiny, w0, w1, w2)
            if excess == tiny - tiny:
                continue
            e0, e1, e2 = edge[spring, 0] + w0, edge[spring, 1] + w1, edge[spring, 2] + w2
            if prescribed[a]:
                if prescribed[b]:
                    continue
                u[b, 0] -= excess * e0
                u[b, 1] -= excess * e1
                u[b, 2] -= excess * e2
                moved_in[b] = number
            elif prescribed[b]:
                u[a, 0] += excess * e0
                u[a, 1] += excess * e1
                u[a, 2] += excess * e2
                moved_in[a] = number
            else:
                excess *= limits[3]
                u[a, 0] += excess * e0
                u[a, 1] += excess * e1
                u[a, 2] += excess * e2
                u[b, 0] -= excess * e0
                u[b, 1] -= excess * e1
                u[b, 2] -= excess * e2
                moved_in[a] = moved_in[b] = number
            outside += 1
    return outside
