"""Small structured patches, and the edits that add them to an organ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import NO_PARENT, PATCH, PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.patches import Patch
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.geometry.sheet import CONNECTING, SURFACE, triangle_areas
from tissue_sim.geometry.sheet_edit import NO_NODE

SOFT = Patch(young_modulus=2e5, density=1200.0, thickness=0.001)
"""Four times as stiff as the tissue of tests."""

Counts = tuple[int, int]


def grid(
    counts: Counts, size: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Nodes [m] of a rectangle in the plane z = 0, and its triangles, normals along z."""
    x, y = (np.linspace(0.0, length, n) for length, n in zip(size, counts, strict=True))
    points = np.stack([*(axis.ravel() for axis in np.meshgrid(x, y)), np.zeros(len(x) * len(y))], 1)
    at = np.arange(len(points), dtype=np.int32).reshape(len(y), len(x))
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]))
    return points, np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])


def slab(
    counts: Counts, size: tuple[float, float], thickness: float
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """A rectangle one prism thick, each cut into three tetrahedra that conform: nodes and those."""
    flat, triangles = grid(counts, size)
    points = np.concatenate([flat, flat + np.array([0.0, 0.0, thickness])])
    # In ascending order, so that both prisms at a side divide it by the same diagonal.
    a, b, c = np.sort(triangles, axis=1).T
    up = len(flat)
    tets = np.concatenate(
        [np.stack(corners, 1) for corners in (
            (a, b, c, c + up), (a, b, b + up, c + up), (a, a + up, b + up, c + up)
        )]
    ).astype(np.int32)  # fmt: skip
    turned = signed_volumes(points, tets) < 0
    tets[turned] = tets[turned][:, [1, 0, 2, 3]]
    return points, tets


def patch_edit(
    mesh: Mesh,
    at: tuple[float, float, float],
    counts: Counts = (5, 4),
    size: tuple[float, float] = (0.012, 0.009),
    patch: Patch = SOFT,
    request_id: str = "",
    single: bool = False,
) -> TopologyEdit:
    """A plan that adds a patch whose lowest corner is at a place, of the organ's own kind.

    `single` makes one sheet on a sheet and not two with springs between them.
    """
    if mesh.sheet_rows is None:
        points, items = slab(counts, size, patch.thickness)
        kinds, tissue = np.empty(0, dtype=np.uint8), np.empty(0)
    elif single:
        points, triangles = grid(counts, size)
        items = np.pad(triangles, ((0, 0), (0, 1)), constant_values=-1)
        kinds = np.full(len(items), SURFACE, dtype=np.uint8)
        tissue = np.full(len(items), patch.thickness)
    else:
        points, items, kinds, tissue = two_sheets(counts, size, patch.thickness)
    ids = np.where(items >= 0, PROVISIONAL + items.astype(np.int64), NO_NODE)
    return TopologyEdit(
        mesh.version,
        kind=PATCH,
        born_nodes=_provisional(len(points)),
        born_rest=points + np.array(at),
        added_elements=_provisional(len(items)),
        added_nodes=ids.astype(np.uint32),
        added_parents=np.full(len(items), NO_PARENT, dtype=np.uint32),
        born_kinds=kinds,
        born_tissue=tissue,
        added_patches=(patch,),
        request_id=request_id,
    )


def two_sheets(
    counts: Counts, size: tuple[float, float], thickness: float
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.uint8], NDArray[np.float64]]:
    """Two rectangles with springs between them: nodes, items of four (-1: none), kinds, tissue."""
    flat, triangles = grid(counts, size)
    points = np.concatenate([flat, flat + np.array([0.0, 0.0, thickness])])
    up = len(flat)
    below = triangles[:, ::-1]
    solid = np.concatenate([below, triangles + up])
    pairs = np.stack([np.arange(up), np.arange(up) + up], 1)
    items = np.full((len(solid) + len(pairs), 4), -1, dtype=np.int32)
    items[: len(solid), :3], items[len(solid) :, :2] = solid, pairs
    area = triangle_areas(points, solid)
    shares = np.bincount(triangles.ravel(), np.repeat(area[: len(below)] / 3.0, 3), up)
    kinds = np.repeat(np.array([SURFACE, CONNECTING], dtype=np.uint8), [len(solid), len(pairs)])
    # Each sheet stands for half of the thickness.
    tissue = np.concatenate([np.full(len(solid), thickness / 2.0), shares * thickness])
    return points, items, kinds, tissue


def _provisional(count: int) -> NDArray[np.uint32]:
    return (PROVISIONAL + np.arange(count)).astype(np.uint32)
