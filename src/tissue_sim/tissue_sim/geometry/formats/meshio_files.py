"""gmsh .msh 2.2 and 4.1, VTK and VTU files, through meshio."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.errors import MeshFileError
from tissue_sim.geometry.formats.guard import third_party
from tissue_sim.geometry.raw_mesh import RawMesh

REGION_NAMES = (
    "region", "regions", "gmsh:physical", "material", "label", "labels", "part",
    "medit:ref", "_volume-id", "cell-zone-ids", "gmsh:geometrical",
)  # fmt: skip
"""Cell data taken for the region label, the first one present."""

_RESULTS = re.compile(rb"^\$(\w+Data)\s.*?^\$End\1[ \t]*$\r?\n?", re.DOTALL | re.MULTILINE)
_IGNORED_CELLS = {"vertex", "line"}


def read_gmsh(path: Path) -> RawMesh:
    """Read gmsh .msh 2.2 or 4.1, text or binary.

    Named physical groups become region names (volumes) and node sets (surfaces, lines, points).
    """
    return _from_meshio(third_party(_read_gmsh_cells, path, "gmsh .msh"), path)


def _read_gmsh_cells(path: Path) -> Any:
    """Read without results (`$NodeData` and the like): meshio fails on them in text files."""
    import meshio

    content = path.read_bytes()
    if content.split(None, 3)[2:3] != [b"0"] or not _RESULTS.search(content):
        return meshio.gmsh.read(path)
    # meshio wants a real file.
    with tempfile.TemporaryDirectory() as folder:
        cells = Path(folder) / "cells.msh"
        cells.write_bytes(_RESULTS.sub(b"", content))
        return meshio.gmsh.read(cells)


def read_vtk(path: Path) -> RawMesh:
    """Read a legacy VTK unstructured grid."""
    import meshio

    return _from_meshio(third_party(meshio.vtk.read, path, "VTK"), path)


def read_vtu(path: Path) -> RawMesh:
    """Read a VTK XML unstructured grid."""
    import meshio

    return _from_meshio(third_party(meshio.vtu.read, path, "VTU"), path)


def _from_meshio(mesh: Any, path: Path) -> RawMesh:
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim == 2 and points.shape[1] == 2:
        raise MeshFileError(
            f"{path}: the mesh is flat: nodes have two coordinates, three are wanted"
        )
    _refuse_other_cells(mesh, path)
    tetrahedra, regions = _cells(mesh, "tetra", 4)
    triangles, _ = _cells(mesh, "triangle", 3)
    return RawMesh(
        points=points,
        tetrahedra=tetrahedra,
        triangles=triangles,
        regions=regions,
        element_vectors=_element_vectors(mesh),
        region_names=_group_names(mesh, dimension=3),
        node_sets={**_sets_of_groups(mesh), **_sets_of_point_data(mesh)},
    )


def _refuse_other_cells(mesh: Any, path: Path) -> None:
    counts: dict[str, int] = {}
    for block in mesh.cells:
        counts[block.type] = counts.get(block.type, 0) + len(block.data)
    others = {k: n for k, n in counts.items() if k not in {"tetra", "triangle", *_IGNORED_CELLS}}
    if any(others.values()):
        found = ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))
        raise MeshFileError(
            f"{path}: has cells that cannot be simulated: {found}; "
            "convert them to linear tetrahedra"
        )


def _cells(mesh: Any, kind: str, corners: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    blocks = [i for i, block in enumerate(mesh.cells) if block.type == kind]
    none = np.empty((0, corners), dtype=np.int64)
    cells = np.concatenate([none, *(mesh.cells[i].data for i in blocks)]).astype(np.int64)
    name = next((n for n in REGION_NAMES if n in mesh.cell_data), None)
    if name is None or not blocks:
        return cells, np.empty(0, dtype=np.int32)
    labels = np.concatenate([np.asarray(mesh.cell_data[name][i]).ravel() for i in blocks])
    labels = np.where(np.isfinite(labels), labels, 0) if labels.dtype.kind == "f" else labels
    return cells, labels.astype(np.int32)


def _element_vectors(mesh: Any) -> dict[str, NDArray[np.float64]]:
    """Cell data of three numbers by name, those of the tetrahedra."""
    blocks = [i for i, block in enumerate(mesh.cells) if block.type == "tetra"]
    found = {}
    for name, values in mesh.cell_data.items():
        parts = [np.asarray(values[i]) for i in blocks]
        if parts and all(part.ndim == 2 and part.shape[1] == 3 for part in parts):
            found[str(name)] = np.concatenate(parts).astype(np.float64)
    return found


def _group_names(mesh: Any, dimension: int) -> dict[int, str]:
    return {
        int(value[0]): str(name)
        for name, value in mesh.field_data.items()
        if np.size(value) == 2 and int(value[1]) == dimension
    }


def _sets_of_groups(mesh: Any) -> dict[str, NDArray[np.int64]]:
    """Nodes of named physical groups of surfaces, lines and points."""
    sets: dict[str, NDArray[np.int64]] = {}
    dimension_of = {"vertex": 0, "line": 1, "triangle": 2}
    labels = mesh.cell_data.get("gmsh:physical")
    if labels is None:
        return sets
    for dimension in (0, 1, 2):
        for label, name in _group_names(mesh, dimension).items():
            nodes = [
                block.data[np.asarray(tags) == label].ravel()
                for block, tags in zip(mesh.cells, labels, strict=True)
                if dimension_of.get(block.type) == dimension
            ]
            if nodes:
                sets[name] = np.unique(np.concatenate(nodes)).astype(np.int64)
    return sets


def _sets_of_point_data(mesh: Any) -> dict[str, NDArray[np.int64]]:
    """Point data called `fixed` or `set:NAME`: nodes where it is not zero."""
    sets = {}
    for name, values in mesh.point_data.items():
        if name == "fixed" or name.startswith("set:"):
            flags = np.asarray(values)
            if flags.ndim == 1:
                sets[name.removeprefix("set:")] = np.flatnonzero(np.nan_to_num(flags) != 0)
    return sets
