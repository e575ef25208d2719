"""A loop that finds elements that have been turned inside out."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def free_nodes_of_inverted(
    begin: int,
    end: int,
    tets: NDArray[np.int32],
    alive: NDArray[np.bool_],
    rest: NDArray[np.floating],
    u: NDArray[np.floating],
    prescribed: NDArray[np.bool_],
    out: NDArray[np.uint32],
) -> int:
    """List the free nodes of the inverted ones among elements [begin, end), repeatedly if shared.

    Args:
        begin: First row of elements to look at.
        end: One past the last.
        tets: Node rows, positively oriented at rest, shape (element_capacity, 4).
        alive: Elements that exist, shape (element_capacity,).
        rest: Rest positions [m], shape (node_capacity, 3).
        u: Displacements [m], shape (node_capacity, 3).
        prescribed: Nodes not to list, shape (node_capacity,).
        out: Rows of nodes; written, room for 4 (end - begin).

    Returns:
        How many are listed.
    """
    count = 0
    for row in range(begin, end):
        if not alive[row]:
            continue
        a, b, c, d = tets[row, 0], tets[row, 1], tets[row, 2], tets[row, 3]
        p0 = rest[b, 0] - rest[a, 0] + (u[b, 0] - u[a, 0])
        p1 = rest[b, 1] - rest[a, 1] + (u[b, 1] - u[a, 1])
        p2 = rest[b, 2] - rest[a, 2] + (u[b, 2] - u[a, 2])
        q0 = rest[c, 0] - rest[a, 0] + (u[c, 0] - u[a, 0])
        q1 = rest[c, 1] - rest[a, 1] + (u[c, 1] - u[a, 1])
        q2 = rest[c, 2] - rest[a, 2] + (u[c, 2] - u[a, 2])
        r0 = rest[d, 0] - rest[a, 0] + (u[d, 0] - u[a, 0])
        r1 = rest[d, 1] - rest[a, 1] + (u[d, 1] - u[a, 1])
        r2 = rest[d, 2] - rest[a, 2] + (u[d, 2] - u[a, 2])
        cross = p0 * (q1 * r2 - q2 * r1) + p1 * (q2 * r0 - q0 * r2) + p2 * (q0 * r1 - q1 * r0)
        if cross < 0.0:
            for corner in range(4):
                node = tets[row, corner]
                if not prescribed[node]:
                    out[count] = node
                    count += 1
    return count
