"""The organ's surface as it is drawn: the outside, and the faces that cuts have laid open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.faces import LOCAL_FACES
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.surface import boundary_triangles, vertex_normals

OUTSIDE = np.array([168, 62, 54], dtype=np.float64)
INSIDE = np.array([236, 126, 114], dtype=np.float64)
"""Red, green, blue of muscle, and of the same tissue freshly cut."""

PATCH = np.array([186, 208, 196], dtype=np.float64)
PATCH_INSIDE = np.array([222, 232, 224], dtype=np.float64)
"""Of a patch, and where it has been cut."""

NAMED_TINTS = {
    "aorta": (40, 4, 2),
    "pulmonary": (-44, 14, 52),
    "vein": (-62, 20, 74),
    "atrium": (14, 18, 12),
    "right": (12, 4, 2),
}
"""Added where a region's name has the word; the first that fits counts."""

TINTS = ((0, 0, 0), (18, 24, 18), (-18, -8, 4), (14, -10, -6), (-14, 14, 12), (22, 10, -8))
"""Added to regions without such a name, in turn."""


def region_tints(mesh: Mesh) -> dict[int, tuple[int, int, int]]:
    """What each region's colour differs by, by label; not for patches."""
    labels = [int(label) for label in np.unique(mesh.regions[: mesh.element_rows])]
    tints = {}
    for turn, label in enumerate(labels):
        name = mesh.region_names.get(label, "").lower()
        named = (tint for word, tint in NAMED_TINTS.items() if word in name)
        tints[label] = next(named, TINTS[0] if name else TINTS[turn % len(TINTS)])
    return tints


@dataclass(frozen=True)
class SurfacePart:
    """Triangles with vertices of their own, so that an edge between parts stays sharp.

    Attributes:
        nodes: Node row of each vertex, shape (vertex_count,).
        triangles: Vertices of each triangle, outward by the right hand, shape (triangle_count, 3).
        colors: Red, green, blue of each vertex, shape (vertex_count, 3).
    """

    nodes: NDArray[np.int32]
    triangles: NDArray[np.int32]
    colors: NDArray[np.uint8]

    def vertices(self, positions: NDArray[np.float32]) -> NDArray[np.float32]:
        """Vertex positions [m], shape (vertex_count, 3), from those of the nodes."""
        return positions[self.nodes]

    def normals(self, vertices: NDArray[np.float32]) -> NDArray[np.float32]:
        """Unit vertex normals, shape (vertex_count, 3)."""
        normals = np.empty(vertices.shape, dtype=np.float32)
        vertex_normals(vertices, self.triangles, normals)
        return normals


@dataclass(frozen=True)
class OrganSurface:
    """The surface at one version.

    Attributes:
        version: Of the topology.
        outside: What was surface before any cut.
        inside: What cuts have laid open.
    """

    version: int
    outside: SurfacePart
    inside: SurfacePart


def original_nodes(mesh: Mesh) -> NDArray[np.int64]:
    """The node row each node was copied from in the beginning, shape (node_rows,)."""
    roots = mesh.node_parents[: mesh.node_rows].astype(np.int64)
    while True:
        further = roots[roots]
        if np.array_equal(further, roots):
            return roots
        roots = further


def laid_open(mesh: Mesh, triangles: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which boundary triangles were inside the organ before it was cut, shape (triangle_count,).

    A face that was split is there twice, once for each lip; one whose neighbour was removed is a
    face of the removed element. Both are seen from the mesh alone, so late joiners see them too.
    """
    roots = original_nodes(mesh)
    keys = _keys(roots[triangles], mesh.node_rows)
    _, places, counts = np.unique(keys, return_inverse=True, return_counts=True)
    opened: NDArray[np.bool_] = counts[places] > 1
    removed = np.flatnonzero(~mesh.element_alive[: mesh.element_rows])
    if len(removed):
        faces = mesh.tets[removed][:, LOCAL_FACES].reshape(-1, 3)
        faces = faces[(faces >= 0).all(axis=1)]
        opened |= np.isin(keys, _keys(roots[faces], mesh.node_rows))
    return opened


def _keys(triples: NDArray[np.int64], nodes: int) -> NDArray[np.uint64]:
    # One number per unordered triple; beyond two million nodes it wraps and is a good hash.
    low, middle, high = np.sort(triples, axis=1).astype(np.uint64).T
    count = np.uint64(nodes)
    keys: NDArray[np.uint64] = (low * count + middle) * count + high
    return keys


@dataclass(frozen=True)
class ColoredTriangles:
    """The triangles of a surface with a colour each.

    Attributes:
        triangles: Node rows, outward by the right hand, shape (triangle_count, 3).
        opened: Which of them cuts have laid open, shape (triangle_count,).
        colors: Red, green, blue, 0 to 255, shape (triangle_count, 3).
    """

    triangles: NDArray[np.int32]
    opened: NDArray[np.bool_]
    colors: NDArray[np.float64]


def colored_triangles(mesh: Mesh) -> ColoredTriangles:
    """The surface of a mesh as it is now; of a sheet the walls of its cuts are laid open."""
    rows = mesh.element_rows
    if mesh.sheet is not None and mesh.sheet_rows is not None:
        of_triangles, _, of_walls = mesh.sheet_rows.order(mesh.element_alive[:rows])
        triangles = np.concatenate([mesh.sheet.triangles, mesh.sheet.walls])
        elements = np.concatenate([of_triangles, of_walls])
        opened = np.arange(len(triangles)) >= len(mesh.sheet.triangles)
        tints = np.zeros((len(triangles), 3))
    else:
        triangles, elements = boundary_triangles(
            mesh.tets[:rows], mesh.element_alive[:rows], mesh.node_rows
        )
        opened = laid_open(mesh, triangles)
        by_label = region_tints(mesh)
        labels = np.array(list(by_label))
        values = np.array(list(by_label.values()), dtype=np.float64)
        tints = values[np.searchsorted(labels, mesh.regions[elements])]
    inside = opened[:, None]
    colors = np.where(inside, INSIDE + 0.25 * tints, OUTSIDE + tints)
    if len(mesh.patches):
        of_patch = np.isin(mesh.regions[elements], mesh.patches.labels)
        colors = np.where(of_patch[:, None], np.where(inside, PATCH_INSIDE, PATCH), colors)
    return ColoredTriangles(triangles, opened, np.clip(colors, 0.0, 255.0))


def surface_of(mesh: Mesh) -> OrganSurface:
    """The surface of a mesh as it is now, in two parts."""
    all_of_it = colored_triangles(mesh)
    outside, inside = (
        _part(all_of_it.triangles[which], all_of_it.colors[which])
        for which in (~all_of_it.opened, all_of_it.opened)
    )
    return OrganSurface(mesh.version, outside, inside)


def _part(triangles: NDArray[np.int32], colors: NDArray[np.float64]) -> SurfacePart:
    nodes, local = np.unique(triangles, return_inverse=True)
    local = local.reshape(-1, 3)
    count = len(nodes)
    share = np.bincount(local.ravel(), minlength=count)
    mean = (
        np.stack(
            [
                np.bincount(local.ravel(), np.repeat(colors[:, axis], 3), minlength=count)
                for axis in range(3)
            ],
            axis=1,
        )
        / np.maximum(share, 1)[:, None]
    )
    return SurfacePart(nodes.astype(np.int32), local.astype(np.int32), mean.astype(np.uint8))
