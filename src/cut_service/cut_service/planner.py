"""Planning a cut: from a sweep to a `TopologyEdit` and figures about it."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import CutCode, CutError
from cut_service.neighbours import Links, links_of
from cut_service.pieces import glue_crumbs
from cut_service.quality import total_volume
from cut_service.selection import Selection, select
from cut_service.snapping import Snapping, snap
from cut_service.sweep import Sweep
from cut_service.ungluing import Ungluing, unglue
from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.edit_check import SHEETS_STAY_WHOLE
from tissue_sim.geometry.faces import LOCAL_FACES
from tissue_sim.geometry.mesh import Mesh

METHODS = ("split",)


@dataclass(frozen=True)
class Settings:
    """How to cut.

    Attributes:
        snap: Whether the nodes of the cut are moved onto the sweep.
        quality_floor: Smallest radius ratio that a moved node may leave its elements with.
        crease_angle: Angle between surface triangles above which their edge is kept sharp [rad].
        volume_budget: Largest change of rest volume by one cut, as a share of the organ's.
        smallest_piece: A piece needs at least this many elements to be cut free.
    """

    snap: bool = True
    quality_floor: float = 0.1
    crease_angle: float = 0.7
    volume_budget: float = 5e-4
    smallest_piece: int = 5


@dataclass(frozen=True)
class Report:
    """What a cut does.

    Attributes:
        faces_split: Faces that come apart.
        nodes_added: Copies made.
        nodes_moved: Nodes snapped.
        components: Of the organ after the cut.
        distance_before: Mean and largest distance of the cut's faces (corners and centre) from the
            sweep before snapping, in the current configuration [m].
        distance_after: The same after snapping [m].
        volume_change: Of the rest shape, by snapping [m^3].
        crumbs_glued: Faces left whole because they would have freed a piece of a few elements.
        plan_ms: Time it took to plan.
    """

    faces_split: int
    nodes_added: int
    nodes_moved: int
    components: int
    distance_before: tuple[float, float]
    distance_after: tuple[float, float]
    volume_change: float
    crumbs_glued: int
    plan_ms: float


@dataclass(frozen=True)
class Plan:
    """A cut ready to be applied.

    Attributes:
        edit: With provisional ids for the copies.
        report: Figures for people.
    """

    edit: TopologyEdit
    report: Report


@dataclass(frozen=True)
class _Work:
    """What the steps of one plan share."""

    mesh: Mesh
    links: Links
    alive: NDArray[np.bool_]
    positions: NDArray[np.float64]
    sweep: Sweep
    settings: Settings
    still: NDArray[np.bool_] = field(repr=False)


def plan(
    mesh: Mesh,
    positions: NDArray[np.floating],
    sweep: Sweep,
    method: str = "split",
    *,
    settings: Settings | None = None,
    held: NDArray[np.uint32] | None = None,
    base_frame: int = 0,
    author: str = "",
    request_id: str = "",
) -> Plan:
    """Plan a cut in the configuration given. Nothing is changed.

    Args:
        mesh: The mesh, at the version that `positions` belong to.
        positions: Current node positions [m], shape (node_rows, 3).
        sweep: What to cut along, in the same frame as `positions`.
        method: One of `METHODS`.
        settings: How to cut; default: `Settings()`.
        held: Ids of nodes held by tools. Like fixed nodes they are not snapped.
        base_frame: State frame the positions come from.
        author: Client id for the edit.
        request_id: Request id for the edit.

    Raises:
        SweepError: The sweep is enormous beside the organ.
        CutError: Unknown method, tissue made of surfaces, positions that do not fit or are not
            finite, or a sweep that splits nothing.
    """
    begin = time.perf_counter()
    if method not in METHODS:
        raise CutError(
            CutCode.UNKNOWN_METHOD, f"unknown method {method!r}; known: {', '.join(METHODS)}"
        )
    if mesh.sheet is not None:
        raise CutError(CutCode.REFUSED, SHEETS_STAY_WHOLE)
    work = _prepare(mesh, positions, sweep, settings or Settings(), held)
    selection = select(work.links, work.alive, work.positions, sweep)
    if not len(selection.crossed):
        raise CutError(CutCode.MISSED, "the sweep crosses no tissue")
    selection, glued = _without_crumbs(work, selection)
    ungluing = unglue(work.links, selection.cut, selection.faces, mesh.node_rows)
    if not len(ungluing.opened):
        raise CutError(
            CutCode.MISSED,
            f"the sweep crosses {len(selection.crossed)} elements but is too short or "
            "too shallow to part any two of them",
        )
    snapping, volume_change = _snapped(work, ungluing)
    edit = _edit(work, selection, ungluing, snapping, base_frame, author, request_id)
    components = _components_after(work, ungluing)
    before, after = _distances(work, ungluing, snapping)
    report = Report(
        faces_split=len(ungluing.opened),
        nodes_added=len(ungluing.parents),
        nodes_moved=len(snapping.nodes),
        components=components,
        distance_before=before,
        distance_after=after,
        volume_change=volume_change,
        crumbs_glued=glued,
        plan_ms=1e3 * (time.perf_counter() - begin),
    )
    return Plan(edit, report)


def _prepare(
    mesh: Mesh,
    positions: NDArray[np.floating],
    sweep: Sweep,
    settings: Settings,
    held: NDArray[np.uint32] | None,
) -> _Work:
    places = np.ascontiguousarray(positions, dtype=np.float64)
    if places.shape != (mesh.node_rows, 3):
        raise CutError(
            CutCode.NO_TISSUE, f"positions of {mesh.node_rows} nodes wanted, got {places.shape}"
        )
    living = places[mesh.node_alive[: mesh.node_rows]]
    if not len(living) or not np.isfinite(living).all():
        raise CutError(CutCode.NO_TISSUE, "the positions are not finite, or no node is left")
    sweep.check_size(living.min(axis=0), living.max(axis=0))
    still = mesh.fixed[: mesh.node_rows].copy()
    if held is not None:
        rows = mesh.node_rows_of(held)
        still[rows[rows >= 0]] = True
    alive = mesh.element_alive[: mesh.element_rows]
    return _Work(mesh, links_of(mesh), alive, places, sweep, settings, still)


def _without_crumbs(work: _Work, selection: Selection) -> tuple[Selection, int]:
    limit = work.settings.smallest_piece - 1
    faces, cut = selection.faces, selection.cut
    glued = glue_crumbs(work.links, work.positions, faces, limit, cut) if limit > 0 else 0
    kept = (cut[faces[:, 0]] >> faces[:, 1]) & 1 > 0
    return Selection(selection.crossed, faces[kept], cut), int(glued)


def _face_nodes(links: Links, faces: NDArray[np.int32]) -> NDArray[np.int32]:
    return np.take_along_axis(links.tets[faces[:, 0]], LOCAL_FACES[faces[:, 1]], axis=1)


def _snapped(work: _Work, ungluing: Ungluing) -> tuple[Snapping, float]:
    nodes = np.unique(_face_nodes(work.links, ungluing.opened))
    nodes = nodes[~work.still[nodes]] if work.settings.snap else nodes[:0]
    rest = work.mesh.rest[: work.mesh.node_rows]
    volume = total_volume(rest, work.links.tets, work.alive)
    return snap(
        work.links, rest, work.positions, nodes, work.sweep, work.settings.quality_floor,
        float(np.cos(work.settings.crease_angle)), work.settings.volume_budget * volume,
    )  # fmt: skip


def _edit(
    work: _Work,
    selection: Selection,
    ungluing: Ungluing,
    snapping: Snapping,
    base_frame: int,
    author: str,
    request_id: str,
) -> TopologyEdit:
    mesh, ids = work.mesh, work.mesh.node_ids
    copies = np.arange(len(ungluing.parents), dtype=np.uint32)
    is_copy = ungluing.nodes >= ungluing.first_copy
    rewritten = np.where(
        is_copy,
        (ungluing.nodes - ungluing.first_copy).astype(np.int64) + PROVISIONAL,
        ids[np.where(is_copy, 0, ungluing.nodes)],
    )
    read_nodes = np.unique(_face_nodes(work.links, selection.faces))
    stars = [mesh.incident.of(int(node)) for node in read_nodes]
    read_elements = np.unique(np.concatenate([selection.crossed, *stars]))
    return TopologyEdit(
        base_version=mesh.version,
        kind="split",
        base_frame=base_frame,
        read_nodes=ids[read_nodes],
        read_elements=mesh.element_ids[read_elements],
        moved_nodes=ids[snapping.nodes],
        moved_rest=snapping.rest,
        moved_anchors=ids[snapping.anchors],
        moved_weights=snapping.weights,
        copied_nodes=copies + np.uint32(PROVISIONAL),
        copy_parents=ids[ungluing.parents],
        rewritten_elements=mesh.element_ids[ungluing.elements],
        rewritten_nodes=rewritten.astype(np.uint32),
        author=author,
        request_id=request_id,
    )


def _components_after(work: _Work, ungluing: Ungluing) -> int:
    tets = work.links.tets.copy()
    tets[ungluing.elements] = ungluing.nodes
    return connected_components(tets, work.alive, ungluing.first_copy + len(ungluing.parents))[0]


def _distances(
    work: _Work, ungluing: Ungluing, snapping: Snapping
) -> tuple[tuple[float, float], tuple[float, float]]:
    nodes = _face_nodes(work.links, ungluing.opened)
    moved = work.positions.copy()
    moved[snapping.nodes] = np.einsum(
        "ij,ijk->ik", snapping.weights, work.positions[snapping.anchors]
    )
    return _distance_of(work.positions[nodes], work.sweep), _distance_of(moved[nodes], work.sweep)


def _distance_of(corners: NDArray[np.float64], sweep: Sweep) -> tuple[float, float]:
    samples = np.concatenate([corners, corners.mean(axis=1, keepdims=True)], axis=1)
    distance = sweep.distance(samples.reshape(-1, 3))
    return float(distance.mean()), float(distance.max())
