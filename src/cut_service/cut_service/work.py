"""What every way of cutting starts from and hands back."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import CutCode, CutError
from cut_service.excerpt import Excerpt
from cut_service.neighbours import Links, links_of
from cut_service.organ import Organ, organ_of
from cut_service.organ_size import SPARSE, tissue_box
from cut_service.parts import change_of_parts
from cut_service.sweep import Sweep
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.faces import LOCAL_FACES
from tissue_sim.geometry.incidence import sorted_unique
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
        remove_degeneracies: Whether elements that the cut has made flat or short are mended.
        wanted_ratio: Radius ratio below which an element that had more is mended.
        wanted_length: The same of the length of its edges (see `degeneracy`), as a share of the
            mean edge of the organ's elements.
    """

    snap: bool = True
    quality_floor: float = 0.1
    crease_angle: float = 0.7
    volume_budget: float = 5e-4
    smallest_piece: int = 5
    vertex_share: float = 0.15
    vertex_reach: float = 0.05
    remove_degeneracies: bool = True
    wanted_ratio: float = 0.2
    wanted_length: float = 0.4


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
        degenerate: Elements that the cut had made degenerate, and those of them that are left.
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
    degenerate: tuple[int, int] = (0, 0)
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
        unfinished: Ids of the elements around faces that would come apart if the sweep went on,
            shape (u,).
    """

    edit: TopologyEdit
    report: Report
    lips: NDArray[np.float64] = field(repr=False)
    unfinished: NDArray[np.uint32] = field(
        default_factory=lambda: np.empty(0, dtype=np.uint32), repr=False
    )


@dataclass(frozen=True)
class Surroundings:
    """What a plan that looks at part of a mesh knows of the rest.

    Attributes:
        mesh: The mesh.
        organ: Figures of all of it.
        part: The part that the plan looks at.
        crossed: Rows in the part of the elements with an edge that the sweep crosses, ascending,
            shape (n,).
        masks: Those edges, bits in the order of `EDGES`, shape (n,).
    """

    mesh: Mesh
    organ: Organ
    part: Excerpt
    crossed: NDArray[np.int32]
    masks: NDArray[np.uint8]

    @property
    def is_all(self) -> bool:
        """Whether the part is the whole mesh."""
        return len(self.part.elements) == self.organ.elements

    def parts_after(
        self, elements: NDArray[np.int32], old: NDArray[np.int32], new: NDArray[np.int32]
    ) -> int:
        """Number of parts of the organ after an edit, given in rows of the part.

        Args:
            elements: Elements changed, taken out or added, the last with rows behind the part's
                own, shape (n,).
            old: Their nodes before, -1 where one is new, shape (n, 4).
            new: Their nodes after, -1 where one is taken out, shape (n, 4).
        """
        changed = elements[elements < len(self.part.elements)]
        grown = change_of_parts(
            self.mesh, self.part.elements[changed], self._in_mesh(old), self._in_mesh(new)
        )
        return self.organ.parts + grown

    def _in_mesh(self, nodes: NDArray[np.int32]) -> NDArray[np.int32]:
        own = len(self.part.nodes)
        rows = nodes - own + self.mesh.node_rows
        old = nodes < own
        # -1 stays what it is.
        rows[old] = np.append(self.part.nodes, -1)[nodes[old]]
        return np.asarray(rows, dtype=np.int32)


@dataclass(frozen=True)
class Work:
    """What the steps of one plan share.

    Attributes:
        mesh: The mesh, or the part of it that the plan looks at.
        links: What meets where in it.
        alive: Living elements, shape (element_rows,).
        positions: Current node positions [m], shape (node_rows, 3).
        sweep: What to cut along.
        settings: How to cut.
        still: Nodes that must not be moved, shape (node_rows,).
        around: The rest of the mesh, for plans of a part.
    """

    mesh: Mesh
    links: Links
    alive: NDArray[np.bool_]
    positions: NDArray[np.float64]
    sweep: Sweep
    settings: Settings
    still: NDArray[np.bool_] = field(repr=False)
    around: Surroundings | None = None

    @property
    def rest(self) -> NDArray[np.float64]:
        """Rest positions [m], shape (node_rows, 3); a view."""
        return self.mesh.rest[: self.mesh.node_rows]

    @property
    def surroundings(self) -> Surroundings:
        """The rest of the mesh."""
        if self.around is None:
            raise ValueError("this plan looks at the whole mesh and follows no sweep")
        return self.around

    @property
    def volume(self) -> float:
        """Of the organ at rest [m^3]."""
        return self.surroundings.organ.volume

    @property
    def mean_edge(self) -> float:
        """Of the organ's elements [m]."""
        return self.surroundings.organ.mean_edge


def prepare(
    mesh: Mesh,
    positions: NDArray[np.floating],
    sweep: Sweep,
    settings: Settings,
    held: NDArray[np.uint32] | None,
) -> Work:
    """Look at what a plan is asked for; see `planner.plan`.

    Raises:
        CutError: The positions do not fit or are not finite, or the sweep meets no tetrahedra.
    """
    places = np.ascontiguousarray(positions, dtype=np.float64)
    if places.shape != (mesh.node_rows, 3):
        raise CutError(
            CutCode.NO_TISSUE, f"positions of {mesh.node_rows} nodes wanted, got {places.shape}"
        )
    if mesh.sheet_rows is None:
        return _part_of(mesh, places, sweep, settings, held)
    living = places[mesh.node_alive[: mesh.node_rows]]
    if not len(living) or not np.isfinite(living).all():
        raise _no_shape()
    _refuse_enormous(mesh, places, sweep)
    alive = mesh.element_alive[: mesh.element_rows]
    return Work(mesh, links_of(mesh), alive, places, sweep, settings, still_nodes(mesh, held))


def _part_of(
    mesh: Mesh,
    places: NDArray[np.float64],
    sweep: Sweep,
    settings: Settings,
    held: NDArray[np.uint32] | None,
) -> Work:
    """Look at the part of a mesh of tetrahedra that a sweep passes."""
    organ = organ_of(mesh)
    survey = organ.grid.survey(places)
    if not survey.finite or not organ.elements:
        raise _no_shape()
    if len(mesh.patches):
        _refuse_enormous(mesh, places, sweep)
    else:
        sweep.check_size(survey.lower, survey.upper)
    near = organ.grid.near(survey, places, *sweep.box)
    near, masks = sweep.crossed(places, mesh.tets, near, lambda rows: _beside(mesh, sweep, rows))
    if not len(near):
        raise missed()
    part = Excerpt(mesh, near)
    crossed = np.searchsorted(part.elements, near).astype(np.int32)
    return Work(
        part, links_of(part), part.element_alive[: part.element_rows], places[part.nodes], sweep,
        settings, still_nodes(mesh, held)[part.nodes],
        Surroundings(mesh, organ, part, crossed, masks),
    )  # fmt: skip


def _refuse_enormous(mesh: Mesh, places: NDArray[np.float64], sweep: Sweep) -> None:
    """Refuse a sweep that is enormous beside the tissue, wherever patches are."""
    # Nearly every sweep is small beside some of the tissue already.
    if not sweep.fits(*tissue_box(mesh, places, SPARSE)):
        sweep.check_size(*tissue_box(mesh, places))


def _beside(mesh: Mesh, sweep: Sweep, rows: NDArray[np.int32]) -> NDArray[np.int32]:
    """Rows of elements to look at although only what is old of a sweep may cross them.

    Those at the rim of what was cut, and those that meet an element that is crossed anew: snapping
    has moved their nodes, and it may be for another one of them now to choose a face.
    """
    around = mesh.incident.of_all(sorted_unique(mesh.tets[rows].ravel()))
    again = mesh.element_rows_of(sweep.again)
    again = again[again >= 0]
    again = again[mesh.element_alive[again]]
    return np.union1d(around, again).astype(np.int32)


def still_nodes(mesh: Mesh, held: NDArray[np.uint32] | None) -> NDArray[np.bool_]:
    """Nodes that are fixed, or held by tools (their ids are given), shape (node_rows,)."""
    still = mesh.fixed[: mesh.node_rows].copy()
    if held is not None:
        rows = mesh.node_rows_of(held)
        still[rows[rows >= 0]] = True
    return still


def _no_shape() -> CutError:
    return CutError(CutCode.NO_TISSUE, "the positions are not finite, or no node is left")


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
