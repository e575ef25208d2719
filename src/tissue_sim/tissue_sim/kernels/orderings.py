"""Loops that put nodes and springs into the order of a sweep."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

UNREACHED = -1
"""Level and rank of a node that the search did not reach."""


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
    shift = len(copies)
    place = used - 1
    while shift > 0:
        while place > places[shift - 1]:
            nodes[place + shift] = nodes[place]
            place -= 1
        shift -= 1
        nodes[place + 1 + shift] = copies[shift]
