"""Mesh files: one reader per format behind one `load`.

Units are always said by the caller and never guessed: hardly any mesh format stores them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from tissue_sim.geometry.errors import MeshFileError
from tissue_sim.geometry.formats.guard import checked
from tissue_sim.geometry.formats.meshio_files import read_gmsh, read_vtk, read_vtu
from tissue_sim.geometry.formats.obj import read_obj
from tissue_sim.geometry.formats.ply import read_ply
from tissue_sim.geometry.formats.stl import read_stl
from tissue_sim.geometry.formats.tetgen import read_smesh, read_tetgen
from tissue_sim.geometry.formats.three_ds import read_3ds
from tissue_sim.geometry.raw_mesh import RawMesh

METRES = {"mm": 1e-3, "m": 1.0}
"""Metres per unit, for every unit a file may be in."""

READERS: dict[str, Callable[[Path], RawMesh]] = {
    ".node": read_tetgen,
    ".ele": read_tetgen,
    ".face": read_tetgen,
    ".smesh": read_smesh,
    ".msh": read_gmsh,
    ".vtk": read_vtk,
    ".vtu": read_vtu,
    ".obj": read_obj,
    ".stl": read_stl,
    ".ply": read_ply,
    ".3ds": read_3ds,
}
"""Reader of each suffix; coordinates stay in the file's unit."""

SUPPORTED = (
    "supported are tetrahedral meshes (TetGen .node/.ele/.face, .msh, .vtk, .vtu) and closed "
    "surfaces (.smesh, .obj, .stl, .ply, .3ds)"
)

_REFUSED = {
    ".glb": "a surface scene format with nested transforms and materials, not read yet; convert "
    "its solid to .obj, .stl or .ply",
    ".gltf": "a surface scene format with nested transforms and materials, not read yet; convert "
    "its solid to .obj, .stl or .ply",
    ".nii": "an image of voxel labels that needs meshing, which is not offered yet; mesh it "
    "elsewhere and give the mesh",
    ".nrrd": "an image of voxel labels that needs meshing, which is not offered yet; mesh it "
    "elsewhere and give the mesh",
}


def metres_per(units: str | None) -> float:
    """Metres per unit of a file.

    Raises:
        ValueError: No unit was given, or one that is not known.
    """
    if not units:
        raise ValueError("the units of a mesh file must be said: --units mm or --units m")
    if units not in METRES:
        raise ValueError(f"unknown units {units!r}; allowed: {', '.join(METRES)}")
    return METRES[units]


def load(path: Path | str, units: str | None) -> RawMesh:
    """Read a mesh file of any supported format.

    Args:
        path: The file; its suffix says the format.
        units: What one unit of its coordinates is: "mm" or "m".

    Returns:
        The mesh in metres. Rows and indices are safe to use; nothing else has been checked.

    Raises:
        ValueError: The units are missing or unknown.
        MeshFileError: The file is missing, refused, damaged or absurd.
    """
    path = Path(path)
    scale = metres_per(units)
    suffix = path.suffix.lower()
    if path.name.lower().endswith(".nii.gz"):
        suffix = ".nii"
    if suffix in _REFUSED:
        raise MeshFileError(f"{path}: {suffix} is {_REFUSED[suffix]}; {SUPPORTED}")
    if suffix not in READERS:
        raise MeshFileError(f"{path}: unknown mesh format {suffix or '(no suffix)'!r}; {SUPPORTED}")
    if not path.is_file():
        raise MeshFileError(f"{path}: no such file")
    if path.stat().st_size == 0:
        raise MeshFileError(f"{path}: the file is empty")
    raw = checked(READERS[suffix](path), path)
    return replace(raw, points=raw.points * scale, name=path.stem, source=str(path))
