"""What a file or a generator gives, before anything has been checked."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.patches import Patches
from tissue_sim.geometry.sheet import Sheet
from tissue_sim.geometry.sutures import Sutures


def _no_triangles() -> NDArray[np.int64]:
    return np.empty((0, 3), dtype=np.int64)


def _no_fibres() -> NDArray[np.float32]:
    return np.empty((0, 3), dtype=np.float32)


def _no_tetrahedra() -> NDArray[np.int64]:
    return np.empty((0, 4), dtype=np.int64)


@dataclass(frozen=True)
class RawMesh:
    """A mesh as it was read or generated; not yet safe to simulate.

    Attributes:
        points: Node positions [m], shape (node_count, 3), float64.
        tetrahedra: Node rows of each tetrahedron, shape (element_count, 4); empty for a surface.
        triangles: Node rows of each surface triangle, shape (triangle_count, 3); may be empty.
        regions: Region label of each tetrahedron, or of the triangles, springs and walls of the
            sheet, one after the other, shape (element_count,); empty: all zero.
        region_names: Names of region labels.
        element_vectors: Named vectors of each tetrahedron, for instance along its fibres, shape
            (element_count, 3) each.
        fibres: Unit vector along the fibres of each tetrahedron at rest, zero where it has none,
            shape (element_count, 3); empty: all zero.
        node_sets: Named sets of node rows, for instance the nodes to fix.
        node_file_ids: Id of each node in its file, shape (node_count,); empty: its row.
        element_file_ids: Id of each tetrahedron in its file, shape (element_count,); empty: row.
        sheet: What the tissue is made of without tetrahedra (`geometry.sheet_geometry`); None: of
            tetrahedra, or not decided.
        sutures: Stitches between its nodes.
        patches: Soft sheets that were added, whose elements have region labels of their own.
        name: Short name of the geometry.
        source: File or generator it came from.
    """

    points: NDArray[np.float64]
    tetrahedra: NDArray[np.int64] = field(default_factory=_no_tetrahedra)
    triangles: NDArray[np.int64] = field(default_factory=_no_triangles)
    regions: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    region_names: dict[int, str] = field(default_factory=dict)
    element_vectors: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    fibres: NDArray[np.float32] = field(default_factory=_no_fibres)
    node_sets: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    node_file_ids: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    element_file_ids: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    sheet: Sheet | None = None
    sutures: Sutures = field(default_factory=Sutures)
    patches: Patches = field(default_factory=Patches)
    name: str = "mesh"
    source: str = ""
