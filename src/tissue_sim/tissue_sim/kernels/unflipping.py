"""A loop that turns elements back which have been turned inside out."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.networks import Elements
from tissue_sim.kernels.springs import SpringArrays


@njit(cache=True, nogil=True)
def _is_inverted(rest, u, tet):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    a, b, c, d = tet[0], tet[1], tet[2], tet[3]
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
    return cross < 0.0


@njit(cache=True, nogil=True)
def unflip_nodes(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    rest: NDArray[np.float64],
    elements: Elements,
    springs: SpringArrays,
    u: NDArray[np.floating],
    last_move: NDArray[np.floating],
) -> int:
    """Give nodes of inverted elements the mean displacement of their neighbours.

    Springs know no inside: a node pushed through the triangle opposite to it finds a second
    equilibrium there and stays. Displaced like its neighbours it is on the right side of them.

    Args:
        nodes: Nodes to look at, none of them prescribed.
        begin: First place in `nodes`.
        end: One past the last.
        rest: Rest positions [m], shape (node_capacity, 3).
        elements: The mesh.
        springs: Springs by node.
        u: Displacements [m]; modified in place.
        last_move: Last move of each node [m]; zeroed for those put back.

    Returns:
        Number of nodes put back.
    """
    put_back = 0
    for place in range(begin, end):
        i = nodes[place]
        first, inverted = elements.start[i], False
        for entry in range(first, first + elements.degree[i]):
            if _is_inverted(rest, u, elements.tets[elements.data[entry]]):
                inverted = True
                break
        if not inverted:
            continue
        put_back += 1
        n = springs.degree[i]
        for axis in range(3):
            total = 0.0
            for spring in range(springs.start[i], springs.start[i] + n):
                total += u[springs.neighbour[spring], axis]
            u[i, axis] = total / n
            last_move[i, axis] = 0
    return put_back
