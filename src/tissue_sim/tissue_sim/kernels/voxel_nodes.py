"""Loops between the nodes of a mesh and the voxels that carry them.

A node is at the trilinear mean of the voxels at the corners of its cell. Means are taken from one
of their members on, first + sum of weights (other - first): voxels that all moved alike carry their
nodes exactly as far, bit for bit, and so back.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST
from tissue_sim.kernels.voxel_lattice import CLOSE, CORNERS, Boxes, slot_of


@njit(cache=True, nogil=True, error_model="numpy")
def carry(
    rows: int,
    alive: NDArray[np.bool_],
    rest: NDArray[np.float64],
    origin: NDArray[np.float64],
    spacing: float,
    size: NDArray[np.int64],
    dirty: NDArray[np.bool_],
    element_at: NDArray[np.int64],
    element_count: NDArray[np.int32],
    elements: NDArray[np.int32],
    boxes: Boxes,
    voxel: NDArray[np.int32],
    corner: NDArray[np.int32],
    weight: NDArray[np.floating],
) -> None:
    """Find the voxels of the nodes that have a corner of their cell at a marked grid point.

    Modifies `corner`, `weight` in place, shape (node_capacity, 8): voxels and their shares, those
    with a share first; the others repeat the first one.
    """
    low, count, start, _ = boxes
    cell, share = np.empty(3, dtype=np.int64), np.empty(3)
    for n in range(rows):
        if not alive[n] or element_count[n] == 0:
            weight[n, 0] = 0
            continue
        for axis in range(3):
            x = (rest[n, axis] - origin[axis]) / spacing
            cell[axis] = min(max(int(np.floor(x + CLOSE)), 0), size[axis] - 2)
            share[axis] = min(max(x - cell[axis], 0.0), 1.0)
            if share[axis] < CLOSE:
                share[axis] = 0.0
            if share[axis] > 1.0 - CLOSE:
                share[axis] = 1.0
        touched = False
        for k in range(CORNERS):
            x, y, z = cell[0] + k // 4, cell[1] + (k // 2) % 2, cell[2] + k % 2
            touched |= dirty[(x * size[1] + y) * size[2] + z]
        if not touched:
            continue
        e, used = elements[element_at[n]], 0
        for k in range(CORNERS):
            x, y, z = cell[0] + k // 4, cell[1] + (k // 2) % 2, cell[2] + k % 2
            part = share[0] if k // 4 else 1.0 - share[0]
            part *= share[1] if (k // 2) % 2 else 1.0 - share[1]
            part *= share[2] if k % 2 else 1.0 - share[2]
            if part > 0.0:
                corner[n, used] = voxel[slot_of(start, low, count, e, x, y, z)]
                weight[n, used] = part
                used += 1
        for k in range(used, CORNERS):
            corner[n, k], weight[n, k] = corner[n, 0], 0


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def follow(
    rows: int,
    corner: NDArray[np.int32],
    weight: NDArray[np.floating],
    prescribed: NDArray[np.bool_],
    v: NDArray[np.floating],
    u: NDArray[np.floating],
) -> None:
    """Put nodes that are not prescribed where their voxels are. Modifies `u` in place."""
    for n in range(rows):
        if prescribed[n] or weight[n, 0] == 0:
            continue
        first = corner[n, 0]
        v0, v1, v2 = v[first, 0], v[first, 1], v[first, 2]
        s0 = s1 = s2 = v0 - v0
        for k in range(1, CORNERS):
            c, w = corner[n, k], weight[n, k]
            s0 += w * (v[c, 0] - v0)
            s1 += w * (v[c, 1] - v1)
            s2 += w * (v[c, 2] - v2)
        u[n, 0], u[n, 1], u[n, 2] = v0 + s0, v1 + s1, v2 + s2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def place(
    voxels: NDArray[np.int32],
    start: NDArray[np.int32],
    nodes: NDArray[np.int32],
    weight: NDArray[np.floating],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
) -> None:
    """Put voxels at the weighted mean of nodes[start[k] : start[k + 1]]. Modifies `v` in place."""
    for k in range(len(voxels)):
        first = nodes[start[k]]
        u0, u1, u2 = u[first, 0], u[first, 1], u[first, 2]
        s0 = s1 = s2 = total = u0 - u0
        for entry in range(start[k], start[k + 1]):
            n, w = nodes[entry], weight[entry]
            total += w
            s0 += w * (u[n, 0] - u0)
            s1 += w * (u[n, 1] - u1)
            s2 += w * (u[n, 2] - u2)
        i = voxels[k]
        v[i, 0], v[i, 1], v[i, 2] = u0 + s0 / total, u1 + s1 / total, u2 + s2 / total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def fill(
    missing: NDArray[np.int32],
    known: NDArray[np.bool_],
    degree: NDArray[np.uint32],
    neighbour: NDArray[np.uint32],
    v: NDArray[np.floating],
) -> None:
    """Put voxels that carry no node at the mean of linked ones, from those known on.

    Modifies `v` and `known` in place; what is linked to none that is known stays.
    """
    again = True
    while again:
        again = False
        for i in missing:
            if known[i]:
                continue
            first, others = -1, v[i, 0] - v[i, 0]
            s0 = s1 = s2 = others
            for k in range(degree[i]):
                j = neighbour[i, k]
                if not known[j]:
                    continue
                if first < 0:
                    first = int(j)
                others += 1
                s0 += v[j, 0] - v[first, 0]
                s1 += v[j, 1] - v[first, 1]
                s2 += v[j, 2] - v[first, 2]
            if first >= 0:
                v[i, 0] = v[first, 0] + s0 / others
                v[i, 1] = v[first, 1] + s1 / others
                v[i, 2] = v[first, 2] + s2 / others
                known[i] = again = True
