"""The rim of a patch: where its flat sides end, also after it was trimmed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.patches import Patch
from tissue_sim.geometry.sheet import SURFACE, edge_keys, sides
from tissue_sim.geometry.surface import boundary_triangles

NEAR_A_SIDE = 0.25
"""A node is on the upper or lower side of a patch if it is farther than this share of the thickness
from its middle at rest: cuts may leave nodes in between."""


@dataclass(frozen=True)
class Rim:
    """One closed line in which a side of a patch ends.

    Attributes:
        nodes: Node rows in turn, counterclockwise about the normal of the patch at rest, (n,).
        upper: Whether it bounds the side that the normal points away from.
        length: At rest [m].
    """

    nodes: NDArray[np.int64]
    upper: bool
    length: float


def rims_of(mesh: Mesh, patch: Patch) -> list[Rim]:
    """The rims of a patch, the longest first: an upper and a lower one around each part and hole.

    A patch of a single surface has one side, which counts as the upper one.
    """
    triangles = _triangles(mesh, patch)
    if not len(triangles):
        return []
    heights = mesh.rest[: mesh.node_rows] @ np.array(patch.normal)
    corners = heights[triangles]
    low, high = float(corners.min()), float(corners.max())
    if high - low < NEAR_A_SIDE * patch.thickness:
        found = [(triangles, True)]
    else:
        clear = NEAR_A_SIDE * (high - low)
        middle = 0.5 * (low + high)
        upper = (corners > middle + clear).all(axis=1)
        lower = (corners < middle - clear).all(axis=1)
        # Seen from above, outward triangles of the lower side run clockwise.
        found = [(triangles[upper], True), (triangles[lower][:, ::-1], False)]
    rims = []
    for side, is_upper in found:
        for nodes in _border_lines(side):
            way = mesh.rest[np.roll(nodes, -1)] - mesh.rest[nodes]
            rims.append(Rim(nodes, is_upper, float(np.linalg.norm(way, axis=1).sum())))
    return sorted(rims, key=lambda rim: -rim.length)


def _triangles(mesh: Mesh, patch: Patch) -> NDArray[np.int32]:
    """Triangles of a patch's surface, walls that only are shown left out."""
    own = mesh.element_alive[: mesh.element_rows] & (
        mesh.regions[: mesh.element_rows] == patch.label
    )
    if mesh.sheet_rows is None:
        elements = mesh.tets[: mesh.element_rows][own]
        return boundary_triangles(elements, np.ones(len(elements), np.bool_), mesh.node_rows)[0]
    rows = np.flatnonzero(own)
    return mesh.tets[rows[mesh.sheet_rows.kinds[rows] == SURFACE], :3]


def _border_lines(triangles: NDArray[np.int32]) -> list[NDArray[np.int64]]:
    """Closed lines of the sides that only one triangle has, in the sense of the triangles."""
    directed = sides(triangles)
    keys = edge_keys(directed)
    _, place, counts = np.unique(keys, return_inverse=True, return_counts=True)
    after: dict[int, list[int]] = {}
    for a, b in directed[counts[place] == 1].tolist():
        after.setdefault(a, []).append(b)
    lines = []
    while after:
        first = next(iter(after))
        line, node = [], first
        while node in after:
            line.append(node)
            nexts = after[node]
            following = nexts.pop()
            if not nexts:
                del after[node]
            node = following
            if node == first:
                break
        if len(line) > 2 and node == first:
            lines.append(np.array(line, dtype=np.int64))
    return lines
