"""From a mesh to tissue of triangles and springs: surfaces and connected surfaces."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.connected_surfaces import column_thickness, connect, opposite_side
from tissue_sim.geometry.curvature_springs import angular_springs, bending_springs, hinges
from tissue_sim.geometry.fill import outward_triangles
from tissue_sim.geometry.mending import compacted
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sheet import (
    ANGULAR,
    BENDING,
    CONNECTING,
    Sheet,
    SheetStiffness,
    checked_sheet,
    edge_keys,
    per_node,
    sides,
    triangle_areas,
    triangle_normals,
)
from tissue_sim.geometry.surface import boundary_triangles

VOLUME, SURFACE, CONNECTED = "volume", "surface", "connected_surfaces"
KINDS = (VOLUME, SURFACE, CONNECTED)
"""What a geometry is made of: tetrahedra, triangles, or triangles joined through the tissue."""

THICKNESS = 2e-3
"""Thickness of a surface whose thickness nobody gave [m]."""

THICKEST = 0.1
"""Largest thickness that can be given [m]."""

_NO_AREA = 1e-9
"""A triangle has no area if it is below this share of its longest side squared."""

Springs = tuple[int, NDArray[np.int32], NDArray[np.float64]]


@dataclass(frozen=True)
class SheetSettings:
    """How a surface becomes tissue.

    Attributes:
        kind: `SURFACE` or `CONNECTED`.
        thickness: Of the tissue that the triangles stand for [m]; 0: 2 mm for a surface, half of
            the tissue's own for connected surfaces.
        stiffness: Factors of stiffness.
    """

    kind: str
    thickness: float = 0.0
    stiffness: SheetStiffness = field(default_factory=SheetStiffness)

    def checked(self) -> SheetSettings:
        """These settings, if they are allowed.

        Raises:
            ValueError: The kind is unknown or a number out of range.
        """
        if self.kind not in (SURFACE, CONNECTED):
            raise ValueError(f"{self.kind!r} has no triangles; allowed: {SURFACE}, {CONNECTED}")
        if self.thickness and not 1e-6 <= self.thickness <= THICKEST:
            raise ValueError(
                f"surface_thickness = {self.thickness:g} m is out of range; "
                f"allowed: 0, or 1e-06 to {THICKEST:g} m"
            )
        self.stiffness.checked()
        return self


def surface_of(raw: RawMesh) -> RawMesh:
    """The boundary of a mesh of tetrahedra, or the surface as it is; node sets and ids follow."""
    if not len(raw.tetrahedra):
        return raw
    alive = np.ones(len(raw.tetrahedra), dtype=np.bool_)
    tets = raw.tetrahedra.astype(np.int32)
    triangles, _ = boundary_triangles(tets, alive, len(raw.points))
    ids = raw.node_file_ids if len(raw.node_file_ids) else np.arange(len(raw.points))
    return compacted(
        RawMesh(
            points=raw.points,
            triangles=triangles.astype(np.int64),
            node_sets=raw.node_sets,
            node_file_ids=ids,
            name=raw.name,
            source=raw.source,
        )
    )


def with_area(raw: RawMesh, said: list[str]) -> RawMesh:
    """The surface without triangles that have no area: they could carry nothing."""
    corners = raw.points[raw.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    flat = triangle_areas(raw.points, raw.triangles) <= _NO_AREA * longest**2
    if not flat.any():
        return raw
    said.append(f"{int(flat.sum())} triangles without area were dropped")
    return compacted(replace(raw, triangles=raw.triangles[~flat]))


def with_sheet(raw: RawMesh, settings: SheetSettings, said: list[str]) -> RawMesh:
    """Make tissue of a surface.

    Args:
        raw: A mended surface; its rows are those of the mesh.
        settings: How.
        said: What was done is added, one sentence each.

    Raises:
        MeshError: Connected surfaces of an open or turned surface.
        ValueError: A setting is out of range.
    """
    settings.checked()
    springs: list[Springs] = []
    if settings.kind == CONNECTED:
        triangles = outward_triangles(raw, said).astype(np.int32)
        thickness = _connect(raw, triangles, settings.thickness, springs, said)
    else:
        triangles = raw.triangles.astype(np.int32)
        thickness = np.full(len(triangles), settings.thickness or THICKNESS)
        said.append(
            f"{len(triangles)} triangles are a sheet of {1e3 * thickness[0]:.3g} mm, "
            f"{1e6 * float(triangle_areas(raw.points, triangles) @ thickness):.3g} ml of tissue"
        )
    if settings.stiffness.bending:
        springs.append((BENDING, *bending_springs(raw.points, triangles, thickness)))
    if settings.stiffness.angular:
        springs.append((ANGULAR, *angular_springs(raw.points, triangles, thickness)))
    sheet = _sheet(triangles, thickness, springs, settings.stiffness)
    said += _curvature_said(sheet)
    sheet = checked_sheet(sheet, raw.points)
    return replace(raw, triangles=triangles.astype(np.int64), sheet=sheet)


def _connect(
    raw: RawMesh,
    triangles: NDArray[np.int32],
    thickness: float,
    springs: list[Springs],
    said: list[str],
) -> NDArray[np.float64]:
    """Add the connecting springs; thickness of the triangles."""
    areas = triangle_areas(raw.points, triangles)
    opposite = opposite_side(raw.points, triangles)
    normals = triangle_normals(raw.points, triangles)
    volume = float((raw.points[triangles[:, 0]] * normals).sum()) / 6.0
    columns = column_thickness(triangles, opposite.depth, areas, volume)
    shares = per_node(triangles, areas * columns / 3.0, len(raw.points))
    ends, volumes = connect(triangles, opposite, shares)
    springs.append((CONNECTING, ends, volumes))
    depth = opposite.depth[np.isfinite(opposite.depth)]
    lost = len(opposite.depth) - len(depth)
    said.append(
        f"{len(ends)} connecting springs join {len(triangles)} triangles through "
        f"{1e6 * float(areas @ columns):.3g} ml of tissue, median depth "
        f"{1e3 * float(np.median(depth)):.3g} mm"
        + (f"; {lost} nodes see no opposite side and have none of their own" if lost else "")
    )
    return np.full(len(triangles), thickness) if thickness else columns


def _sheet(
    triangles: NDArray[np.int32],
    thickness: NDArray[np.float64],
    springs: list[Springs],
    stiffness: SheetStiffness,
) -> Sheet:
    """A sheet whose springs are all between different pairs of nodes: the first one stays."""
    taken = edge_keys(sides(triangles))
    kept: list[Springs] = []
    for category, ends, volumes in springs:
        keys = edge_keys(ends) if len(ends) else np.empty(0, dtype=np.int64)
        _, first = np.unique(keys, return_index=True)
        first = first[~np.isin(keys[first], taken)]
        taken = np.concatenate([taken, keys[first]])
        kept.append((category, np.sort(ends[first], axis=1), volumes[first]))
    none = (CONNECTING, np.empty((0, 2), dtype=np.int32), np.empty(0))
    return Sheet(
        triangles=triangles,
        thickness=thickness,
        springs=np.concatenate([ends for _, ends, _ in [none, *kept]]),
        categories=np.concatenate(
            [np.full(len(ends), category, dtype=np.uint8) for category, ends, _ in [none, *kept]]
        ),
        volumes=np.concatenate([volumes for _, _, volumes in [none, *kept]]),
        stiffness=stiffness,
    )


def _curvature_said(sheet: Sheet) -> list[str]:
    said = [
        f"{sheet.count(category)} {name} springs keep its curvature"
        for category, name in ((BENDING, "bending"), (ANGULAR, "angular"))
        if sheet.count(category)
    ]
    if sheet.stiffness.torsion:
        said.append(
            f"{len(hinges(sheet.triangles))} torsion springs keep its curvature (quasi_static, lr "
            "near the tools, and spring_mass; relaxation and chain_mail know lengths only)"
        )
    return said
