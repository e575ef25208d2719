"""What holds for every mesh read from a file, whatever its format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.errors import MeshFileError
from tissue_sim.geometry.raw_mesh import RawMesh

_LARGEST = 1e9
"""Coordinates beyond this are damage, whatever the unit."""


def checked(raw: RawMesh, path: Path) -> RawMesh:
    """The mesh with plain array types, if all of it can be indexed and measured.

    Raises:
        MeshFileError: No elements, wrong dimensions, indices out of range, or coordinates that
            are not finite or absurd.
    """
    points = np.ascontiguousarray(raw.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeshFileError(
            f"{path}: nodes have shape {points.shape}; three coordinates are wanted"
        )
    if not len(points):
        raise MeshFileError(f"{path}: there are no nodes")
    if not len(raw.tetrahedra) and not len(raw.triangles):
        raise MeshFileError(f"{path}: there are no tetrahedra and no triangles")
    bad = ~(np.abs(points) <= _LARGEST).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise MeshFileError(
            f"{path}: {int(bad.sum())} nodes have coordinates that are not finite or beyond "
            f"{_LARGEST:g}; the first is node {_id(raw.node_file_ids, row)}: {points[row].tolist()}"
        )
    tetrahedra = _in_range(
        raw.tetrahedra, 4, len(points), raw.element_file_ids, "tetrahedron", path
    )
    none = np.empty(0, dtype=np.int64)
    triangles = _in_range(raw.triangles, 3, len(points), none, "triangle", path)
    return replace(raw, points=points, tetrahedra=tetrahedra, triangles=triangles)


def _in_range(
    items: NDArray[np.int64],
    corners: int,
    node_count: int,
    file_ids: NDArray[np.int64],
    what: str,
    path: Path,
) -> NDArray[np.int64]:
    wide = np.ascontiguousarray(items, dtype=np.int64).reshape(-1, corners)
    bad = ((wide < 0) | (wide >= node_count)).any(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise MeshFileError(
            f"{path}: {int(bad.sum())} {what} entries name nodes that are not there; the first is "
            f"{what} {_id(file_ids, row)} with node rows {wide[row].tolist()} of {node_count} nodes"
        )
    return wide


def _id(file_ids: NDArray[np.int64], row: int) -> int:
    return int(file_ids[row]) if len(file_ids) else row


def third_party(reader: Callable[[Path], Any], path: Path, what: str) -> Any:
    """Call a library's reader; whatever it raises on a damaged file becomes one clear error.

    Raises:
        MeshFileError: The library could not read the file.
    """
    try:
        return reader(path)
    except (Exception, SystemExit) as error:
        reason = str(error).strip() or type(error).__name__
        raise MeshFileError(
            f"{path}: not a readable {what} file, damaged or cut off ({reason})"
        ) from error
