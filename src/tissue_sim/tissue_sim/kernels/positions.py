"""Positions from rest and displacement, checked on the way."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def _place_in(order, rows, row):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Place of a row in rows, which `order` puts in ascending order; -1: it is not there."""
    low, high = 0, len(order)
    while low < high:
        middle = (low + high) // 2
        if rows[order[middle]] < row:
            low = middle + 1
        else:
            high = middle
    if low < len(order) and rows[order[low]] == row:
        return order[low]
    return np.int64(-1)


# No fastmath: it would let the compiler drop the test that finds a nan.
@njit(cache=True, nogil=True, error_model="numpy")
def place_nodes(
    rest: NDArray[np.float64],
    displacement: NDArray[np.floating],
    limit: float,
    positions: NDArray[np.float32],
) -> int:
    """Write positions and count the nodes that are not finite or farther from rest than `limit`.

    Args:
        rest: Rest positions [m], shape (n, 3).
        displacement: Displacements from rest [m], shape (n, 3).
        limit: Largest displacement along an axis that is believed [m].
        positions: Result [m], shape (n, 3).
    """
    bad = 0
    for node in range(rest.shape[0]):
        good = True
        for axis in range(3):
            u = displacement[node, axis]
            positions[node, axis] = np.float32(rest[node, axis] + u)
            if not abs(u) <= limit:
                good = False
        if not good:
            bad += 1
    return bad


@njit(cache=True, nogil=True, error_model="numpy")
def carry_moved(
    moved: NDArray[np.int32],
    anchors: NDArray[np.int32],
    weights: NDArray[np.float64],
    old_rest: NDArray[np.float64],
    order: NDArray[np.int64],
    rest: NDArray[np.float64],
    displacement: NDArray[np.floating],
) -> None:
    """Put nodes whose rest position moved to the mean of their anchors as they were.

    Args:
        moved: Rows of the nodes, shape (m,).
        anchors: Rows of the anchors of each, shape (m, 4).
        weights: Weights of the anchors, shape (m, 4).
        old_rest: Rest positions of the moved nodes before [m], shape (m, 3).
        order: What puts `moved` in ascending order, shape (m,).
        rest: Rest positions now [m], shape (n, 3).
        displacement: Displacements [m], shape (n, 3); modified in place.
    """
    places = np.zeros((len(moved), 3))
    for k in range(len(moved)):
        for corner in range(4):
            anchor = anchors[k, corner]
            was = _place_in(order, moved, anchor)
            for axis in range(3):
                before = old_rest[was, axis] if was >= 0 else rest[anchor, axis]
                places[k, axis] += weights[k, corner] * (before + displacement[anchor, axis])
    for k in range(len(moved)):
        for axis in range(3):
            displacement[moved[k], axis] = places[k, axis] - rest[moved[k], axis]


@njit(cache=True, nogil=True, error_model="numpy")
def nodes_within(
    rest: NDArray[np.float64],
    displacement: NDArray[np.floating],
    may: NDArray[np.bool_],
    may_not: NDArray[np.bool_],
    rows: int,
    centre: NDArray[np.float64],
    radius: float,
    found: NDArray[np.int32],
) -> int:
    """Find the nodes within a sphere.

    Args:
        rest: Rest positions [m], shape (n, 3).
        displacement: Displacements [m], shape (n, 3).
        may: Nodes that count, shape (n,).
        may_not: Nodes of those that do not, shape (n,).
        rows: Nodes [0, rows) are looked at.
        centre: Its centre [m], shape (3,).
        radius: Its radius [m].
        found: Their rows, ascending; written, shape (rows,).

    Returns:
        How many there are.
    """
    count = 0
    for node in range(rows):
        squared = 0.0
        for axis in range(3):
            way = rest[node, axis] + displacement[node, axis] - centre[axis]
            squared += way * way
        if squared <= radius * radius and may[node] and not may_not[node]:
            found[count] = node
            count += 1
    return count
