"""PLY surfaces, binary or text, through trimesh."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from tissue_sim.geometry.errors import MeshFileError
from tissue_sim.geometry.formats.guard import third_party
from tissue_sim.geometry.raw_mesh import RawMesh


def read_ply(path: Path) -> RawMesh:
    """Read a PLY file."""
    import trimesh

    promised = _promised_counts(path)

    def read(file: Path) -> Any:
        return trimesh.load_mesh(str(file), file_type="ply", process=False)

    mesh = third_party(read, path, "PLY")
    points = np.asarray(mesh.vertices, dtype=np.float64)
    triangles = np.asarray(getattr(mesh, "faces", np.empty((0, 3))), dtype=np.int64)
    # Polygons become several triangles, so there can be more of them than faces.
    if len(points) != promised["vertex"] or len(triangles) < promised["face"]:
        raise MeshFileError(
            f"{path}: cut off: {promised['vertex']} vertices and {promised['face']} faces "
            f"promised, {len(points)} and {len(triangles)} read"
        )
    return RawMesh(points=points, triangles=triangles)


def _promised_counts(path: Path) -> dict[str, int]:
    content = path.read_bytes()
    header, end, _ = content.partition(b"end_header")
    if not content.startswith(b"ply") or not end:
        raise MeshFileError(f"{path}: not a PLY file: its header is missing or cut off")
    counts = {"vertex": 0, "face": 0}
    for name, number in re.findall(rb"element\s+(\w+)\s+(\d+)", header):
        counts[name.decode()] = int(number)
    if not counts["face"]:
        raise MeshFileError(f"{path}: there are no faces")
    if sum(counts.values()) > len(content):
        raise MeshFileError(
            f"{path}: {counts['vertex']} vertices and {counts['face']} faces cannot fit in "
            f"{len(content)} bytes"
        )
    return counts
