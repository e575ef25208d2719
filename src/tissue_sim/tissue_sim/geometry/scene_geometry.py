"""From the name of a shape or of a file to a mesh that is ready to simulate."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from tissue_sim.geometry import formats
from tissue_sim.geometry.check import Report, mend
from tissue_sim.geometry.check import inspect as inspect_mesh
from tissue_sim.geometry.fibres import fibres_of
from tissue_sim.geometry.fill import fill_surface
from tissue_sim.geometry.fixed_nodes import fixed_nodes
from tissue_sim.geometry.heart import expected_cost, heart
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.regions import paint
from tissue_sim.geometry.renumber import renumber
from tissue_sim.geometry.shapes import block, sphere_shell, wall
from tissue_sim.geometry.sheet_geometry import (
    VOLUME,
    SheetSettings,
    surface_of,
    with_area,
    with_sheet,
)
from tissue_sim.geometry.suggestions import Interaction, suggest_interaction

__all__ = ["SHAPES", "Interaction", "SceneGeometry", "generate", "load", "suggest_interaction"]

Number = int | float


SHAPES: dict[str, Callable[..., RawMesh]] = {
    "wall": wall,
    "block": block,
    "sphere_shell": sphere_shell,
    "heart": heart,
}
"""Shapes that can be generated, by name."""


@dataclass(frozen=True)
class SceneGeometry:
    """A mesh that is ready to simulate and how it came about.

    Attributes:
        mesh: The mesh.
        raw: The same in the same row order, with node sets and file ids.
        report: What was found and done, in order.
    """

    mesh: Mesh
    raw: RawMesh
    report: Report


def load(
    name_or_path: str | Path,
    units: str | None = None,
    fixed: str = "auto",
    parameters: Mapping[str, Number] | None = None,
    cell: float | None = None,
    folder: Path | None = None,
    regions: Mapping[str, str] | None = None,
    fibres: str = "",
    sheet: SheetSettings | None = None,
) -> SceneGeometry:
    """Make the mesh of a scene.

    Args:
        name_or_path: Name of a generated shape (`SHAPES`) or a mesh file.
        units: Unit of the file's coordinates, "mm" or "m"; a generated shape needs none.
        fixed: Nodes that never move (see `fixed_nodes`).
        parameters: Parameters of a generated shape, by name.
        cell: Element size for filling a surface file [m]; default chosen by `fill_surface`.
        folder: Folder that a relative file name is in; default the working directory.
        regions: Where the scene's regions lie, by name (see `geometry.regions`).
        fibres: How fibres run (see `geometry.fibres`).
        sheet: How the surface of it becomes tissue; None: tetrahedra, a surface is filled.

    Raises:
        ValueError: Something about the request is wrong.
        MeshError: The mesh is.
    """
    if sheet is not None:
        sheet.checked()
        _refuse_of_tetrahedra(sheet, cell, regions, fibres)
    if cell and name_or_path in SHAPES:
        raise ValueError(
            f"cell = {cell} m is for filling a surface file, {name_or_path} is a generated shape; "
            f"its parameters: {', '.join(inspect.signature(SHAPES[str(name_or_path)]).parameters)}"
        )
    raw, said = _raw(str(name_or_path), units, dict(parameters or {}), folder)
    if sheet is None and not len(raw.tetrahedra):
        raw, more = _filled(raw, cell)
        said += more
    raw, report = mend(raw if sheet is None else surface_of(raw))
    if sheet is not None:
        return _sheet_geometry(raw, sheet, fixed, said + report.mended)
    raw = renumber(raw)
    raw = paint(raw, regions) if regions else raw
    raw = replace(raw, fibres=fibres_of(raw, fibres))
    nodes = fixed_nodes(raw, fixed)
    return SceneGeometry(Mesh(raw, nodes), raw, replace(report, mended=said + report.mended))


def _refuse_of_tetrahedra(
    sheet: SheetSettings, cell: float | None, regions: Mapping[str, str] | None, fibres: str
) -> None:
    for given, name in ((cell, "cell"), (regions, "regions"), (fibres, "fibres")):
        if given:
            raise ValueError(
                f"{name} is for tetrahedra; geometry_kind {sheet.kind} has none "
                f"(allowed: geometry_kind {VOLUME}, or no {name})"
            )


def _sheet_geometry(
    raw: RawMesh, sheet: SheetSettings, fixed: str, said: tuple[str, ...]
) -> SceneGeometry:
    """A mesh of triangles and springs, of a mended surface."""
    more: list[str] = []
    raw = renumber(with_area(raw, more))
    nodes = fixed_nodes(raw, fixed)
    raw = with_sheet(raw, sheet, more)
    report = inspect_mesh(raw)
    return SceneGeometry(Mesh(raw, nodes), raw, replace(report, mended=(*said, *more)))


def announcement(name_or_path: str, parameters: Mapping[str, Number] | None = None) -> str:
    """What people should know before a geometry is made: time and memory if much, or ""."""
    cell = (parameters or {}).get("cell")
    return expected_cost(cell) if name_or_path == "heart" and cell is not None else ""


def generate(name: str, parameters: Mapping[str, Number] | None = None) -> RawMesh:
    """Generate a shape.

    Raises:
        ValueError: The shape or a parameter is unknown or out of range.
    """
    if name not in SHAPES:
        raise ValueError(f"unknown shape {name!r}; allowed: {', '.join(SHAPES)}")
    shape = SHAPES[name]
    known = inspect.signature(shape).parameters
    given: dict[str, Number] = {}
    for key, value in (parameters or {}).items():
        if key not in known:
            raise ValueError(f"{name} has no parameter {key!r}; allowed: {', '.join(known)}")
        given[key] = _checked_number(name, key, value, known)
    return shape(**given)


def _checked_number(
    name: str, key: str, value: Number, known: Mapping[str, inspect.Parameter]
) -> Number:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{name}: {key} = {value!r} must be a number")
    if isinstance(known[key].default, int):
        if value != int(value):
            raise ValueError(f"{name}: {key} = {value} must be a whole number")
        return int(value)
    return value


def _raw(
    name: str,
    units: str | None,
    parameters: dict[str, Number],
    folder: Path | None,
) -> tuple[RawMesh, tuple[str, ...]]:
    if name in SHAPES:
        return generate(name, parameters), ()
    if parameters:
        raise ValueError(f"{name} is a file; only shapes have parameters: {', '.join(SHAPES)}")
    if not Path(name).suffix:
        raise ValueError(
            f"{name!r} is neither a shape ({', '.join(SHAPES)}) nor a mesh file; "
            f"{formats.SUPPORTED}"
        )
    return formats.load((folder or Path()) / name, units), ()


def _filled(raw: RawMesh, cell: float | None) -> tuple[RawMesh, tuple[str, ...]]:
    surface, surface_report = mend(raw)
    filled = fill_surface(surface, cell)
    return filled.raw, (*surface_report.mended, *filled.said)
