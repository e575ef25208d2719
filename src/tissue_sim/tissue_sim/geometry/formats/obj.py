"""Wavefront OBJ surfaces: vertices and faces; texture, normals and materials are of no use here.

Read here rather than by a library because libraries split vertices at texture seams, skip lines
they do not understand, and cannot name the line of an error.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tissue_sim.geometry.formats.lines import Lines
from tissue_sim.geometry.raw_mesh import RawMesh


def read_obj(path: Path) -> RawMesh:
    """Read an OBJ file; polygons are cut into fans, so they should be convex."""
    lines = Lines(path)
    points: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for words in lines:
        if words[0] == "v":
            points.append(lines.reals(words[1:], 3))
        elif words[0] == "f":
            corners = [_row(lines, word, len(points)) for word in words[1:]]
            if len(corners) < 3:
                raise lines.error(f"a face of {len(corners)} corners")
            triangles += [
                (corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)
            ]
    return RawMesh(
        points=np.array(points, dtype=np.float64).reshape(-1, 3),
        triangles=np.array(triangles, dtype=np.int64).reshape(-1, 3),
        node_file_ids=np.arange(1, len(points) + 1),
    )


def _row(lines: Lines, word: str, so_far: int) -> int:
    """Row of a face corner such as 7, 7/1/3 or -1 (the last vertex so far)."""
    number = lines.integers([word.partition("/")[0]], 1)[0]
    row = number - 1 if number > 0 else so_far + number
    if number == 0 or not 0 <= row < so_far:
        raise lines.error(f"a face names vertex {number}; {so_far} vertices are there so far")
    return row
