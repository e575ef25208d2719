"""The loop of a relaxation pass, and the list of springs it follows.

Symbols as in `kernels.springs`. For a spring of limits l0 (1 - eps) and l0 (1 + eps), of which L is
the one it is beyond, the share of the edge that is too much needs one root and one division:

    q = l^2 - l0^2,    p = l^2 - L^2 = q - (L^2 - l0^2),    (l - L) / l = p / (l (l + L)).

A pass relaxes springs one after the other, each starting from where the one before has put its
ends. Springs that share no node do not notice each other's turn. So the list puts eight such
springs side by side, which are relaxed at once, and never changes the turn of two springs that
share a node: the result is that of the plain sequence, bit for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST, SpringArrays
from tissue_sim.kernels.vectors import LANES, bits, fetch_rows, load, put_rows, root, select

REMOVED_LENGTH = 1e15
"""Rest length [m] of a spring that is there no more: it is never outside its limits."""

APART = 2
"""Groups between two springs at one node: the second need not wait until the first is put."""

AT_REST, MOVED, MOVED_BEFORE = 0, 1, 2
"""What a node did, in bits: nothing, moved since this pass began, moved in the pass before."""


class SpringList(NamedTuple):
    """Springs in the order of a pass, in groups of eight of which no two share a node.

    A group is filled up with tombstones between a node that does not exist, the row behind the
    last, and itself.

    Attributes:
        first, second: Node rows of each spring's ends, uint32.
        edge: D = X_second - X_first [m]: by group, eight numbers for each component, shape (3 n,).
        length: l0 [m]; `REMOVED_LENGTH` for a tombstone.
    """

    first: NDArray[np.uint32]
    second: NDArray[np.uint32]
    edge: NDArray[np.floating]
    length: NDArray[np.floating]


class Turns(NamedTuple):
    """What is known while springs are listed.

    Attributes:
        ready: First group for the next spring at a node, shape (node_capacity + 1,).
        filled: Springs of each group begun.
        free: For each group begun, a group at or behind it that may have room.
    """

    ready: NDArray[np.int32]
    filled: NDArray[np.int32]
    free: NDArray[np.int32]


@njit(inline="always")
def _begin_group(begin, nobody, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Fill a group with tombstones."""
    first, second, edge, length = out
    for slot in range(begin, begin + LANES):
        first[slot] = second[slot] = nobody
        length[slot] = REMOVED_LENGTH
    for at in range(3 * begin, 3 * (begin + LANES)):
        edge[at] = 0


@njit(inline="always")
def _with_room(group, begun, free):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """First group with room from `group` on, at most `begun`; later searches are shortened."""
    found = group
    while found < begun and free[found] != found:
        found = free[found]
    while group < found:
        group, free[group] = free[group], found
    return found


@njit(inline="always")
def _write_edge(slot, i, j, rest, edge):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    lane = slot % LANES
    at = 3 * (slot - lane) + lane
    for axis in range(3):
        edge[at + LANES * axis] = rest[j, axis] - rest[i, axis]


@njit(cache=True, nogil=True)
def list_springs(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    key: NDArray[np.int64],
    springs: SpringArrays,
    spring_of: NDArray[np.int32],
    used: int,
    out: SpringList,
    place_of: NDArray[np.int32],
    turns: Turns,
) -> tuple[int, int]:
    """List the springs of nodes[begin:end] that those before have not, each at its earlier end.

    A spring goes to the first group with room behind all springs before it that share a node with
    it. It stops before a node for whose springs there may be no room. Writes `out`, `turns` and
    `place_of`, the place of each spring row in the list.

    Returns:
        The place in `nodes` to go on with, and the length of the list.
    """
    ready, filled, free = turns
    first, second, edge, length = out
    rest, start, degree, neighbour, _, rest_length = springs
    nobody = len(ready) - 1
    begun = used // LANES
    for place in range(begin, end):
        i = nodes[place]
        if (begun + APART * (np.int64(degree[i]) + 1)) * LANES > len(length):
            return place, begun * LANES
        for entry in range(start[i], start[i] + degree[i]):
            j = neighbour[entry]
            if 0 <= key[j] < key[i]:
                continue
            group = _with_room(max(ready[i], ready[j]), begun, free)
            while begun <= group:
                _begin_group(begun * LANES, nobody, out)
                filled[begun], free[begun] = 0, begun
                begun += 1
            slot = group * LANES + filled[group]
            filled[group] += 1
            if filled[group] == LANES:
                free[group] = group + 1
            ready[i] = ready[j] = group + APART
            first[slot], second[slot], length[slot] = i, j, rest_length[entry]
            _write_edge(slot, i, j, rest, edge)
            place_of[spring_of[entry]] = slot
    return end, begun * LANES


@njit(inline="always")
def _appended(i, j, nobody, used, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """A place for a spring in the last group or, if it does not go there, behind it."""
    slot = used
    for other in range(used - 1, max(used - LANES, 0) - 1, -1):
        a, b = out.first[other], out.second[other]
        if a == nobody:
            slot = other
        elif a in (i, j) or b in (i, j):
            return used
    return slot


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
    nobody: int,
) -> int:
    """Bury, change or append springs. Modifies `out` and `place_of` in place.

    Args:
        rows: Rows of the springs.
        removed: Which of them are there no more.
        ends: Node rows of each spring row, shape (spring_rows, 2).
        lengths: Rest length of each spring row [m].
        rest: Rest positions in the kernels' precision [m], shape (node_capacity, 3).
        used: Length of the list.
        out: The list, with room for a group for each of them.
        place_of: Place of each spring row in it, -1 for none.
        nobody: The node that does not exist.

    Returns:
        Length of the list afterwards.
    """
    for k in range(len(rows)):
        spring = rows[k]
        place = np.int64(place_of[spring])
        if removed[k]:
            if place >= 0:
                out.length[place] = REMOVED_LENGTH
            continue
        if place < 0:
            place = _appended(ends[spring, 0], ends[spring, 1], nobody, used, out)
            if place == used:
                _begin_group(used, nobody, out)
                used += LANES
            place_of[spring] = place
            out.first[place], out.second[place] = ends[spring, 0], ends[spring, 1]
        out.length[place] = lengths[spring]
        _write_edge(place, out.first[place], out.second[place], rest, out.edge)
    return used


class Nodes(NamedTuple):
    """The nodes as a pass has them, with a row for the node that does not exist.

    Attributes:
        u: Displacements [m] and, last, 1 for a node that may move and 0 for a prescribed one, shape
            (node_capacity + 1, 4).
        moved: `AT_REST`, `MOVED` or `MOVED_BEFORE`, shape (node_capacity + 1,), uint8.
    """

    u: NDArray[np.floating]
    moved: NDArray[np.uint8]


@njit(inline="always", error_model="numpy", fastmath=FAST)
def _take_over(rows, u, nodes):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Bring the nodes up to date with what others did to them since the pass before."""
    X, moved = nodes
    for i in range(rows):
        moved[i] = MOVED_BEFORE * (moved[i] & MOVED)
    for i in range(rows):
        x, y, z = u[i, 0], u[i, 1], u[i, 2]
        if (X[i, 0] != x) | (X[i, 1] != y) | (X[i, 2] != z):
            X[i, 0], X[i, 1], X[i, 2] = x, y, z
            moved[i] = MOVED


@njit(inline="always")
def _rests(group, first, second, moved):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Whether none of the ends of a group has moved since the pass before began."""
    middle = group + LANES // 2
    awake = moved[first[group]] | moved[second[group]]
    awake |= moved[first[middle]] | moved[second[middle]]
    if awake != AT_REST:
        return False
    for spring in range(group + 1, group + LANES):
        awake |= moved[first[spring]] | moved[second[spring]]
    return awake == AT_REST


@njit(inline="always")
def _note_moves(group, first, second, moved):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Note that the ends of a group have moved, also of its springs inside their limits.

    They are looked at once more for it, which costs less than telling the lanes from each other.
    """
    for spring in range(group, group + LANES):
        moved[first[spring]] = MOVED
        moved[second[spring]] = MOVED


@njit(inline="always")
def _ones(mask):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """How many of eight bits are set."""
    pairs = mask - (mask >> 1 & 0x55)
    fours = (pairs & 0x33) + (pairs >> 2 & 0x33)
    return (fours + (fours >> 4)) & 0x0F


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def relax_springs(
    rows: int,
    used: int,
    springs: SpringList,
    everything: bool,
    prescribed: NDArray[np.bool_],
    limits: NDArray[np.floating],
    tiny: np.floating,
    nodes: Nodes,
    u: NDArray[np.floating],
) -> tuple[int, int]:
    """One relaxation pass. Modifies `u` and `nodes` in place.

    A spring outside [l0 (1 - eps), l0 (1 + eps)] is put at that limit by moving its ends along it.
    The test needs no square root: l > l0 (1 + eps) is q > l0^2 eps (2 + eps), and l < l0 (1 - eps)
    is q < -l0^2 eps (2 - eps).

    A group none of whose ends has moved since the pass before began is left out: its springs were
    found inside their limits then, and still are. The result is bit for bit that of looking at all.

    Args:
        rows: Node rows in use.
        used: Length of the list.
        springs: Springs in the order of the pass.
        everything: Whether to look at all groups; it must when prescribed nodes have changed.
        prescribed: Nodes that do not move.
        limits: eps, eps (2 + eps), -eps (2 - eps), and the share of the excess that each of two
            free ends moves.
        tiny: `TINY` in the precision of `u`.
        nodes: The nodes as the pass before left them.
        u: Displacements [m].

    Returns:
        Number of springs that were outside their limits, and of those looked at, tombstones
        included.
    """
    first, second, edge, length = springs
    X, moved = nodes
    zero = tiny - tiny
    one = zero + np.float32(1.0)
    eps, widest, narrowest, share = limits[0], limits[1], limits[2], limits[3]
    if everything:
        for i in range(rows):
            X[i, 3] = zero if prescribed[i] else one
    _take_over(rows, u, nodes)
    count = looked = 0
    for group in range(0, used, LANES):
        if not everything and _rests(group, first, second, moved):
            continue
        looked += LANES
        a0, a1, a2, a_moves = fetch_rows(X, first, group)
        b0, b1, b2, b_moves = fetch_rows(X, second, group)
        w0, w1, w2 = b0 - a0, b1 - a1, b2 - a2
        at = 3 * group
        D0, D1, D2 = load(edge, at), load(edge, at + LANES), load(edge, at + 2 * LANES)
        e0, e1, e2 = D0 + w0, D1 + w1, D2 + w2
        q = (D0 + e0) * w0 + (D1 + e1) * w1 + (D2 + e2) * w2
        l0 = load(length, group)
        squared = l0 * l0
        longer, shorter = q - widest * squared, q - narrowest * squared
        outside = bits(longer > zero) | bits(shorter < zero)
        if outside == 0:
            continue
        p = select(longer > zero, longer, zero) + select(shorter < zero, shorter, zero)
        limit = l0 * select(q > zero, one + eps, one - eps)
        now = squared + q
        now = root(select(now > tiny, now, tiny))
        excess = p / (now * (now + limit))
        # Two free ends take their share each; one alone takes all of it.
        shared = (one - share) * (a_moves * b_moves)
        excess_a, excess_b = excess * (a_moves - shared), excess * (b_moves - shared)
        put_rows(
            X, first, group, (a0 + excess_a * e0, a1 + excess_a * e1, a2 + excess_a * e2, a_moves)
        )
        put_rows(
            X, second, group, (b0 - excess_b * e0, b1 - excess_b * e1, b2 - excess_b * e2, b_moves)
        )
        count += _ones(outside)
        _note_moves(group, first, second, moved)
    for i in range(rows):
        u[i, 0], u[i, 1], u[i, 2] = X[i, 0], X[i, 1], X[i, 2]
    return count, looked
