"""Planning patches: from an outline to a `TopologyEdit`; see docs/patches.md."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import RequestError
from cut_service.organ import organ_of
from cut_service.organ_size import tissue_box
from cut_service.overlap import overlap_of
from tissue_sim.geometry import patches
from tissue_sim.geometry.edit import NO_PARENT, PATCH, PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.outline import (
    WIDEST,
    CrossingError,
    NotFlatError,
    OutlineError,
    Plane,
    checked_outline,
    plane_of,
    signed_area,
)
from tissue_sim.geometry.patch_layers import PatchTissue, double_sheet, single_sheet, solid
from tissue_sim.geometry.patch_mesh import FlatMesh, TooManyNodesError, mesh_outline
from tissue_sim.geometry.patches import Patch
from tissue_sim.geometry.sheet import CONNECTING, triangle_areas

THICKNESS, YOUNG_MODULUS, DENSITY = 1e-3, 2e5, 1060.0
"""Of a patch that a request says nothing of [m], [Pa], [kg/m^3]."""

FARTHEST = 10.0
"""Farthest that a corner may be from the organ's bounding box along an axis, in diagonals of it."""

THICKEST = 0.5
"""Largest thickness, as a share of the diameter of a circle as large as the outline."""


class PatchCode(IntEnum):
    """Error codes of a request; the numbers are those of `tissue_interfaces/srv/AddPatch`."""

    NONE = 0
    INVALID = 1
    UNKNOWN_FRAME = 2
    NO_TISSUE = 3
    STATE_FRAME_GONE = 4
    CROSSES = 5
    NOT_FLAT = 6
    TOO_LARGE = 7
    UNKNOWN_TOOL = 8
    STALE = 9
    SIMULATION_LOST = 10
    REFUSED = 11


class PatchError(RequestError[PatchCode]):
    """A request that cannot be met; nothing was changed."""


@dataclass(frozen=True)
class Wanted:
    """What patch is wanted.

    Attributes:
        corners: Of its outline in the organ's frame [m], shape (n, 3).
        normal: Which side is up: the patch's normal is turned to this side, shape (3,); None: the
            outline goes round it by the right hand.
        thickness: [m]; 0: `THICKNESS`.
        young_modulus: [Pa]; 0: `YOUNG_MODULUS`.
        density: [kg/m^3]; 0: `DENSITY`.
        edge: Length of its edges [m]; 0: the organ's own mean.
        name: Of the patch and its region; "": "patch ID".
        tool: Tool that holds it from the start; "": none.
    """

    corners: NDArray[np.float64]
    normal: NDArray[np.float64] | None = None
    thickness: float = 0.0
    young_modulus: float = 0.0
    density: float = 0.0
    edge: float = 0.0
    name: str = ""
    tool: str = ""


@dataclass(frozen=True)
class PatchPlan:
    """A planned patch.

    Attributes:
        edit: The edit, with provisional ids.
        nodes, elements: How many it has.
        area: Of one side [m^2].
        edge: Edge length it was made with [m].
        quality: Worst and mean quality of its elements; see `PatchTissue`.
        rim: Places of the nodes of the rim among `edit.born_nodes`.
        overlap: Nodes of the patch that lie in tissue, and nodes of tissue that lie in the patch.
    """

    edit: TopologyEdit
    nodes: int
    elements: int
    area: float
    edge: float
    quality: tuple[float, float]
    rim: NDArray[np.int32]
    overlap: int

    def in_words(self, patch: str, tool: str) -> str:
        """What a person should know."""
        text = (
            f"{patch}: {self.nodes} nodes, {self.elements} elements, {1e4 * self.area:.3g} cm2, "
            f"edges of {1e3 * self.edge:.3g} mm, worst quality {self.quality[0]:.2f}"
        )
        if tool:
            text += f", carried by {tool}"
        if self.overlap:
            text += f"; it overlaps tissue at {self.overlap} nodes"
        return text


def plan_patch(mesh: Mesh, shape: NDArray[np.floating], wanted: Wanted) -> PatchPlan:
    """Plan a patch. Nothing is changed.

    Args:
        mesh: The mesh, at the version that `shape` belongs to.
        shape: Current node positions [m], shape (node_rows, 3).
        wanted: What is wanted.

    Raises:
        PatchError: A number is out of range, or the outline encloses no patch, is far from the
            organ or small beside the thickness.
    """
    patch = _patch(mesh, wanted)
    positions = np.asarray(shape, dtype=np.float64)
    _refuse_far(mesh, positions, wanted.corners)
    edge = wanted.edge or mean_edge(mesh)
    try:
        plane, outline = _flat(wanted)
        _refuse_thick(outline, patch.thickness)
        double = mesh.sheet_rows is None or _has_connections(mesh)
        flat = mesh_outline(outline, edge, layers=2 if double else 1)
    except OutlineError as error:
        raise PatchError(_code(error), str(error)) from None
    tissue = _tissue(mesh, flat, patch.thickness)
    edit = _edit(mesh, plane, tissue, patch, wanted.tool)
    overlap = overlap_of(mesh, positions, plane, outline, tissue.points, patch.thickness)
    return PatchPlan(
        edit, len(tissue.points), len(tissue.elements), flat.area, edge, tissue.quality,
        tissue.rim, overlap,
    )  # fmt: skip


def mean_edge(mesh: Mesh) -> float:
    """Edge [m] of a regular tetrahedron or triangle as large as the organ's are on average."""
    if mesh.sheet is None:
        return organ_of(mesh).mean_edge
    areas = triangle_areas(mesh.rest, mesh.sheet.triangles)
    # A regular triangle of edge l has the area sqrt(3) / 4 l^2.
    return float(np.sqrt(areas.mean() * 4.0 / np.sqrt(3.0)))


def _patch(mesh: Mesh, wanted: Wanted) -> Patch:
    """Thickness, material and name, if they are allowed."""
    numbers = (wanted.thickness, wanted.young_modulus, wanted.density, wanted.edge)
    if not (np.isfinite(wanted.corners).all() and np.isfinite(numbers).all()):
        raise PatchError(PatchCode.INVALID, "a corner, or another number, is not finite")
    if not 0.0 <= wanted.edge <= WIDEST:
        raise PatchError(
            PatchCode.INVALID,
            f"edge_length = {wanted.edge:g} m is not allowed; allowed: up to {WIDEST:g} m, 0 for "
            "the organ's own mean",
        )
    patch = Patch(
        young_modulus=wanted.young_modulus or YOUNG_MODULUS,
        density=wanted.density or DENSITY,
        thickness=wanted.thickness or THICKNESS,
        name=wanted.name,
    )
    if why := patches.why_not(patch):
        raise PatchError(PatchCode.INVALID, why)
    if wanted.name in mesh.region_names.values():
        raise PatchError(
            PatchCode.INVALID,
            f"the organ has a region named {wanted.name!r} already; give the patch another name",
        )
    return patch


def _refuse_far(mesh: Mesh, positions: NDArray[np.float64], corners: NDArray[np.float64]) -> None:
    """Refuse a patch that is nowhere near the organ: a mistake of units or of a frame."""
    if not mesh.node_alive[: mesh.node_rows].any():
        raise PatchError(PatchCode.NO_TISSUE, "no node of the organ is left")
    lower, upper = tissue_box(mesh, positions)
    size = float(np.linalg.norm(upper - lower))
    # Along each axis: squares of what is beyond all measure would be beyond all numbers.
    away = float(np.maximum(lower - corners, corners - upper).max(initial=0.0))
    if away > FARTHEST * size:
        raise PatchError(
            PatchCode.INVALID,
            f"a corner is {away:.3g} m beside the organ, which is {size:.3g} m large; allowed: "
            f"{FARTHEST:g} times that (are its units metres?)",
        )


def _refuse_thick(outline: NDArray[np.float64], thickness: float) -> None:
    """Refuse a rod that calls itself a sheet."""
    most = THICKEST * 2.0 * float(np.sqrt(signed_area(outline) / np.pi))
    if thickness > most:
        raise PatchError(
            PatchCode.INVALID,
            f"thickness = {1e3 * thickness:.3g} mm is not allowed for this outline; allowed: up to "
            f"{1e3 * most:.3g} mm ({THICKEST:g} diameters of a circle as large)",
        )


def _flat(wanted: Wanted) -> tuple[Plane, NDArray[np.float64]]:
    """The patch's plane, and its outline in it, counterclockwise."""
    corners = wanted.corners
    if wanted.normal is not None:
        # Round the normal that is wanted, whatever the direction of the outline.
        spread = corners - corners.mean(axis=0)
        turn = np.cross(spread, np.roll(spread, -1, axis=0)).sum(axis=0)
        corners = corners[::-1] if turn @ wanted.normal < 0.0 else corners
    # What crosses itself may enclose no area on balance; the crossing is what is wrong then.
    try:
        plane, outline = plane_of(corners)
    except NotFlatError:
        raise
    except OutlineError:
        _refuse_crossing(corners)
        raise
    return plane, checked_outline(outline)


def _refuse_crossing(corners: NDArray[np.float64]) -> None:
    """Refuse an outline without area that crosses itself in the plane that it is nearest to."""
    if len(corners) > 3 and np.isfinite(corners).all():
        spread = corners - corners.mean(axis=0)
        axes = np.linalg.svd(spread, full_matrices=False)[2]
        checked_outline(spread @ axes[:2].T)


def _code(error: OutlineError) -> PatchCode:
    kinds = {
        CrossingError: PatchCode.CROSSES,
        NotFlatError: PatchCode.NOT_FLAT,
        TooManyNodesError: PatchCode.TOO_LARGE,
    }
    return kinds.get(type(error), PatchCode.INVALID)


def _has_connections(mesh: Mesh) -> bool:
    sheet = mesh.sheet
    return sheet is not None and sheet.count(CONNECTING) > 0


def _tissue(mesh: Mesh, flat: FlatMesh, thickness: float) -> PatchTissue:
    if mesh.sheet is None:
        return solid(flat, thickness)
    make = double_sheet if _has_connections(mesh) else single_sheet
    return make(flat, thickness, mesh.sheet.stiffness)


def _edit(mesh: Mesh, plane: Plane, tissue: PatchTissue, patch: Patch, tool: str) -> TopologyEdit:
    nodes = (PROVISIONAL + np.arange(len(tissue.points))).astype(np.uint32)
    elements = (PROVISIONAL + np.arange(len(tissue.elements))).astype(np.uint32)
    named = np.where(tissue.elements >= 0, nodes[tissue.elements], NO_PARENT).astype(np.uint32)
    is_sheet = mesh.sheet_rows is not None
    x, y, z = (float(value) for value in plane.axes[2])
    return TopologyEdit(
        base_version=mesh.version,
        kind=PATCH,
        born_nodes=nodes,
        born_rest=plane.to_space(tissue.points),
        added_elements=elements,
        added_nodes=named,
        added_parents=np.full(len(elements), NO_PARENT, dtype=np.uint32),
        born_kinds=tissue.kinds if is_sheet else tissue.kinds[:0],
        born_tissue=tissue.tissue if is_sheet else tissue.tissue[:0],
        added_patches=(
            Patch(patch.young_modulus, patch.density, patch.thickness, (x, y, z), name=patch.name),
        ),
        held_by=tool,
    )
