"""What a file or a generator gives, before anything has been checked."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


def _no_triangles() -> NDArray[np.int64]:
    return np.empty((0, 3), dtype=np.int64)


def _no_tetrahedra() -> NDArray[np.int64]:
    return np.empty((0, 4), dtype=np.int64)


@dataclass(frozen=True)
class RawMesh:
    """A mesh as it was read or generated; not yet safe to simulate.

    Attributes:
        points: Node positions [m], shape (node_count, 3), float64.
        tetrahedra: Node rows of each tetrahedron, shape (element_count, 4); empty for a surface.
        triangles: Node rows of each surface triangle, shape (triangle_count, 3); may be empty.
        regions: Region label of each tetrahedron, shape (element_count,); empty: all zero.
        region_names: Names of region labels.
        node_sets: Named sets of node rows, for instance the nodes to fix.
        node_file_ids: Id of each node in its file, shape (node_count,); empty: its row.
        element_file_ids: Id of each tetrahedron in its file, shape (element_count,); empty: row.
        name: Short name of the geometry.
        source: File or generator it came from.
    """

    points: NDArray[np.float64]
    tetrahedra: NDArray[np.int64] = field(default_factory=_no_tetrahedra)
    triangles: NDArray[np.int64] = field(default_factory=_no_triangles)
    regions: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    region_names: dict[int, str] = field(default_factory=dict)
    node_sets: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    node_file_ids: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    element_file_ids: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    name: str = "mesh"
    source: str = ""
