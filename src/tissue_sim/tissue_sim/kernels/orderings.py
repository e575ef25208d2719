"""Loops that put nodes and springs into the order of a sweep."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

UNREACHED = -1
"""Level, rank and key of a node that the search did not reach."""

GAP = 1 << 20
"""Between the keys of two nodes that a search put one behind the other: room for keys between."""

CHUNK = 256
"""Nodes that are moved up at once."""


@njit(cache=True, nogil=True)
def breadth_first(
    sources: NDArray[np.int32],
    start: NDArray[np.uint32],
    count: NDArray[np.uint32],
    neighbour: NDArray[np.uint32],
    blocked: NDArray[np.bool_],
    depth: int,
    level: NDArray[np.int32],
    nodes: NDArray[np.uint32],
    level_start: NDArray[np.int32],
) -> tuple[int, int]:
    """Breadth-first search over springs, neighbours in the order of their lists.

    Args:
        sources: Nodes of level 0, in visiting order.
        start: Springs by node, as in `SpringArrays`.
        count: Springs by node.
        neighbour: Springs by node.
        blocked: Nodes that the search does not enter (sources excepted), shape (node_capacity,).
        depth: Last level to visit.
        level: Level of each node; must be `UNREACHED` everywhere, written, shape (node_capacity,).
        nodes: Visited nodes in order; written, shape (node_capacity,).
        level_start: Where each level begins in `nodes`, one more entry than levels; written, shape
            (node_capacity + 2,).

    Returns:
        Number of visited nodes and of levels.
    """
    reached = 0
    for source in sources:
        if level[source] == UNREACHED:
            level[source] = 0
            nodes[reached] = source
            reached += 1
    level_start[0] = 0
    levels, begin = 0, 0
    while begin < reached:
        end = reached
        levels += 1
        level_start[levels] = end
        if levels > depth:
            break
        for place in range(begin, end):
            i = nodes[place]
            for entry in range(start[i], start[i] + count[i]):
                j = neighbour[entry]
                if level[j] == UNREACHED and not blocked[j]:
                    level[j] = levels
                    nodes[reached] = j
                    reached += 1
        begin = end
    return reached, levels


@njit(cache=True, nogil=True)
def append_rest(
    rows: int,
    blocked: NDArray[np.bool_],
    alive: NDArray[np.bool_],
    level: NDArray[np.int32],
    nodes: NDArray[np.uint32],
    used: int,
) -> int:
    """Put the nodes that a search did not reach behind the others; returns how many there are."""
    for i in range(rows):
        if alive[i] and level[i] == UNREACHED and not blocked[i]:
            nodes[used] = i
            used += 1
    return used


@njit(cache=True, nogil=True)
def forget(
    nodes: NDArray[np.uint32], used: int, level: NDArray[np.int32], key: NDArray[np.int64]
) -> None:
    """Nodes in order, nodes[:used], are not in it any more. Modifies `level` and `key` in place."""
    for place in range(used):
        level[nodes[place]] = UNREACHED
        key[nodes[place]] = UNREACHED


@njit(cache=True, nogil=True)
def number(nodes: NDArray[np.uint32], used: int, key: NDArray[np.int64]) -> None:
    """Give the nodes in order, nodes[:used], keys that grow along it. Writes `key`."""
    for place in range(used):
        key[nodes[place]] = (place + 1) * GAP


@njit(cache=True, nogil=True)
def find_places(
    wanted: NDArray[np.int32],
    nodes: NDArray[np.uint32],
    used: int,
    key: NDArray[np.int64],
    out: NDArray[np.int32],
) -> None:
    """Write the place of each node wanted in nodes[:used], -1 where it is not there."""
    for k in range(len(wanted)):
        own = key[wanted[k]]
        if own == UNREACHED:
            out[k] = UNREACHED
            continue
        low, high = 0, used
        while low < high:
            middle = (low + high) // 2
            if key[nodes[middle]] < own:
                low = middle + 1
            else:
                high = middle
        out[k] = low


@njit(cache=True, nogil=True)
def take_out(places: NDArray[np.int32], nodes: NDArray[np.uint32], used: int) -> None:
    """Close up the order where places, ascending, are given up. Modifies `nodes` in place."""
    for k in range(len(places)):
        end = places[k + 1] if k + 1 < len(places) else used
        for place in range(places[k] + 1, end):
            nodes[place - k - 1] = nodes[place]


@njit(cache=True, nogil=True)
def leave_lingering(nodes: NDArray[np.uint32], end: int, member: NDArray[np.bool_]) -> None:
    """Nodes of the region, nodes[:end], linger no more. Modifies `member` in place."""
    for place in range(end):
        member[nodes[place]] = False


@njit(cache=True, nogil=True)
def pick_lingering(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    u: NDArray[np.floating],
    prescribed: NDArray[np.bool_],
    elsewhere: NDArray[np.bool_],
    member: NDArray[np.bool_],
    last_move: NDArray[np.floating],
    out: NDArray[np.uint32],
) -> int:
    """Collect the free members of nodes[begin:end] in their order.

    Args:
        nodes: Nodes in order.
        begin: First place to look at.
        end: One past the last.
        u: Displacements [m].
        prescribed: Nodes that do not move.
        elsewhere: Where displaced nodes may become members.
        member: Whether a node lingers; modified in place.
        last_move: Last move of each lingering node [m]; zeroed for those that are none.
        out: The members; written.

    Returns:
        How many there are.
    """
    n = 0
    for place in range(begin, end):
        i = nodes[place]
        if elsewhere[i] and (u[i, 0] != 0 or u[i, 1] != 0 or u[i, 2] != 0):
            member[i] = True
        if prescribed[i]:
            member[i] = False
        if member[i]:
            out[n] = i
            n += 1
        else:
            last_move[i, 0] = last_move[i, 1] = last_move[i, 2] = 0
    return n


@njit(cache=True, nogil=True)
def insert_behind(
    copies: NDArray[np.int32], places: NDArray[np.int32], nodes: NDArray[np.uint32], used: int
) -> None:
    """Put each copy behind the node at its place. Modifies `nodes` in place.

    Args:
        copies: Nodes to insert, shape (n,).
        places: Place of the node each goes behind, ascending, shape (n,).
        nodes: The order, with room for n more.
        used: Places in use before.
    """
    some = np.empty(CHUNK, dtype=nodes.dtype)
    end = used
    for shift in range(len(copies), 0, -1):
        begin = places[shift - 1] + 1
        # By way of another array, so that neither half of a move waits for the other.
        while end > begin:
            chunk = min(CHUNK, end - begin)
            end -= chunk
            here, there = nodes[end : end + chunk], nodes[end + shift : end + shift + chunk]
            for k in range(chunk):
                some[k] = here[k]
            for k in range(chunk):
                there[k] = some[k]
        nodes[begin + shift - 1] = copies[shift - 1]


@njit(cache=True, nogil=True)
def key_copies(
    places: NDArray[np.int32], nodes: NDArray[np.uint32], used: int, key: NDArray[np.int64]
) -> bool:
    """Give copies that `insert_behind` has inserted keys between those around. Writes `key`.

    Args:
        places: As given to it.
        nodes: The order, with the copies.
        used: Places in use with them.
        key: Key of each node in order.

    Returns:
        Whether there was room for all between the keys; if not, the nodes need new ones.
    """
    first = 0
    while first < len(places):
        last = first
        while last < len(places) and places[last] == places[first]:
            last += 1
        more = last - first
        begin = places[first] + first
        behind = begin + more + 1
        own = key[nodes[begin]]
        end = key[nodes[behind]] if behind < used else own + (more + 1) * GAP
        step = (end - own) // (more + 1)
        if step < 1:
            return False
        for k in range(1, more + 1):
            key[nodes[begin + k]] = own + k * step
        first = last
    return True


@njit(cache=True, nogil=True)
def count_levels(
    nodes: NDArray[np.int32],
    level: NDArray[np.int32],
    levels: int,
    sign: int,
    level_start: NDArray[np.int32],
) -> int:
    """Let levels have so many nodes more (sign 1) or fewer (-1). Modifies `level_start` in place.

    Returns:
        How many of the nodes have a level.
    """
    reached = 0
    for node in nodes:
        if level[node] == UNREACHED:
            continue
        reached += 1
        for after in range(level[node] + 1, levels + 1):
            level_start[after] += sign
    return reached


@njit(cache=True, nogil=True)
def join_lingering(
    near: NDArray[np.uint32],
    count: int,
    level: NDArray[np.int32],
    deepest: int,
    prescribed: NDArray[np.bool_],
    alive: NDArray[np.bool_],
    member: NDArray[np.bool_],
    last_move: NDArray[np.floating],
    nodes: NDArray[np.uint32],
    used: int,
) -> int:
    """Let free nodes outside the region linger, behind those that do.

    Args:
        near: Nodes that may, shape (count,) or longer.
        count: How many of them.
        level: Level of each node in the order whose beginning is the region.
        deepest: Last level of the region; -1: there is none.
        prescribed: Nodes that do not move.
        alive: Nodes that exist.
        member: Whether a node lingers; modified in place.
        last_move: Last move of each lingering node [m]; zeroed for those that join.
        nodes: Nodes that linger; written.
        used: How many there are.

    Returns:
        How many there are now.
    """
    for place in range(count):
        i = near[place]
        swept = level[i] != UNREACHED and level[i] <= deepest
        if swept or member[i] or prescribed[i] or not alive[i]:
            continue
        member[i] = True
        last_move[i, 0] = last_move[i, 1] = last_move[i, 2] = 0
        nodes[used] = i
        used += 1
    return used


@njit(cache=True, nogil=True)
def insert_copies(
    copies: NDArray[np.int32],
    parents: NDArray[np.int32],
    along: NDArray[np.int64],
    nodes: NDArray[np.uint32],
    used: int,
    level: NDArray[np.int32],
    levels: int,
    level_start: NDArray[np.int32],
    key: NDArray[np.int64],
) -> tuple[int, int]:
    """Put copies behind their parents, those that are in the order, at the same level.

    Modifies `nodes`, `level`, `level_start` and `key` in place.

    Args:
        copies: Nodes to insert, shape (n,).
        parents: Nodes that they go behind, shape (n,).
        along: What puts the parents in ascending order of their keys, shape (n,).
        nodes: The order, with room for n more.
        used: Places in use before.
        level: Level of each node.
        levels: Number of levels.
        level_start: Where each level begins in `nodes`.
        key: Key of each node in order.

    Returns:
        Places in use now, and how many of the copies have a level.
    """
    first = 0
    while first < len(along) and key[parents[along[first]]] == UNREACHED:
        first += 1
    along = along[first:]
    if len(along) == 0:
        return used, 0
    inserted, behind = copies[along], parents[along]
    places = np.empty(len(along), dtype=np.int32)
    find_places(behind, nodes, used, key, places)
    for k in range(len(along)):
        level[inserted[k]] = level[behind[k]]
    insert_behind(inserted, places, nodes, used)
    used += len(along)
    if not key_copies(places, nodes, used, key):
        number(nodes, used, key)
    return used, count_levels(inserted, level, levels, 1, level_start)
