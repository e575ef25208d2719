"""Where a sweep crosses the edges of a mesh, each edge once for all elements that share it.

An edge is crossed if it passes through an odd number of the sweep's triangles: its ends then lie on
different sides. One that passes an even number of times, around a fold of the sweep, is not: both
its ends are on the same side. So within an element the crossed edges are a cut between two groups
of corners wherever the sweep passes right through it, and are not where the sweep ends in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.neighbours import Links, has_node
from cut_service.sweep import Sweep
from cut_service.sweep_kernels import EDGES, above_plane, line_inside

MOST_PASSES = 15
"""Passages of one edge through the sweep that are looked at."""


def _edge_numbers() -> NDArray[np.int32]:
    numbers = np.full((4, 4), -1, dtype=np.int32)
    for number, (i, j) in enumerate(EDGES):
        numbers[i, j] = numbers[j, i] = number
    return numbers


EDGE_BETWEEN = _edge_numbers()
"""Number of the edge between two corners, shape (4, 4)."""


def _parted() -> NDArray[np.bool_]:
    table = np.zeros(64, dtype=np.bool_)
    for corners in range(1, 15):
        mask = 0
        for number, (i, j) in enumerate(EDGES):
            mask |= (((corners >> i) ^ (corners >> j)) & 1) << number
        table[mask] = True
    return table


PARTED = _parted()
"""Sets of crossed edges that part an element's corners into two groups, by bits of the edges."""


@dataclass(frozen=True)
class Crossings:
    """What the sweep crosses.

    Attributes:
        elements: Rows of elements with a crossed edge, ascending, shape (n,).
        edges: Node rows of the crossed edges, the lower first, ascending, shape (m, 2).
        shares: Where the sweep passes each, as the weight of its second end, shape (m,).
        active: Edges of an element that the sweep passes right through, shape (m,).
        masks: For every element row its crossed edges, bits in the order of `EDGES`, shape
            (element_rows,).
    """

    elements: NDArray[np.int32]
    edges: NDArray[np.int32]
    shares: NDArray[np.float64]
    active: NDArray[np.bool_]
    masks: NDArray[np.uint8]


@njit(cache=True, nogil=True, error_model="numpy")
def _height(
    p: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]
) -> float:
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return nx * (p[0] - a[0]) + ny * (p[1] - a[1]) + nz * (p[2] - a[2])


@njit(cache=True, nogil=True, error_model="numpy")
def _pass_edges(
    positions: NDArray[np.float64],
    edges: NDArray[np.int32],
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    passes: NDArray[np.int32],
    shares: NDArray[np.float64],
) -> None:
    """Count how often the sweep passes each edge, and say where it does the middle time."""
    where = np.empty(MOST_PASSES)
    for k in range(edges.shape[0]):
        p, q = positions[edges[k, 0]], positions[edges[k, 1]]
        count = 0
        for t in range(triangles.shape[0]):
            a, b, c = (
                vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]],
            )  # fmt: skip
            apart = False
            for axis in range(3):
                low, high = min(p[axis], q[axis]), max(p[axis], q[axis])
                apart = apart or low > max(a[axis], max(b[axis], c[axis]))
                apart = apart or high < min(a[axis], min(b[axis], c[axis]))
            if apart or above_plane(p, a, b, c) == above_plane(q, a, b, c):
                continue
            if line_inside(p, q, vertices, triangles[t]) and count < MOST_PASSES:
                here, there = _height(p, a, b, c), _height(q, a, b, c)
                where[count] = min(1.0, max(0.0, here / (here - there)))
                count += 1
        passes[k] = count
        shares[k] = np.sort(where[:count])[count // 2] if count else 0.0


@njit(cache=True, nogil=True)
def _mark(links: Links, edges: NDArray[np.int32], masks: NDArray[np.uint8]) -> None:
    for k in range(edges.shape[0]):
        a, b = edges[k, 0], edges[k, 1]
        for place in range(links.start[a], links.start[a] + links.length[a]):
            element = links.data[place]
            if has_node(links, element, b):
                i, j = 0, 0
                for corner in range(4):
                    if links.tets[element, corner] == a:
                        i = corner
                    if links.tets[element, corner] == b:
                        j = corner
                masks[element] |= 1 << EDGE_BETWEEN[i, j]


@njit(cache=True, nogil=True)
def _activate(
    links: Links,
    edges: NDArray[np.int32],
    masks: NDArray[np.uint8],
    parted: NDArray[np.bool_],
    active: NDArray[np.bool_],
) -> None:
    for k in range(edges.shape[0]):
        a, b = edges[k, 0], edges[k, 1]
        active[k] = False
        for place in range(links.start[a], links.start[a] + links.length[a]):
            element = links.data[place]
            if parted[masks[element]] and has_node(links, element, b):
                active[k] = True


def find_crossings(
    links: Links,
    positions: NDArray[np.float64],
    sweep: Sweep,
    rows: NDArray[np.int32],
    touched: NDArray[np.uint8],
) -> Crossings:
    """Find the edges that a sweep crosses, in the configuration given.

    Args:
        links: The mesh.
        positions: Node positions [m], shape (node_rows, 3).
        sweep: What crosses them.
        rows: Elements with an edge that meets a triangle of the sweep, ascending, shape (n,).
        touched: Those edges, bits in the order of `EDGES`, shape (n,).
    """
    pairs = links.tets[rows][:, EDGES]
    pairs = pairs[(touched[:, None] >> np.arange(6)) & 1 > 0].astype(np.int64)
    keys = np.unique(pairs.min(axis=1) * len(positions) + pairs.max(axis=1))
    edges = np.stack([keys // len(positions), keys % len(positions)], axis=1).astype(np.int32)
    passes, shares = np.zeros(len(edges), dtype=np.int32), np.zeros(len(edges))
    _pass_edges(positions, edges, sweep.vertices, sweep.triangles, passes, shares)
    odd = passes % 2 == 1
    edges, shares = np.ascontiguousarray(edges[odd]), shares[odd]
    masks = np.zeros(len(links.tets), dtype=np.uint8)
    _mark(links, edges, masks)
    active = np.zeros(len(edges), dtype=np.bool_)
    _activate(links, edges, masks, PARTED, active)
    return Crossings(rows, edges, shares, active, masks)
