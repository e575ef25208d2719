"""STL surfaces, binary or text, through trimesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tissue_sim.geometry.errors import MeshFileError
from tissue_sim.geometry.formats.guard import third_party
from tissue_sim.geometry.raw_mesh import RawMesh

_HEADER, _FACET = 84, 50


def read_stl(path: Path) -> RawMesh:
    """Read an STL file. Every facet brings its own corners; `check.mend` joins them."""
    import trimesh

    _refuse_cut_off(path)

    def read(file: Path) -> Any:
        return trimesh.load_mesh(str(file), file_type="stl", process=False)

    mesh = third_party(read, path, "STL")
    return RawMesh(
        points=np.asarray(mesh.vertices, dtype=np.float64),
        triangles=np.asarray(mesh.faces, dtype=np.int64),
    )


def _refuse_cut_off(path: Path) -> None:
    """Compare what the file promises with what it holds; libraries take what is there."""
    content = path.read_bytes()
    size = len(content)
    facets = int.from_bytes(content[80:84], "little") if size >= _HEADER else -1
    if size == _HEADER + _FACET * facets:
        if not facets:
            raise MeshFileError(f"{path}: there are no facets")
        return
    if content[:5].lower() != b"solid" or b"facet" not in content[:2000]:
        promised = f"{facets} facets" if facets >= 0 else "a header"
        raise MeshFileError(f"{path}: damaged or cut off: {promised} promised in {size} bytes")
    text = content.lower()
    corners, loops = text.count(b"vertex"), text.count(b"outer loop")
    if b"endsolid" not in text or corners != 3 * loops:
        raise MeshFileError(
            f"{path}: cut off: {corners} corners for {loops} facets, or no endsolid"
        )
