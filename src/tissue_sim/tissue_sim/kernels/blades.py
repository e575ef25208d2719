"""Which nodes are at a blade."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(
    cache=True, nogil=True, error_model="numpy",
    fastmath={"contract", "nnan", "ninf", "nsz", "arcp"},
)  # fmt: skip
def nodes_at_blade(
    rest: NDArray[np.float64],
    displacement: NDArray[np.floating],
    alive: NDArray[np.bool_],
    rows: int,
    place: NDArray[np.float64],
    turn: NDArray[np.float64],
    corners: NDArray[np.float64],
    outwards: NDArray[np.float64],
    reach: float,
    found: NDArray[np.int32],
) -> int:
    """Find the nodes that lie at most `reach` off a flat convex blade, in its plane and across it.

    Args:
        rest: Rest positions [m], shape (n, 3).
        displacement: Displacements [m], shape (n, 3).
        alive: Nodes that count, shape (n,).
        rows: Nodes [0, rows) are looked at.
        place: Position of the blade [m], shape (3,).
        turn: Its rotation matrix, shape (3, 3).
        corners: Its corners in its own axes, in the plane y = 0 [m], shape (k, 3).
        outwards: Unit vectors out of its sides, shape (k, 3); side i begins at corner i.
        reach: How far a node may be [m].
        found: Their rows, ascending; written, shape (rows,).

    Returns:
        How many there are.
    """
    count = 0
    for node in range(rows):
        x = rest[node, 0] + displacement[node, 0] - place[0]
        y = rest[node, 1] + displacement[node, 1] - place[1]
        z = rest[node, 2] + displacement[node, 2] - place[2]
        if abs(x * turn[0, 1] + y * turn[1, 1] + z * turn[2, 1]) > reach or not alive[node]:
            continue
        u = x * turn[0, 0] + y * turn[1, 0] + z * turn[2, 0]
        w = x * turn[0, 2] + y * turn[1, 2] + z * turn[2, 2]
        near = True
        for side in range(corners.shape[0]):
            off = (u - corners[side, 0]) * outwards[side, 0]
            off += (w - corners[side, 2]) * outwards[side, 2]
            near = near and off <= reach
        if near:
            found[count] = node
            count += 1
    return count
