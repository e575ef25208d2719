"""Tearing of surfaces: where an edge is stretched too far, they split across it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import CutCode, CutError
from cut_service.sheet_cuts import split_sheet
from cut_service.sweep import Sweep
from cut_service.tearing import Tear, TearError
from cut_service.work import Settings, prepare
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import CONNECTING, edge_keys, sides

Reals = NDArray[np.float64]
Rows = NDArray[np.int32]

HALF_WIDTHS = (1.6, 2.4, 3.2)
"""Half the length of the tear that is tried, in lengths of the stretched edge."""

TRIED = 8
"""Edges at which a tear is tried, the most stretched ones."""


@dataclass(frozen=True)
class SheetTearSettings:
    """When a surface tears.

    Attributes:
        elongation: Share of its length by which an edge stretches before the surface tears; 0: it
            never does.
    """

    elongation: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            TearError: The elongation is negative, enormous or not finite.
        """
        if not math.isfinite(self.elongation) or not 0.0 <= self.elongation <= 1e3:
            raise TearError(f"elongation = {self.elongation:g} is not allowed; allowed: 0 to 1000")


def plan_sheet_tear(
    mesh: Mesh,
    positions: NDArray[np.floating],
    settings: SheetTearSettings,
    cutting: Settings,
    held: NDArray[np.uint32] | None = None,
) -> Tear:
    """Plan what tears in the shape given; nothing is changed.

    The surface splits along the edges nearest to the plane across the most stretched edge, through
    all of the tissue.

    Args:
        mesh: A mesh that is a sheet.
        positions: Current node positions [m], shape (node_rows, 3).
        settings: When it tears.
        cutting: How to cut. Nothing is snapped.
        held: Ids of nodes held by tools; edges between still nodes do not tear.

    Raises:
        CutError: The mesh is no sheet, or the positions do not fit.
    """
    if mesh.sheet_rows is None:
        raise CutError(CutCode.REFUSED, f"{mesh.name} is not made of triangles")
    if not settings.elongation > 0.0:
        return Tear(0, 0.0)
    places = np.ascontiguousarray(positions, dtype=np.float64)
    edges, triangles = _edges(mesh)
    rest = np.linalg.norm(mesh.rest[edges[:, 1]] - mesh.rest[edges[:, 0]], axis=1)
    now = np.linalg.norm(places[edges[:, 1]] - places[edges[:, 0]], axis=1)
    elongation = now / np.maximum(rest, 1e-300) - 1.0
    still = mesh.fixed[: mesh.node_rows].copy()
    if held is not None and len(held):
        rows = mesh.node_rows_of(held)
        still[rows[rows >= 0]] = True
    over = np.flatnonzero(elongation > settings.elongation)
    largest = float(elongation.max(initial=0.0))
    able = over[~still[edges[over]].any(axis=1)]
    if not len(over):
        return Tear(0, largest)
    if not len(able):
        return Tear(len(over), largest, why="all of them end at fixed or held nodes")
    why = ""
    for k in able[np.argsort(-elongation[able], kind="stable")][:TRIED].tolist():
        for half in HALF_WIDTHS:
            try:
                sweep = _across(mesh, places, edges[k], triangles[k], half)
                work = prepare(mesh, places, sweep, replace(cutting, snap=False), held)
                plan = split_sheet(work)
            except CutError as error:
                why = str(error)
                continue
            parents = mesh.node_rows_of(plan.edit.copy_parents)
            if still[parents].any():
                why = "fixed or held nodes would come apart"
                continue
            edit = replace(plan.edit, kind="tear")
            return Tear(len(over), largest, edit, plan.report.faces_split, corners=plan.lips)
    return Tear(len(over), largest, why=why)


def _edges(mesh: Mesh) -> tuple[Rows, Rows]:
    """Edges of the triangles of tissue, shape (n, 2), and a triangle at each."""
    sheet = mesh.sheet_rows
    assert sheet is not None
    used = mesh.element_rows
    solid = np.flatnonzero(mesh.element_alive[:used] & (sheet.kinds[:used] == 0)).astype(np.int32)
    directed = sides(mesh.tets[solid, :3])
    _, first = np.unique(edge_keys(directed), return_index=True)
    return directed[first].astype(np.int32), solid[first // 3]


def _across(mesh: Mesh, places: Reals, edge: Rows, triangle: int, half: float) -> Sweep:
    """A rectangle through the middle of an edge, perpendicular to it, through the tissue."""
    a, b = places[edge]
    length = float(np.linalg.norm(b - a))
    along = (b - a) / max(length, 1e-300)
    p, q, r = places[mesh.tets[triangle, :3]]
    normal = np.cross(q - p, r - p)
    normal -= (normal @ along) * along
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    across = np.cross(normal, along)
    depth = _depth(mesh, places, edge, length)
    middle, wide = 0.5 * (a + b), half * length * across
    top, bottom = 0.5 * length * normal, -depth * normal
    left, right = middle - wide, middle + wide
    corners = [left + top, right + top, right + bottom, left + bottom]
    return Sweep.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])


def _depth(mesh: Mesh, places: Reals, edge: Rows, length: float) -> float:
    """How deep the tissue is at an edge: a little more than the springs through it are long."""
    sheet = mesh.sheet_rows
    assert sheet is not None
    rows = mesh.incident.of_all(edge)
    rows = rows[sheet.kinds[rows] == CONNECTING]
    if not len(rows):
        return 0.5 * length
    ends = places[mesh.tets[rows, :2]]
    return 1.3 * float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max())
