"""Elements by node, laid out for a sweep over the nodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.matter import Matter
from tissue_sim.kernels.mixed_matter import ROWS, write_matter
from tissue_sim.kernels.networks import Elements

LANES = 8
"""A node's rows are filled up to a multiple of so many elements of no volume."""

FLAT = 1e-12
"""Share of the cube of its edges below which an element's volume counts as none."""


class VertexBlocks(NamedTuple):
    """What a sweep reads of the elements at each node, each list contiguous.

    The list of node i has `lanes[i]` places and begins at place `start[i]`: its ten rows of
    `gradients` at 10 start[i] (g_a, g_b, g_c by components [1/m] and V [m^3]), its three rows of
    `corners` at 3 start[i] (the other corners; the node itself on filled-up places). V is scaled by
    the element's shear modulus over the tissue's own.

    Attributes:
        start: First place of each list, shape (node_capacity,), uint64.
        lanes: Places of each list in use, a multiple of `LANES`, uint64.
        room: Places each list has, uint64.
        corners: Node rows, uint32.
        gradients: Rest gradients and volumes, the kernels' precision.
        shear: Sum of V |g|^2 at each node [m], shape (node_capacity,).
        third: Sum of V |g|^3 at each node, shape (node_capacity,).
        matter: Rows of `mixed_matter`, `ROWS` times as long as the places; empty where neither
            Poisson's ratio varies nor fibres are stiff.
    """

    start: NDArray[np.uint64]
    lanes: NDArray[np.uint64]
    room: NDArray[np.uint64]
    corners: NDArray[np.uint32]
    gradients: NDArray[np.floating]
    shear: NDArray[np.floating]
    third: NDArray[np.floating]
    matter: NDArray[np.floating]


@njit(inline="always")
def _cross(a0, a1, a2, b0, b1, b2):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@njit(cache=True, nogil=True)
def _shape_gradients(rest, i, a, b, c, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Gradients of the shape functions of a, b, c into out[:9] [1/m]; the volume [m^3]."""
    x0, x1, x2 = rest[a, 0] - rest[i, 0], rest[a, 1] - rest[i, 1], rest[a, 2] - rest[i, 2]
    y0, y1, y2 = rest[b, 0] - rest[i, 0], rest[b, 1] - rest[i, 1], rest[b, 2] - rest[i, 2]
    z0, z1, z2 = rest[c, 0] - rest[i, 0], rest[c, 1] - rest[i, 1], rest[c, 2] - rest[i, 2]
    out[0], out[1], out[2] = _cross(y0, y1, y2, z0, z1, z2)
    out[3], out[4], out[5] = _cross(z0, z1, z2, x0, x1, x2)
    out[6], out[7], out[8] = _cross(x0, x1, x2, y0, y1, y2)
    det = x0 * out[0] + x1 * out[1] + x2 * out[2]
    xx, yy = x0 * x0 + x1 * x1 + x2 * x2, y0 * y0 + y1 * y1 + y2 * y2
    zz = z0 * z0 + z1 * z1 + z2 * z2
    longest = max(xx, yy, zz)
    flat = det * det <= FLAT**2 * longest * longest * longest
    for k in range(9):
        out[k] = 0.0 if flat else out[k] / det
    return 0.0 if flat else abs(det) / 6.0


@njit(cache=True, nogil=True)
def fill_blocks(
    nodes: NDArray[np.int32],
    begin: int,
    elements: Elements,
    rest: NDArray[np.float64],
    base: NDArray[np.float64],
    matter: Matter,
    blocks: VertexBlocks,
    used: int,
    scratch: NDArray[np.float64],
) -> tuple[int, int]:
    """Write the lists of nodes[begin:] anew. Modifies `blocks` in place.

    It stops before a node whose list needs a new place that there is no room for. Elements without
    volume take part with zeros, and so make no force.

    Args:
        nodes: Rows of nodes.
        begin: First of them to go on with.
        elements: The mesh.
        rest: Rest positions [m].
        base: lambda and mu of the tissue's own [Pa].
        matter: What the elements are made of.
        blocks: The lists.
        used: Places in use.
        scratch: Shape (9,); overwritten.

    Returns:
        The place in `nodes` to go on with, and places in use.
    """
    for place in range(begin, len(nodes)):
        i = nodes[place]
        count = elements.degree[i]
        lanes = (count + LANES - 1) // LANES * LANES
        if lanes > np.int64(blocks.room[i]):
            if 3 * (used + lanes) > len(blocks.corners):
                return place, used
            blocks.start[i], blocks.room[i] = used, lanes
            used += lanes
        blocks.lanes[i] = lanes
        first = np.int64(blocks.start[i])
        corner_at, gradient_at = 3 * first, 10 * first
        shear = third = 0.0
        for lane in range(lanes):
            volume, element = 0.0, np.int64(0)
            scratch[:] = 0.0
            for row in range(3):
                blocks.corners[corner_at + row * lanes + lane] = i
            if lane < count:
                element = np.int64(elements.data[elements.start[i] + lane])
                tet = elements.tets[element]
                row = 0
                for corner in range(4):
                    if tet[corner] != i:
                        blocks.corners[corner_at + row * lanes + lane] = tet[corner]
                        row += 1
                a = blocks.corners[corner_at + lane]
                b = blocks.corners[corner_at + lanes + lane]
                c = blocks.corners[corner_at + 2 * lanes + lane]
                volume = _shape_gradients(rest, i, a, b, c, scratch)
            if len(blocks.matter):
                write_matter(
                    lane, lanes, ROWS * first, volume, element, base, matter, scratch,
                    blocks.matter,
                )  # fmt: skip
            volume *= matter.table[matter.kind[element], 1] / base[1]
            for row in range(9):
                blocks.gradients[gradient_at + row * lanes + lane] = scratch[row]
            blocks.gradients[gradient_at + 9 * lanes + lane] = volume
            squared = 0.0
            for axis in range(3):
                squared += (scratch[axis] + scratch[3 + axis] + scratch[6 + axis]) ** 2
            shear += volume * squared
            third += volume * squared * np.sqrt(squared)
        blocks.shear[i], blocks.third[i] = shear, third
    return len(nodes), used
