"""From the name of a shape, a mesh file or a scene file to an organ that models are compared on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.organ import Organ
from tissue_sim.elastic.model import Material
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.scene_geometry import Number
from tissue_sim.geometry.sheet_geometry import KINDS, VOLUME, SheetSettings
from tissue_sim.parameters import refuse_unknown
from tissue_sim.scene_file import SUFFIXES, SceneFile, read_scene
from tissue_sim.simulation_parameters import Settings, specs

HOLD = "hold"
"""Node set that a tool takes, in meshes that have one."""


@dataclass(frozen=True)
class SceneValues:
    """What a scene file says to the simulation, defaults put in for what it leaves out.

    Attributes:
        given: Parameters by full name.
        settings: What they mean.
    """

    given: Mapping[str, Any]
    settings: Settings

    @classmethod
    def of(cls, scene: SceneFile) -> SceneValues:
        """The values of a scene file.

        Raises:
            ValueError: A parameter is unknown or out of range.
        """
        table = {spec.name: spec for spec in specs(scene.simulation)}
        refuse_unknown(scene.simulation, table)
        values = {
            name: spec.checked(scene.simulation.get(name, spec.default))
            for name, spec in table.items()
        }
        return cls(values, Settings.of(values))


def load_organ(
    name_or_path: str,
    units: str | None = None,
    material: Material | None = None,
    parameters: Mapping[str, Number] | None = None,
    geometry_kind: str = VOLUME,
    fixed: str = "auto",
    cell: float | None = None,
) -> Organ:
    """The organ of a generated shape, a mesh file, or a scene file (.yaml).

    A tool holds the node set "hold" if the mesh has one, else what lies around the place that
    `suggest_interaction` finds.

    Args:
        name_or_path: Name of a shape, such as "wall", or a file.
        units: Unit of a mesh file's coordinates, "mm" or "m"; nothing else needs one.
        material: What it is made of; None: as the scene says, or the default material.
        parameters: Parameters of a generated shape, by name.
        geometry_kind: Tetrahedra, triangles, or triangles joined through the tissue.
        fixed: Nodes that never move (see `geometry.fixed_nodes`).
        cell: Element size for filling a surface file [m].

    Raises:
        ValueError: Something of it is unknown, out of range, or given for a scene file, which says
            all but the material itself.
    """
    if Path(name_or_path).suffix.lower() in SUFFIXES:
        if units or parameters or geometry_kind != VOLUME or fixed != "auto" or cell:
            raise ValueError(
                f"{name_or_path} is a scene file: it says units, parameters, geometry_kind, fixed "
                "and cell itself; of these, nothing else is allowed beside it"
            )
        return organ_of_scene(SceneValues.of(read_scene(Path(name_or_path))), material)
    if geometry_kind not in KINDS:
        raise ValueError(
            f"there is no geometry_kind {geometry_kind!r}; allowed: {', '.join(KINDS)}"
        )
    sheet = None if geometry_kind == VOLUME else SheetSettings(geometry_kind)
    geometry = scene_geometry.load(
        name_or_path, units, fixed, parameters=parameters, cell=cell, sheet=sheet
    )
    return organ_of(Path(name_or_path).stem, geometry.mesh, geometry.raw, material)


def organ_of_scene(scene: SceneValues, material: Material | None = None) -> Organ:
    """The organ of a scene file.

    Raises:
        ValueError: Its geometry cannot be made.
    """
    given, settings = scene.given, scene.settings
    geometry = scene_geometry.load(
        given["geometry"],
        given["units"] or None,
        given["fixed"],
        parameters=settings.shape,
        cell=given["cell"] or None,
        regions=settings.regions,
        fibres=given["fibres"],
        sheet=settings.sheet,
    )
    name = Path(given["geometry"]).stem
    return organ_of(name, geometry.mesh, geometry.raw, material or settings.scene.material)


def organ_of(
    name: str, mesh: Mesh, raw: RawMesh | None = None, material: Material | None = None
) -> Organ:
    """The organ of a mesh.

    Args:
        name: Name for people.
        mesh: The mesh.
        raw: The same in the same order of rows, with its node sets.
        material: What it is made of; None: the default.
    """
    hold = _hold(mesh, raw)
    return Organ(name, mesh, material or Material(), hold)


def _hold(mesh: Mesh, raw: RawMesh | None) -> NDArray[np.int32]:
    """Rows of free nodes that a tool takes if nobody says which, sorted."""
    free = mesh.node_alive[: mesh.node_rows] & ~mesh.fixed[: mesh.node_rows]
    taken = np.zeros_like(free)
    if raw is not None and HOLD in raw.node_sets:
        taken[raw.node_sets[HOLD]] = True
    elif free.any():
        place = scene_geometry.suggest_interaction(mesh)
        away = np.linalg.norm(mesh.rest[: mesh.node_rows] - place.grab_point, axis=1)
        taken = away <= place.radius
    return np.flatnonzero(taken & free).astype(np.int32)
