"""From a flat mesh of triangles to a sheet of tissue of the organ's own kind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.curvature_springs import angular_springs, bending_springs
from tissue_sim.geometry.patch_mesh import FlatMesh
from tissue_sim.geometry.quality import radius_ratios
from tissue_sim.geometry.sheet import (
    ANGULAR,
    BENDING,
    CONNECTING,
    SURFACE,
    SheetStiffness,
    edge_keys,
    edges_of_keys,
    per_node,
    sides,
    triangle_areas,
)
from tissue_sim.geometry.sheet_rows import NO_ROW, WALL


@dataclass(frozen=True)
class PatchTissue:
    """Nodes and elements of a patch in the axes of its plane, the normal being z.

    Attributes:
        points: Its nodes [m], shape (n, 3): of two layers first those below, then those above, each
            in the order of the flat mesh, so that those of the rim come first.
        elements: Nodes of each element as in `Mesh.tets`: four of a tetrahedron, three of a
            triangle and two of a spring, then -1; int32, shape (e, 4).
        kinds: Of each element as in `SheetRows`; zero for tetrahedra; uint8, shape (e,).
        tissue: Thickness of triangles [m] and volume of the tissue of springs [m^3] as in
            `SheetRows`; zero for tetrahedra; shape (e,).
        rim: Nodes of the rim, of two layers first those below; shape (r,).
        quality: Worst and mean quality (three times the inscribed over the circumscribed radius) of
            tetrahedra; of triangles twice that ratio.
    """

    points: NDArray[np.float64]
    elements: NDArray[np.int32]
    kinds: NDArray[np.uint8]
    tissue: NDArray[np.float64]
    rim: NDArray[np.int32]
    quality: tuple[float, float]


def solid(flat: FlatMesh, thickness: float) -> PatchTissue:
    """One layer of tetrahedra: a prism on each triangle, of three tetrahedra.

    A prism's sides are parted from the lower node (of the two below) that comes first in the mesh
    to the upper one of the other, which neighbours see alike.

    Args:
        flat: The triangles.
        thickness: Of the patch [m].
    """
    count = len(flat.points)
    points = _layers(flat, (-0.5 * thickness, 0.5 * thickness))
    # Turned so that the first node comes first, triangles keep their sense.
    first = np.argmin(flat.triangles, axis=1)
    rows = np.arange(len(flat.triangles))
    a, b, c = (flat.triangles[rows, (first + k) % 3] for k in range(3))
    straight = b < c
    tets = np.concatenate(
        [
            np.stack([a, b, c, np.where(straight, c, b) + count], axis=1),
            np.where(
                straight[:, None],
                np.stack([a, b, c + count, b + count], axis=1),
                np.stack([a, b + count, c, c + count], axis=1),
            ),
            np.stack([a, b + count, c + count, a + count], axis=1),
        ]
    ).astype(np.int32)
    none = np.zeros(len(tets))
    ratios = radius_ratios(points, tets)
    quality = (float(ratios.min()), float(ratios.mean()))
    return PatchTissue(points, tets, none.astype(np.uint8), none, _rim(flat, 2), quality)


def double_sheet(flat: FlatMesh, thickness: float, stiffness: SheetStiffness) -> PatchTissue:
    """Two sheets of triangles with normals outward, joined by springs, and walls around.

    From each node springs go straight across and across every edge to the neighbours of the node
    opposite; the tissue of the node is shared out evenly to them. Each sheet stands for half of the
    thickness. The walls along the rim are shown and carry nothing.

    Args:
        flat: The triangles.
        thickness: Of the patch [m].
        stiffness: Factors of the organ's springs: it has curvature springs where the organ has.
    """
    count = len(flat.points)
    points = _layers(flat, (-0.5 * thickness, 0.5 * thickness))
    below, above = flat.triangles[:, [0, 2, 1]], flat.triangles + count
    triangles = np.concatenate([below, above]).astype(np.int32)
    thick = np.full(len(triangles), 0.5 * thickness)
    areas = triangle_areas(points, triangles)
    ends = edges_of_keys(np.unique(edge_keys(sides(flat.triangles))))
    ends = np.concatenate([ends, ends[:, ::-1]])
    across = np.stack([ends[:, 0], ends[:, 1] + count], axis=1)
    upright = np.stack([np.arange(count), np.arange(count) + count], axis=1)
    springs = np.concatenate([upright, across]).astype(np.int32)
    shares = per_node(triangles, areas * thick / 3.0, 2 * count)
    shares /= np.bincount(springs.ravel(), minlength=2 * count)
    volumes = shares[springs].sum(axis=1)
    rim = np.arange(flat.rim)
    after = np.roll(rim, -1)
    walls = np.concatenate(
        [
            np.stack([rim, after, after + count], axis=1),
            np.stack([rim, after + count, rim + count], axis=1),
        ]
    ).astype(np.int32)
    parts = [
        (SURFACE, triangles, thick),
        (CONNECTING, springs, volumes),
        *_curvature(points, triangles, thick, stiffness),
        (WALL, walls, np.zeros(len(walls))),
    ]
    return _of_parts(points, parts, flat, 2)


def single_sheet(flat: FlatMesh, thickness: float, stiffness: SheetStiffness) -> PatchTissue:
    """One sheet of triangles; arguments as for `double_sheet`."""
    points = _layers(flat, (0.0,))
    thick = np.full(len(flat.triangles), thickness)
    parts = [
        (SURFACE, flat.triangles, thick),
        *_curvature(points, flat.triangles, thick, stiffness),
    ]
    return _of_parts(points, parts, flat, 1)


_Part = tuple[int, NDArray[np.int32], NDArray[np.float64]]


def _layers(flat: FlatMesh, heights: tuple[float, ...]) -> NDArray[np.float64]:
    return np.concatenate(
        [np.column_stack([flat.points, np.full(len(flat.points), height)]) for height in heights]
    )


def _rim(flat: FlatMesh, layers: int) -> NDArray[np.int32]:
    one = np.arange(flat.rim, dtype=np.int32)
    return np.concatenate([one + layer * len(flat.points) for layer in range(layers)])


def _curvature(
    points: NDArray[np.float64],
    triangles: NDArray[np.int32],
    thickness: NDArray[np.float64],
    stiffness: SheetStiffness,
) -> list[_Part]:
    """Springs that keep the curvature, where the organ has such, each between a pair of its own."""
    taken = edge_keys(sides(triangles))
    parts: list[_Part] = []
    for kind, factor, make in (
        (BENDING, stiffness.bending, bending_springs),
        (ANGULAR, stiffness.angular, angular_springs),
    ):
        if not factor:
            continue
        ends, volumes = make(points, triangles, thickness)
        keys = edge_keys(ends)
        _, first = np.unique(keys, return_index=True)
        first = first[~np.isin(keys[first], taken)]
        taken = np.concatenate([taken, keys[first]])
        parts.append((kind, ends[first], volumes[first]))
    return parts


def _of_parts(
    points: NDArray[np.float64], parts: list[_Part], flat: FlatMesh, layers: int
) -> PatchTissue:
    elements = np.full((sum(len(nodes) for _, nodes, _ in parts), 4), NO_ROW, dtype=np.int32)
    kinds = np.concatenate([np.full(len(nodes), kind, dtype=np.uint8) for kind, nodes, _ in parts])
    begin = 0
    for _, nodes, _ in parts:
        elements[begin : begin + len(nodes), : nodes.shape[1]] = nodes
        begin += len(nodes)
    ratios = flat.qualities
    quality = (float(ratios.min()), float(ratios.mean()))
    tissue = np.concatenate([amount for _, _, amount in parts])
    return PatchTissue(points, elements, kinds, tissue, _rim(flat, layers), quality)
