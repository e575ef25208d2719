"""TetGen's text files: .node, .ele and .face with a common stem, and .smesh surfaces.

Numbering may start at 0 or 1, or be any distinct ids; they are kept as file ids. The node marker
column becomes node sets `marker_N`, the element attribute becomes the region.

References:
    H. Si, TetGen user's manual, section 5 (file formats).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.errors import MeshFileError
from tissue_sim.geometry.formats.lines import Lines
from tissue_sim.geometry.raw_mesh import RawMesh


class _Nodes:
    """Nodes of a file with the row of each id."""

    def __init__(self) -> None:
        self.points: list[list[float]] = []
        self.ids: list[int] = []
        self.markers: list[int] = []
        self.row_of: dict[int, int] = {}

    def read(self, lines: Lines, header: list[str]) -> None:
        count, dimension, attributes, markers = _header(lines, header, (0, 3, 0, 0))
        if dimension != 3:
            raise lines.error(f"nodes have dimension {dimension}; three are wanted")
        for k in range(count):
            words = lines.next(f"node {k + 1} of {count}")
            node = lines.integers(words[:1], 1)[0]
            if node in self.row_of:
                raise lines.error(f"node {node} is given twice")
            self.row_of[node] = len(self.ids)
            self.ids.append(node)
            self.points.append(lines.reals(words[1:], 3))
            marker = words[4 + attributes :] if markers else []
            self.markers.append(int(lines.reals(marker, 1)[0]) if marker else 0)

    def rows(self, lines: Lines, ids: list[int], what: str) -> list[int]:
        try:
            return [self.row_of[node] for node in ids]
        except KeyError as error:
            raise lines.error(f"{what} names node {error}, which is not there") from None

    def sets(self) -> dict[str, NDArray[np.int64]]:
        markers = np.array(self.markers, dtype=np.int64)
        return {
            f"marker_{m}": np.flatnonzero(markers == m)
            for m in np.unique(markers[markers != 0]).tolist()
        }


def _header(lines: Lines, words: list[str], defaults: tuple[int, ...]) -> tuple[int, ...]:
    values = lines.integers(words, 1)[: len(defaults)]
    if values[0] < 0:
        raise lines.error(f"a count of {values[0]} makes no sense")
    return (*values, *defaults[len(values) :])


def _read_nodes(path: Path) -> _Nodes:
    if not path.is_file():
        raise MeshFileError(f"{path}: no such file; TetGen meshes need it beside their elements")
    lines, nodes = Lines(path), _Nodes()
    nodes.read(lines, lines.next("the number of nodes"))
    return nodes


def read_tetgen(path: Path) -> RawMesh:
    """Read the files of a TetGen mesh: any of them is enough to name it."""
    nodes = _read_nodes(path.with_suffix(".node"))
    elements, faces = path.with_suffix(".ele"), path.with_suffix(".face")
    if not elements.is_file() and not faces.is_file():
        raise MeshFileError(f"{path}: neither {elements.name} nor {faces.name} lies beside it")
    ids: list[int] = []
    rows: list[list[int]] = []
    regions: list[int] = []
    if elements.is_file():
        ids, rows, regions = _read_elements(elements, nodes)
    triangles = _read_faces(faces, nodes) if faces.is_file() else []
    return RawMesh(
        points=np.array(nodes.points, dtype=np.float64).reshape(-1, 3),
        tetrahedra=np.array(rows, dtype=np.int64).reshape(-1, 4),
        triangles=np.array(triangles, dtype=np.int64).reshape(-1, 3),
        regions=np.array(regions, dtype=np.int32),
        node_sets=nodes.sets(),
        node_file_ids=np.array(nodes.ids, dtype=np.int64),
        element_file_ids=np.array(ids, dtype=np.int64),
    )


def _read_elements(path: Path, nodes: _Nodes) -> tuple[list[int], list[list[int]], list[int]]:
    lines = Lines(path)
    count, corners, attributes = _header(lines, lines.next("the number of elements"), (0, 4, 0))
    if corners != 4:
        raise lines.error(f"elements of {corners} nodes; linear tetrahedra of 4 are wanted")
    ids, rows, regions = [], [], []
    for k in range(count):
        words = lines.next(f"element {k + 1} of {count}")
        numbers = lines.integers(words[:5], 5)
        ids.append(numbers[0])
        rows.append(nodes.rows(lines, numbers[1:], f"element {numbers[0]}"))
        regions.append(int(lines.reals(words[5:], 1)[0]) if attributes else 0)
    return ids, rows, regions


def _read_faces(path: Path, nodes: _Nodes) -> list[list[int]]:
    lines = Lines(path)
    count, _ = _header(lines, lines.next("the number of faces"), (0, 0))
    triangles = []
    for k in range(count):
        numbers = lines.integers(lines.next(f"face {k + 1} of {count}")[:4], 4)
        triangles.append(nodes.rows(lines, numbers[1:], f"face {numbers[0]}"))
    return triangles


def read_smesh(path: Path) -> RawMesh:
    """Read a .smesh surface; polygons are cut into fans, so they should be convex.

    An empty node part means that the nodes lie in the .node file beside it.
    """
    lines, nodes = Lines(path), _Nodes()
    header = lines.next("the number of nodes")
    if lines.integers(header, 1)[0] == 0:
        nodes = _read_nodes(path.with_suffix(".node"))
    else:
        nodes.read(lines, header)
    count, _ = _header(lines, lines.next("the number of facets"), (0, 0))
    triangles = []
    for k in range(count):
        numbers = lines.integers(lines.next(f"facet {k + 1} of {count}"), 1)
        corners = numbers[0]
        if corners < 3 or len(numbers) < corners + 1:
            raise lines.error(f"facet {k + 1} says {corners} corners and gives {len(numbers) - 1}")
        rows = nodes.rows(lines, numbers[1 : corners + 1], f"facet {k + 1}")
        triangles += [[rows[0], rows[j], rows[j + 1]] for j in range(1, corners - 1)]
    return RawMesh(
        points=np.array(nodes.points, dtype=np.float64).reshape(-1, 3),
        triangles=np.array(triangles, dtype=np.int64).reshape(-1, 3),
        node_sets=nodes.sets(),
        node_file_ids=np.array(nodes.ids, dtype=np.int64),
    )
