"""Loops that build a spring network from the elements of a mesh and repair it after an edit.

Sums over the elements at an edge or a node run along the incidence lists, which are in ascending
order of element rows, so that a repaired sum equals that of a network built afresh bit for bit. No
fastmath here, for the same reason.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray


class Elements(NamedTuple):
    """What the sums need of a mesh: elements, their rest volumes [m^3] and those at each node."""

    tets: NDArray[np.int32]
    volumes: NDArray[np.float64]
    start: NDArray[np.int64]
    degree: NDArray[np.int32]
    data: NDArray[np.int32]


class Lists(NamedTuple):
    """Springs by node with spare room: the writable side of `kernels.springs.SpringArrays`."""

    start: NDArray[np.uint32]
    degree: NDArray[np.uint32]
    room: NDArray[np.uint32]
    neighbour: NDArray[np.uint32]
    spring: NDArray[np.int32]
    stiffness: NDArray[np.floating]
    length: NDArray[np.floating]


class Springs(NamedTuple):
    """Springs by row: ends (lower row first), k [N/m], l0 [m], whether the row is in use."""

    ends: NDArray[np.int32]
    stiffness: NDArray[np.float64]
    length: NDArray[np.float64]
    alive: NDArray[np.bool_]


class Scratch(NamedTuple):
    """Marks and sums by node, which loops leave as they found them: false and zero."""

    among: NDArray[np.bool_]
    moved: NDArray[np.bool_]
    sums: NDArray[np.float64]


CHANGED, MADE, REMOVED, STIFFER = 1, 2, 3, 4
"""What an edit does to a spring; the last: its stiffness is another one, its edge is not."""


@njit(cache=True, nogil=True)
def place_rest(
    nodes: NDArray[np.int32],
    rest: NDArray[np.float64],
    origin: NDArray[np.float64],
    out: NDArray[np.floating],
) -> None:
    """Rest positions of nodes from an origin [m], in the kernels' precision. Writes out[nodes]."""
    for node in nodes:
        for axis in range(3):
            out[node, axis] = rest[node, axis] - origin[axis]


@njit(cache=True, nogil=True)
def _volume(rest, tets, row):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    a, b, c, d = tets[row, 0], tets[row, 1], tets[row, 2], tets[row, 3]
    p0, p1, p2 = rest[b, 0] - rest[a, 0], rest[b, 1] - rest[a, 1], rest[b, 2] - rest[a, 2]
    q0, q1, q2 = rest[c, 0] - rest[a, 0], rest[c, 1] - rest[a, 1], rest[c, 2] - rest[a, 2]
    r0, r1, r2 = rest[d, 0] - rest[a, 0], rest[d, 1] - rest[a, 1], rest[d, 2] - rest[a, 2]
    cross = p0 * (q1 * r2 - q2 * r1) + p1 * (q2 * r0 - q0 * r2) + p2 * (q0 * r1 - q1 * r0)
    return abs(cross) / 6.0


@njit(cache=True, nogil=True)
def measure_volumes(
    rows: NDArray[np.int32],
    rest: NDArray[np.float64],
    tets: NDArray[np.int32],
    out: NDArray[np.float64],
) -> None:
    """Rest volumes of elements [m^3]. Writes out[rows]; elements of nodes -1 have none."""
    for row in rows:
        out[row] = _volume(rest, tets, row) if tets[row, 0] >= 0 else 0.0


@njit(cache=True, nogil=True)
def volume_at(elements: Elements, node: int, other: int) -> float:
    """Rest volume of elements at a node that also have `other` (-1: all) [m^3]; 0: none has."""
    begin, total = elements.start[node], 0.0
    for place in range(begin, begin + elements.degree[node]):
        element = elements.data[place]
        meets = other < 0
        for corner in range(4):
            meets = meets or elements.tets[element, corner] == other
        if meets:
            total += elements.volumes[element]
    return total


@njit(cache=True, nogil=True)
def _distance(rest, a, b):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    D0, D1, D2 = rest[b, 0] - rest[a, 0], rest[b, 1] - rest[a, 1], rest[b, 2] - rest[a, 2]
    return np.sqrt(np.float64(D0) * D0 + np.float64(D1) * D1 + np.float64(D2) * D2)


@njit(cache=True, nogil=True)
def measure_springs(
    springs: Springs,
    rows: int,
    elements: Elements,
    kernel_rest: NDArray[np.floating],
    modulus: float,
) -> None:
    """Stiffness and rest length of springs [0, rows). Writes them into `springs`."""
    for spring in range(rows):
        a, b = springs.ends[spring, 0], springs.ends[spring, 1]
        volume = volume_at(elements, a, b)
        length = _distance(kernel_rest, a, b)
        springs.length[spring] = length
        springs.stiffness[spring] = modulus * volume / (length * length)


@njit(cache=True, nogil=True)
def node_volumes(
    nodes: NDArray[np.int32],
    elements: Elements,
    out: NDArray[np.float64],
) -> None:
    """A quarter of the rest volume of the elements at each node [m^3]. Writes out[nodes]."""
    for node in nodes:
        out[node] = volume_at(elements, node, -1) / 4.0


@njit(cache=True, nogil=True)
def fill_lists(springs: Springs, rows: int, lists: Lists) -> None:
    """Enter springs [0, rows) at both of their ends. Modifies `lists`, whose degrees start at 0."""
    for spring in range(rows):
        if springs.alive[spring]:
            _enter(lists, springs.ends[spring, 0], springs.ends[spring, 1], spring, springs)
            _enter(lists, springs.ends[spring, 1], springs.ends[spring, 0], spring, springs)


@njit(cache=True, nogil=True)
def _enter(lists, node, other, spring, springs):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    begin = np.int64(lists.start[node])
    place = begin + np.int64(lists.degree[node])
    # Ascending by row, so that a spring that comes back is where it was.
    while place > begin and lists.spring[place - 1] > spring:
        lists.neighbour[place] = lists.neighbour[place - 1]
        lists.spring[place] = lists.spring[place - 1]
        lists.stiffness[place] = lists.stiffness[place - 1]
        lists.length[place] = lists.length[place - 1]
        place -= 1
    lists.neighbour[place] = other
    lists.spring[place] = spring
    lists.stiffness[place] = springs.stiffness[spring]
    lists.length[place] = springs.length[spring]
    lists.degree[node] += np.uint32(1)


@njit(cache=True, nogil=True)
def _find(lists, node, other):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    begin = lists.start[node]
    for place in range(begin, begin + lists.degree[node]):
        if lists.neighbour[place] == other:
            return np.int64(place)
    return np.int64(-1)


@njit(cache=True, nogil=True)
def _leave(lists, node, other):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    last = np.int64(lists.start[node]) + np.int64(lists.degree[node]) - 1
    for place in range(_find(lists, node, other), last):
        lists.neighbour[place] = lists.neighbour[place + 1]
        lists.spring[place] = lists.spring[place + 1]
        lists.stiffness[place] = lists.stiffness[place + 1]
        lists.length[place] = lists.length[place + 1]
    lists.degree[node] -= np.uint32(1)


@njit(cache=True, nogil=True)
def _make_room(lists, node, used):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    if lists.degree[node] < lists.room[node]:
        return used
    begin, n = np.int64(lists.start[node]), np.int64(lists.degree[node])
    for k in range(n):
        lists.neighbour[used + k] = lists.neighbour[begin + k]
        lists.spring[used + k] = lists.spring[begin + k]
        lists.stiffness[used + k] = lists.stiffness[begin + k]
        lists.length[used + k] = lists.length[begin + k]
    lists.start[node] = np.uint32(used)
    room = max(8, 2 * int(n))
    lists.room[node] = np.uint32(room)
    return used + room


@njit(cache=True, nogil=True)
def _row_of(buried, springs, a, b):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Row of the buried spring between two nodes; -1: there is none."""
    low, high = 0, len(buried)
    while low < high:
        middle = (low + high) // 2
        row = buried[middle]
        first, second = springs.ends[row, 0], springs.ends[row, 1]
        if first < a or (first == a and second < b):
            low = middle + 1
        else:
            high = middle
    if low < len(buried):
        row = buried[low]
        if springs.ends[row, 0] == a and springs.ends[row, 1] == b and not springs.alive[row]:
            return np.int64(row)
    return np.int64(-1)


@njit(cache=True, nogil=True)
def repair(
    nodes: NDArray[np.int32],
    begin: int,
    springs: Springs,
    rows: int,
    lists: Lists,
    used: int,
    elements: Elements,
    kernel_rest: NDArray[np.floating],
    modulus: float,
    scratch: Scratch,
    buried: NDArray[np.int32],
    kind: NDArray[np.int8],
    touched: NDArray[np.int32],
    count: int,
) -> tuple[int, int, int, int]:
    """Make, change or remove the springs between nodes whose elements changed.

    Modifies `springs` and `lists` in place. It stops before a node for which there may not be room.

    Args:
        nodes: Rows of the nodes, ascending; both ends of every edge whose elements changed.
        begin: First place in them to go on with.
        springs: Springs by row.
        rows: Rows of springs in use.
        lists: Springs by node.
        used: Places of the lists' data in use.
        elements: The mesh after the edit.
        kernel_rest: Rest positions in the kernel's precision, shape (node_capacity, 3).
        modulus: Young's modulus [Pa].
        scratch: `among` marks the nodes, `moved` those whose rest position is another one; `sums`
            is zero, and zero again afterwards.
        buried: Rows that springs made take over if they had the same ends, ascending by ends.
        kind: What happened to each spring touched: `CHANGED`, `MADE`, `REMOVED` or `STIFFER`;
            written.
        touched: Its row; written.
        count: Springs touched so far.

    Returns:
        The place to go on with (the number of nodes: all is done), rows of springs and places of
        the lists' data in use, and springs touched so far.
    """
    among, moved, sums = scratch
    longest = np.int64(0)
    for node in nodes:
        longest = np.int64(max(longest, lists.degree[node]))
    for place in range(begin, len(nodes)):
        a = nodes[place]
        first, last = elements.start[a], elements.start[a] + elements.degree[a]
        most = 3 * (last - first)
        # A list that overflows moves to the end, with twice the places.
        needed = 2 * (np.int64(lists.degree[a]) + most) + 2 * most * (longest + most) + 8 * most + 8
        if rows + most > len(springs.ends) or used + needed > len(lists.neighbour):
            return place, rows, used, count
        unlisted = 0
        for entry in range(first, last):
            element = elements.data[entry]
            for corner in range(4):
                b = elements.tets[element, corner]
                # Adding nothing is quicker than a branch nobody can foresee.
                counts = (b > a) & among[b]
                before = sums[b]
                sums[b] = before + elements.volumes[element] * counts
                unlisted += (before == 0.0) & counts
        at = np.int64(lists.start[a])
        end = at + np.int64(lists.degree[a])
        while at < end:
            b, spring = np.int64(lists.neighbour[at]), lists.spring[at]
            if b < a or not among[b]:
                at += 1
                continue
            volume, sums[b] = sums[b], 0.0
            if volume == 0.0:
                springs.alive[spring] = False
                _leave(lists, a, b)
                _leave(lists, b, a)
                end -= 1
                kind[count], touched[count] = REMOVED, spring
                count += 1
                continue
            unlisted -= 1
            length = _distance(kernel_rest, a, b)
            stiffness = modulus * volume / (length * length)
            # Written without being read: reading would wait for memory.
            springs.length[spring], springs.stiffness[spring] = length, stiffness
            length_before, stiffness_before = lists.length[at], lists.stiffness[at]
            lists.length[at], lists.stiffness[at] = length, stiffness
            if lists.length[at] != length_before or lists.stiffness[at] != stiffness_before:
                other = _find(lists, b, a)
                lists.length[other], lists.stiffness[other] = length, stiffness
                kind[count] = CHANGED if moved[a] or moved[b] else STIFFER
                touched[count] = spring
                count += 1
            at += 1
        if unlisted == 0:
            continue
        for entry in range(first, last):
            for corner in range(4):
                b = elements.tets[elements.data[entry], corner]
                if b <= a or sums[b] == 0.0:
                    continue
                volume, sums[b] = sums[b], 0.0
                spring = _row_of(buried, springs, a, b)
                if spring < 0:
                    spring = np.int64(rows)
                    rows += 1
                springs.ends[spring, 0], springs.ends[spring, 1] = a, b
                springs.alive[spring] = True
                length = _distance(kernel_rest, a, b)
                springs.length[spring] = length
                springs.stiffness[spring] = modulus * volume / (length * length)
                used = _make_room(lists, a, used)
                _enter(lists, a, b, spring, springs)
                used = _make_room(lists, b, used)
                _enter(lists, b, a, spring, springs)
                kind[count], touched[count] = MADE, spring
                count += 1
    return len(nodes), rows, used, count


@njit(cache=True, nogil=True)
def stiffness_at(nodes: NDArray[np.int32], lists: Lists, out: NDArray[np.float64]) -> None:
    """Sum of the stiffnesses of the springs at each node [N/m]. Writes out[nodes]."""
    for node in nodes:
        total = 0.0
        for place in range(lists.start[node], lists.start[node] + lists.degree[node]):
            total += lists.stiffness[place]
        out[node] = total
