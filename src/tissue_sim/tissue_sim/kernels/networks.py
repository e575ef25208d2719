"""Loops that build a spring network from the elements of a mesh and repair it after an edit.

Sums over the elements at an edge or a node run in ascending order of element rows, whatever the
order of the incidence lists, so that a repaired sum equals that of a network built afresh bit for
bit. No fastmath here, for the same reason.
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


@njit(cache=True, nogil=True)
def edge_keys(tets: NDArray[np.int32], keys: NDArray[np.int64]) -> int:
    """Write lower row * 2^32 + higher row for each edge of elements, -1 for none; how many."""
    used = 0
    for tet in tets:
        if tet[0] < 0:
            continue
        for i in range(3):
            for j in range(i + 1, 4):
                low, high = min(tet[i], tet[j]), max(tet[i], tet[j])
                keys[used] = (np.int64(low) << 32) | np.int64(high)
                used += 1
    return used


@njit(cache=True, nogil=True)
def distinct_edges(keys: NDArray[np.int64], edges: NDArray[np.int32]) -> int:
    """Write the rows of each distinct one of sorted keys, shape (n, 2); returns n."""
    used = 0
    for place in range(len(keys)):
        if place == 0 or keys[place] != keys[place - 1]:
            edges[used, 0], edges[used, 1] = keys[place] >> 32, keys[place] & 0xFFFFFFFF
            used += 1
    return used


@njit(cache=True, nogil=True)
def _volume(rest, tet):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    a, b, c, d = rest[tet[0]], rest[tet[1]], rest[tet[2]], rest[tet[3]]
    p0, p1, p2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    q0, q1, q2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    r0, r1, r2 = d[0] - a[0], d[1] - a[1], d[2] - a[2]
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
        out[row] = _volume(rest, tets[row]) if tets[row, 0] >= 0 else 0.0


@njit(cache=True, nogil=True)
def volume_at(elements: Elements, node: int, other: int, found: NDArray[np.int32]) -> float:
    """Rest volume of elements at `node` that also have `other` (-1: all) [m^3]; 0: there is none.

    `found` is scratch, as long as the longest incidence list; it ends up with the elements in
    ascending order.
    """
    begin, n = elements.start[node], 0
    for place in range(begin, begin + elements.degree[node]):
        element = elements.data[place]
        tet = elements.tets[element]
        if other < 0 or other in (tet[0], tet[1], tet[2], tet[3]):
            slot = n
            while slot > 0 and found[slot - 1] > element:
                found[slot] = found[slot - 1]
                slot -= 1
            found[slot] = element
            n += 1
    total = 0.0
    for place in range(n):
        total += elements.volumes[found[place]]
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
    found: NDArray[np.int32],
) -> None:
    """Stiffness and rest length of springs [0, rows). Writes them into `springs`."""
    for spring in range(rows):
        a, b = springs.ends[spring]
        volume = volume_at(elements, a, b, found)
        length = _distance(kernel_rest, a, b)
        springs.length[spring] = length
        springs.stiffness[spring] = modulus * volume / (length * length)


@njit(cache=True, nogil=True)
def node_volumes(
    nodes: NDArray[np.int32],
    elements: Elements,
    found: NDArray[np.int32],
    out: NDArray[np.float64],
) -> None:
    """A quarter of the rest volume of the elements at each node [m^3]. Writes out[nodes]."""
    for node in nodes:
        out[node] = volume_at(elements, node, -1, found) / 4.0


@njit(cache=True, nogil=True)
def fill_lists(springs: Springs, rows: int, lists: Lists) -> None:
    """Enter springs [0, rows) at both of their ends. Modifies `lists`, whose degrees start at 0."""
    for spring in range(rows):
        if springs.alive[spring]:
            _enter(lists, springs.ends[spring, 0], springs.ends[spring, 1], spring, springs)
            _enter(lists, springs.ends[spring, 1], springs.ends[spring, 0], spring, springs)


@njit(cache=True, nogil=True)
def _enter(lists, node, other, spring, springs):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    place = lists.start[node] + lists.degree[node]
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
def repair(
    edges: NDArray[np.int32],
    springs: Springs,
    rows: int,
    lists: Lists,
    used: int,
    elements: Elements,
    kernel_rest: NDArray[np.floating],
    modulus: float,
    found: NDArray[np.int32],
    kind: NDArray[np.int8],
    touched: NDArray[np.int32],
) -> tuple[int, int]:
    """Make, change or remove the springs of edges whose elements changed.

    Modifies `springs` and `lists` in place.

    Args:
        edges: Node rows of the edges, lower row first, shape (n, 2).
        springs: With room for n more rows.
        rows: Rows of springs in use.
        lists: With room in their data.
        used: Places of the lists' data in use.
        elements: The mesh after the edit.
        kernel_rest: Rest positions in the kernel's precision, shape (node_capacity, 3).
        modulus: Young's modulus [Pa].
        found: Scratch, as long as the longest incidence list.
        kind: What happened to each edge's spring: 0 nothing, 1 changed, 2 made, 3 removed; written,
            shape (n,).
        touched: Its row; written, shape (n,).

    Returns:
        Rows of springs and places of the lists' data in use afterwards.
    """
    for n in range(len(edges)):
        a, b = edges[n]
        place = _find(lists, a, b)
        # The elements at both ends are those of either; the shorter list is read.
        if elements.degree[a] <= elements.degree[b]:
            volume = volume_at(elements, a, b, found)
        else:
            volume = volume_at(elements, b, a, found)
        kind[n] = 0
        if volume == 0.0:
            if place >= 0:
                touched[n] = lists.spring[place]
                kind[n] = 3
                springs.alive[touched[n]] = False
                _leave(lists, a, b)
                _leave(lists, b, a)
            continue
        if place >= 0:
            spring = lists.spring[place]
            kind[n] = 1
        else:
            spring = rows
            rows += 1
            kind[n] = 2
            springs.ends[spring, 0], springs.ends[spring, 1] = a, b
            springs.alive[spring] = True
        touched[n] = spring
        length = _distance(kernel_rest, a, b)
        springs.length[spring] = length
        springs.stiffness[spring] = modulus * volume / (length * length)
        if kind[n] == 2:
            used = _make_room(lists, a, used)
            _enter(lists, a, b, spring, springs)
            used = _make_room(lists, b, used)
            _enter(lists, b, a, spring, springs)
        else:
            other = _find(lists, b, a)
            lists.stiffness[place] = lists.stiffness[other] = springs.stiffness[spring]
            lists.length[place] = lists.length[other] = springs.length[spring]
    return rows, used


@njit(cache=True, nogil=True)
def stiffness_at(nodes: NDArray[np.int32], lists: Lists, out: NDArray[np.float64]) -> None:
    """Sum of the stiffnesses of the springs at each node [N/m]. Writes out[nodes]."""
    for node in nodes:
        total = 0.0
        for place in range(lists.start[node], lists.start[node] + lists.degree[node]):
            total += lists.stiffness[place]
        out[node] = total
