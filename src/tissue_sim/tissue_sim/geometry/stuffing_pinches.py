"""Where a stuffed surface would touch itself, and how that is mended.

A lattice node that was moved onto the surface can be a place at which two pieces of tissue (or of
outside) meet in a node or an edge only. Elsewhere that is impossible: around an inside node
everything is tissue, around a cut edge tissue and outside are one piece each.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.geometry.bcc_lattice import LINK_EDGES, LINK_TRIANGLES

Integers = NDArray[np.int64]
Rows = NDArray[np.int32]
Signs = NDArray[np.int8]
Booleans = NDArray[np.bool_]


def mend_pinches(neighbours: Rows, was_inside: Booleans, sign: Signs) -> Integers:
    """Declare surface nodes inside where tissue or outside would only touch itself.

    Args:
        neighbours: Rows of the lattice neighbours, shape (node_count, 14).
        was_inside: Nodes that were inside before they were moved, shape (node_count,).
        sign: 1 inside, 0 on the surface, -1 outside, shape (node_count,). Modified in place.

    Returns:
        Rows of the nodes declared inside, which belong at their lattice places again.
    """
    return _mend_pinches(neighbours, was_inside, LINK_TRIANGLES, LINK_EDGES, sign)


@njit(cache=True)
def _components(cells: Booleans, edge_cells: Integers, joined: Booleans) -> int:
    """Count the groups of marked cells of a node's link that are joined across link edges."""
    label = np.arange(len(cells))
    for _ in range(len(cells)):
        changed = False
        for edge in range(len(joined)):
            if joined[edge]:
                a, b = edge_cells[edge, 0], edge_cells[edge, 1]
                low = min(label[a], label[b])
                if label[a] != low or label[b] != low:
                    label[a] = low
                    label[b] = low
                    changed = True
        if not changed:
            break
    count = 0
    for cell in range(len(cells)):
        if cells[cell] and label[cell] == cell:
            count += 1
    return count


@njit(cache=True)
def _is_pinched(around: Signs, triangles: Integers, edges: Integers) -> bool:
    """Whether inside or outside around a surface node falls apart into several pieces.

    Around the node its 14 neighbours form a triangulated sphere, the link. Link triangles with
    an inside neighbour carry tissue, those with an outside neighbour or with none inside
    carry outside. The surface is a disc at the node exactly if each of both is one piece
    joined across link edges.

    Args:
        around: Signs of the 14 neighbours.
        triangles: Link triangles, shape (24, 3).
        edges: Link edges with their triangles, shape (36, 4).
    """
    tissue = np.zeros(len(triangles), dtype=np.bool_)
    outside = np.zeros(len(triangles), dtype=np.bool_)
    for t in range(len(triangles)):
        a, b, c = around[triangles[t, 0]], around[triangles[t, 1]], around[triangles[t, 2]]
        tissue[t] = a > 0 or b > 0 or c > 0
        outside[t] = a < 0 or b < 0 or c < 0 or not tissue[t]
    tissue_joined = np.zeros(len(edges), dtype=np.bool_)
    outside_joined = np.zeros(len(edges), dtype=np.bool_)
    for e in range(len(edges)):
        first, second = edges[e, 0], edges[e, 1]
        a, b = around[edges[e, 2]], around[edges[e, 3]]
        on_surface = a == 0 and b == 0
        tissue_joined[e] = a > 0 or b > 0 or (on_surface and tissue[first] and tissue[second])
        outside_joined[e] = (
            a < 0 or b < 0 or (on_surface and not tissue[first] and not tissue[second])
        )
    if _components(tissue, edges, tissue_joined) > 1:
        return True
    return _components(outside, edges, outside_joined) > 1


@njit(cache=True)
def _mend_pinches(
    neighbours: Rows, was_inside: Booleans, triangles: Integers, edges: Integers, sign: Signs
) -> Integers:
    """Declare surface nodes inside where tissue or outside would only touch itself.

    Nodes that were inside before they were moved come first, then any. Tissue is only added,
    so the sweeps end. Modifies `sign` in place.

    Returns:
        Rows of the nodes declared inside, which belong at their lattice places again.
    """
    mended = np.zeros(len(sign), dtype=np.bool_)
    around = np.empty(14, dtype=np.int8)
    only_former_inside = True
    while True:
        changed = False
        for node in range(len(sign)):
            if sign[node] != 0 or (only_former_inside and not was_inside[node]):
                continue
            for direction in range(14):
                around[direction] = sign[neighbours[node, direction]]
            if _is_pinched(around, triangles, edges):
                sign[node] = 1
                mended[node] = True
                changed = True
        if changed:
            only_former_inside = True
        elif only_former_inside:
            only_former_inside = False
        else:
            return np.flatnonzero(mended)
