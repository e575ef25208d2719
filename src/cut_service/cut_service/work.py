"""What every way of cutting starts from and hands back."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import CutCode, CutError
from cut_service.neighbours import Links, links_of
from cut_service.sweep import Sweep
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.faces import LOCAL_FACES
from tissue_sim.geometry.mesh import Mesh


@dataclass(frozen=True)
class Settings:
    """How to cut.

    Attributes:
        snap: Whether the nodes of the cut are moved onto the sweep.
        quality_floor: Smallest radius ratio that a moved node may leave its elements with.
        crease_angle: Angle between surface triangles above which their edge is kept sharp [rad].
        volume_budget: Largest change of rest volume by one cut that splits, as a share of the
            organ's.
        smallest_piece: A piece needs at least this many elements to be cut free.
        vertex_share: A sweep that passes an edge nearer to its end than this share of it passes
            through the end: dividing there would leave slivers.
        vertex_reach: The same as a share of the mean edge of the organ's elements, so that cuts
            across cuts do not make ever smaller elements.
    """

    snap: bool = True
    quality_floor: float = 0.1
    crease_angle: float = 0.7
    volume_budget: float = 5e-4
    smallest_piece: int = 5
    vertex_share: float = 0.15
    vertex_reach: float = 0.05


@dataclass(frozen=True)
class Report:
    """What a cut does.

    Attributes:
        faces_split: Faces that come apart, or that removed elements leave bare.
        nodes_added: Copies made, and nodes made on edges.
        nodes_moved: Nodes snapped.
        components: Of the organ after the cut.
        distance_before: Mean and largest distance of the cut's faces (corners and centre) from the
            sweep before snapping, in the current configuration [m].
        distance_after: The same after snapping [m].
        volume_change: Of the rest shape, by snapping or by removed elements [m^3].
        crumbs_glued: Faces left whole because they would have freed a piece of a few elements.
        method: How it was cut.
        elements_removed: Elements that are no more, those that were divided included.
        elements_added: Elements that are new.
        notes: What figures do not say, for people; empty if nothing.
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
    method: str = "split"
    elements_removed: int = 0
    elements_added: int = 0
    notes: str = ""
    plan_ms: float = 0.0


@dataclass(frozen=True)
class Plan:
    """A cut ready to be applied.

    Attributes:
        edit: With provisional ids for what is new.
        report: Figures for people.
        lips: Corners of the cut's faces where they are after snapping, in the current
            configuration [m], shape (faces_split, 3, 3).
    """

    edit: TopologyEdit
    report: Report
    lips: NDArray[np.float64] = field(repr=False)


@dataclass(frozen=True)
class Work:
    """What the steps of one plan share.

    Attributes:
        mesh: The mesh.
        links: What meets where in it.
        alive: Living elements, shape (element_rows,).
        positions: Current node positions [m], shape (node_rows, 3).
        sweep: What to cut along.
        settings: How to cut.
        still: Nodes that must not be moved, shape (node_rows,).
    """

    mesh: Mesh
    links: Links
    alive: NDArray[np.bool_]
    positions: NDArray[np.float64]
    sweep: Sweep
    settings: Settings
    still: NDArray[np.bool_] = field(repr=False)

    @property
    def rest(self) -> NDArray[np.float64]:
        """Rest positions [m], shape (node_rows, 3); a view."""
        return self.mesh.rest[: self.mesh.node_rows]


def prepare(
    mesh: Mesh,
    positions: NDArray[np.floating],
    sweep: Sweep,
    settings: Settings,
    held: NDArray[np.uint32] | None,
) -> Work:
    """Look at what a plan is asked for; see `planner.plan`."""
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
    return Work(mesh, links_of(mesh), alive, places, sweep, settings, still)


def face_nodes(links: Links, faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Nodes of faces given by element row and opposite corner, shape (n, 3)."""
    return np.take_along_axis(links.tets[faces[:, 0]], LOCAL_FACES[faces[:, 1]], axis=1)


def distance_of(corners: NDArray[np.float64], sweep: Sweep) -> tuple[float, float]:
    """Mean and largest distance of triangles' corners and centres from a sweep [m].

    Corners [m] of shape (n, 3, 3).
    """
    if not len(corners):
        return 0.0, 0.0
    samples = np.concatenate([corners, corners.mean(axis=1, keepdims=True)], axis=1)
    distance = sweep.distance(samples.reshape(-1, 3))
    return float(distance.mean()), float(distance.max())


def missed() -> CutError:
    """A sweep that meets nothing."""
    return CutError(CutCode.MISSED, "the sweep crosses no tissue")


def too_shallow(crossed: int) -> CutError:
    """A sweep that meets some elements and parts nothing."""
    return CutError(
        CutCode.MISSED,
        f"the sweep crosses {crossed} elements but is too short or too shallow to part any two of "
        "them",
    )
