"""`tissue mesh`: look at mesh files, check and convert them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from tissue_sim.geometry.check import inspect
from tissue_sim.geometry.errors import MeshError
from tissue_sim.geometry.formats import load as load_file
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.scene_geometry import load as load_geometry

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False)
console = Console(highlight=False, soft_wrap=True)

File = Annotated[Path, typer.Argument(help="Mesh file.")]
Units = Annotated[str, typer.Option(help="Unit of its coordinates: mm or m.")]
WRITTEN = (".vtu", ".vtk", ".msh", ".stl", ".ply", ".obj")
METRES = {"mm": 1e-3, "m": 1.0}


@app.command()
def info(file: File, units: Units = "") -> None:
    """What a mesh file holds: size, quality, parts, node sets, regions and vectors of its cells."""
    raw = load_file(file, units)
    for line in inspect(raw).lines():
        console.print(line, markup=False)
    low, high = raw.points.min(axis=0), raw.points.max(axis=0)
    console.print(f"lies from {_millimetres(low)} to {_millimetres(high)} mm", markup=False)
    sets = ", ".join(f"{name} ({len(nodes)})" for name, nodes in sorted(raw.node_sets.items()))
    console.print(f"node sets: {sets or 'none'}", markup=False)
    console.print(f"regions: {_regions(raw)}", markup=False)
    vectors = ", ".join(sorted(raw.element_vectors)) or "none"
    console.print(f"vectors of cells: {vectors}", markup=False)


@app.command()
def check(file: File, units: Units = "") -> None:
    """Whether a mesh file can be simulated: what would be mended, and why it is refused if it is.

    Exit code 1 if it is refused.
    """
    report = inspect(load_file(file, units))
    if not report.refused:
        try:
            report = load_geometry(file, units, fixed="none").report  # a surface is filled as well
        except MeshError as error:
            report = replace(report, refused=str(error))
    for line in report.lines():
        console.print(line, markup=False)
    if report.refused:
        raise typer.Exit(1)
    console.print("can be simulated", style="green")


@app.command()
def convert(
    file: File,
    target: Annotated[Path, typer.Argument(help="File to write: .vtu, .vtk, .msh, .stl, ...")],
    units: Units = "",
    to_units: Annotated[str, typer.Option(help="Unit to write: mm or m.")] = "mm",
    raw: Annotated[
        bool, typer.Option("--raw", help="As it is; default: mended, filled and renumbered.")
    ] = False,
) -> None:
    """Write a mesh in another format, as the simulation would take it."""
    if target.suffix.lower() not in WRITTEN:
        raise ValueError(f"{target}: can write {', '.join(WRITTEN)}, not {target.suffix!r}")
    if to_units not in METRES:
        raise ValueError(f"unknown units {to_units!r}; allowed: {', '.join(METRES)}")
    if raw:
        mesh = load_file(file, units)
    else:
        geometry = load_geometry(file, units, fixed="none")
        mesh = geometry.raw
        for line in geometry.report.lines():
            console.print(line, markup=False)
    _write(mesh, target, METRES[to_units])
    console.print(f"wrote {target} [{to_units}]", markup=False)


def _write(mesh: RawMesh, target: Path, metres: float) -> None:
    import meshio

    data: dict[str, list[np.ndarray]] = {}
    surface_only = target.suffix.lower() in (".stl", ".ply", ".obj")
    if surface_only or not len(mesh.tetrahedra):
        cells = [("triangle", _surface(mesh))]
    else:
        cells = [("tetra", mesh.tetrahedra)]
        if target.suffix.lower() in (".vtu", ".vtk"):
            data = {name: [vectors] for name, vectors in mesh.element_vectors.items()}
            data |= {"region": [mesh.regions]} if len(mesh.regions) else {}
    target.parent.mkdir(parents=True, exist_ok=True)
    # gmsh's newer format wants entities that a plain mesh does not have.
    options = {"file_format": "gmsh22"} if target.suffix.lower() == ".msh" else {}
    meshio.Mesh(mesh.points / metres, cells, cell_data=data).write(target, **options)


def _surface(mesh: RawMesh) -> np.ndarray:
    if not len(mesh.tetrahedra):
        return mesh.triangles
    from tissue_sim.geometry.surface import boundary_triangles

    alive = np.ones(len(mesh.tetrahedra), dtype=np.bool_)
    tets = mesh.tetrahedra.astype(np.int32)
    triangles, _ = boundary_triangles(tets, alive, len(mesh.points))
    return triangles


def _millimetres(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{1e3 * value:.1f}" for value in point) + ")"


def _regions(mesh: RawMesh) -> str:
    labels, counts = np.unique(mesh.regions, return_counts=True)
    return ", ".join(
        f"{mesh.region_names.get(int(label), int(label))} ({count})"
        for label, count in zip(labels, counts, strict=True)
    )
