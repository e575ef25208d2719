"""The organ's surface in parts of one colour, as a page can draw it: its meshes have one each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.surface import vertex_normals
from tool_input.table.tissue_frame import Surface
from viz_bridge.organ_surface import colored_triangles

Color = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""


@dataclass(frozen=True)
class SurfacePart:
    """Triangles of one colour. Each vertex lies on an edge of the tissue and moves with it.

    Attributes:
        color: Its colour.
        first: Node row at one end of each vertex' edge, shape (n,).
        second: Node row at the other end; the same for a vertex that is a node, shape (n,).
        weights: How far along the edge the vertex is, 0 to 1, float32, shape (n,).
        triangles: Rows of vertices, outward by the right hand, uint32, shape (m, 3).
    """

    color: Color
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    weights: NDArray[np.float32]
    triangles: NDArray[np.uint32]

    @classmethod
    def of_nodes(cls, color: Color, triangles: NDArray[np.integer]) -> SurfacePart:
        """A part whose vertices are the nodes of some triangles, given as node rows."""
        nodes, corners = np.unique(triangles, return_inverse=True)
        nodes = nodes.astype(np.int64)
        return cls(
            color, nodes, nodes, np.zeros(len(nodes), dtype=np.float32),
            corners.reshape(-1, 3).astype(np.uint32),
        )  # fmt: skip

    def vertices(self, positions: NDArray[np.floating]) -> NDArray[np.floating]:
        """Where the vertices are.

        Args:
            positions: Where the nodes are, shape (node_rows, 3).

        Returns:
            In the unit of `positions`, shape (n, 3).
        """
        start: NDArray[np.floating] = positions[self.first]
        if self.first is self.second:
            return start
        return start + self.weights[:, None] * (positions[self.second] - start)


@lru_cache(maxsize=2)
def tissue_parts(surface: Surface, mesh: Mesh) -> tuple[SurfacePart, ...]:
    """The surface in the colours of its tissue: regions, patches, and what cuts have laid open.

    Made once for all windows.

    Args:
        surface: The outside of the mesh as it is now.
        mesh: The mesh.
    """
    colored = colored_triangles(mesh)
    red, green, blue = np.rint(colored.colors).astype(np.int64).T
    colors, which = np.unique(red << 16 | green << 8 | blue, return_inverse=True)
    return tuple(
        SurfacePart.of_nodes(
            (int(color) >> 16, int(color) >> 8 & 255, int(color) & 255),
            colored.triangles[which == number],
        )
        for number, color in enumerate(colors)
    )


def lifted(surface: Surface, positions: NDArray[np.float32], by: float) -> NDArray[np.float32]:
    """The nodes of a surface a little outside it, for lines that would flicker in it.

    Args:
        surface: The surface.
        positions: Where the nodes are, shape (node_rows, 3).
        by: How far they are moved along their normals, in the unit of `positions`.

    Returns:
        Where they are then, shape (node_rows, 3).
    """
    normals = np.empty_like(positions)
    vertex_normals(positions, surface.nodes[surface.triangles].astype(np.int32), normals)
    return positions + np.float32(by) * normals
