"""Tearing: tissue that is pulled too hard splits along the faces most perpendicular to the pull."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cut_service.crack import (
    Cut,
    Fan,
    add,
    best_fan,
    inner_faces,
    on_surface,
    settled,
    taken_back,
)
from cut_service.pieces import piece_of
from cut_service.ungluing import Ungluing, unglue, unglue_at
from cut_service.work import Work, face_nodes
from tissue_sim.elastic.stress import ElementMaterial, pulled_hard, stresses_of
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.faces import LOCAL_FACES

Rows = NDArray[np.int32]
Reals = NDArray[np.float64]

MOST_LOOKED_AT = 100
"""Elements above the threshold that are considered, the most stressed ones."""

MOST_TRIED = 30
"""Elements that a crack is tried at in one plan."""

ALIGNED = 0.7071
"""Cosine of the largest angle between the pull and the normal of the face that opens first."""


class TearError(ValueError):
    """A threshold or a limit of tearing that makes no sense."""


@dataclass(frozen=True)
class TearSettings:
    """When tissue tears and how fast.

    Attributes:
        threshold: Largest principal stress that tissue bears [Pa]; 0: it never tears.
        faces_per_edit: Faces after which one edit opens no further node.
        pull_share: Faces open if their mean normal traction is at least this share of the
            threshold.
        spacing: Cracks that open in the same edit are so many mean edges apart.
        smallest_piece: A piece needs at least this many elements to be torn off.
    """

    threshold: float = 0.0
    faces_per_edit: int = 24
    pull_share: float = 0.6
    spacing: float = 6.0
    smallest_piece: int = 5

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            TearError: Naming what is wrong and what is allowed.
        """
        for name, low, high in (
            ("threshold", 0.0, 1e12), ("faces_per_edit", 1, 10000), ("pull_share", 0.0, 1.0),
            ("spacing", 0.0, 1e6), ("smallest_piece", 1, 1000),
        ):  # fmt: skip
            value = getattr(self, name)
            if not math.isfinite(value) or not low <= value <= high:
                raise TearError(f"{name} = {value:g} is not allowed; allowed: {low:g} to {high:g}")


@dataclass(frozen=True)
class Tear:
    """What looking for a tear found.

    Attributes:
        over: Elements above the threshold.
        largest: The largest stress found [Pa]; what is far below the threshold is not looked at.
        edit: What opens; None: nothing does.
        faces: Faces that open.
        why: Why nothing opens though elements are above the threshold; empty if something does.
        corners: Where the corners of the faces are that open [m], shape (faces, 3, 3).
    """

    over: int
    largest: float
    edit: TopologyEdit | None = None
    faces: int = 0
    why: str = ""
    corners: Reals = field(default_factory=lambda: np.empty((0, 3, 3)), repr=False)


@dataclass(frozen=True)
class _Seeds:
    """Faces that a crack may open with, those pulled apart hardest first.

    Attributes:
        elements: Rows of the elements that they belong to, shape (n,).
        faces: Nodes of the face of each, shape (n, 3).
        direction: Unit vector of the direction each is pulled in, shape (n, 3).
        may_split: Nodes that may split, shape (node_rows,).
    """

    elements: Rows
    faces: Rows
    direction: Reals
    may_split: NDArray[np.bool_]


def plan_tear(work: Work, material: ElementMaterial, settings: TearSettings) -> Tear:
    """Plan what tears in the shape given; nothing is changed.

    A crack opens at the element whose best face is pulled apart hardest, and grows from there, face
    by face, as far as elements above the threshold go and one edit may.
    """
    if not settings.threshold > 0.0:
        return Tear(0, 0.0)
    rows, stress, largest = pulled_hard(
        work.rest, work.positions, work.links.tets, work.alive, material, settings.threshold
    )
    if not len(rows):
        return Tear(0, largest)
    seeds = _seeds(work, material, rows, stress)
    if not len(seeds.elements):
        return Tear(
            len(rows), largest, why="none of the elements above the threshold has a node that may "
            "split: they are inside, or at fixed or held nodes",
        )  # fmt: skip
    cut = _grown(work, material, seeds, settings)
    faces = cut.rows
    if not len(faces):
        return Tear(
            len(rows), largest, why="no face at the elements above the threshold can open: it is "
            "not pulled apart hard enough, or too small a piece would come off",
        )  # fmt: skip
    ungluing = unglue(work.links, cut.bits, faces, work.mesh.node_rows)
    corners = work.positions[face_nodes(work.links, ungluing.opened)]
    edit = split_edit(work, faces, ungluing, "tear")
    return Tear(len(rows), largest, edit, len(ungluing.opened), corners=corners)


def _seeds(work: Work, material: ElementMaterial, rows: Rows, stress: Reals) -> _Seeds:
    """Faces at the nodes of elements above the threshold that may split."""
    if len(rows) > MOST_LOOKED_AT:
        rows = rows[np.argsort(-settled(stress), kind="stable")[:MOST_LOOKED_AT]]
    nodes = np.unique(work.links.tets[rows])
    bare = np.zeros(len(nodes), dtype=np.bool_)
    on_surface(work.links, nodes, bare)
    nodes = nodes[bare & ~work.still[nodes]]
    may_split = np.zeros(work.mesh.node_rows, dtype=np.bool_)
    may_split[nodes] = True
    rows = work.mesh.incident.of_all(nodes)
    faces = work.links.tets[rows][:, LOCAL_FACES]
    inside = np.zeros((len(rows), 4), dtype=np.bool_)
    inner_faces(work.links, rows, inside)
    ready = inside & np.any(may_split[faces], axis=2)
    tensors = smoothed_stress(work, material, rows)
    direction = np.linalg.eigh(tensors)[1][:, :, 2]
    normals = unit_normals(work.positions[faces])
    along = np.abs(np.einsum("nfi,ni->nf", normals, direction))
    best = np.argmax(np.where(ready, settled(along), -1.0), axis=1)
    each = np.arange(len(rows))
    unit = normals[each, best]
    pull = np.einsum("ni,nij,nj->n", unit, tensors, unit)
    pull[~ready[each, best] | (along[each, best] <= ALIGNED)] = -np.inf
    able = np.isfinite(pull)
    pull[able] = settled(pull[able])
    order = np.argsort(-pull, kind="stable")[: np.count_nonzero(able)]
    return _Seeds(rows[order], faces[order, best[order]], direction[order], may_split)


def smoothed_stress(work: Work, material: ElementMaterial, rows: Rows) -> Reals:
    """Stress of elements as the mean of their nodes', these the mean of the elements at them [Pa].

    At the tip of a crack the stress of single elements of constant strain points anywhere; that of
    both sides of the crack together points across it.

    Args:
        work: The plan's.
        material: What elements are made of.
        rows: The elements, shape (n,).

    Returns:
        Tensors, shape (n, 3, 3).
    """
    nodes = np.unique(work.links.tets[rows])
    around = work.mesh.incident.of_all(nodes)
    corners = work.links.tets[around]
    tensors = stresses_of(work.rest, work.positions, corners, material.of(around)).tensors
    edges = work.rest[corners[:, 1:]] - work.rest[corners[:, :1]]
    volumes = np.linalg.det(edges)
    place = np.full(work.mesh.node_rows, len(nodes))
    place[nodes] = np.arange(len(nodes))
    where = place[corners].ravel()
    weight = np.bincount(where, np.repeat(volumes, 4), minlength=len(nodes) + 1)
    flat = (tensors * volumes[:, None, None]).reshape(-1, 9)
    total = np.stack(
        [np.bincount(where, np.repeat(flat[:, k], 4), minlength=len(nodes) + 1) for k in range(9)],
        axis=1,
    )
    mean = total / np.maximum(weight, 1e-300)[:, None]
    smooth: Reals = mean[place[work.links.tets[rows]]].mean(axis=1).reshape(-1, 3, 3)
    return smooth


def unit_normals(corners: Reals) -> Reals:
    """Unit normals of triangles, corners of shape (..., 3, 3)."""
    normals = np.cross(
        corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    )
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    unit: Reals = normals / np.maximum(length, 1e-300)
    return unit


def _grown(work: Work, material: ElementMaterial, seeds: _Seeds, settings: TearSettings) -> Cut:
    """The faces to open: from the seeds, the hardest pulled first."""
    cut = Cut(np.zeros(len(work.links.tets), dtype=np.uint8))
    apart = settings.spacing * _mean_edge(work, seeds.elements[:100])
    middles = work.positions[seeds.faces].mean(axis=1)
    waiting = np.ones(len(seeds.elements), dtype=np.bool_)
    far = waiting.copy()
    rim = np.zeros(work.mesh.node_rows, dtype=np.bool_)
    split = np.zeros(work.mesh.node_rows, dtype=np.bool_)
    for _ in range(MOST_TRIED):
        # A seed goes on with a crack of this edit along an edge of it, or is far from all of them.
        shared = rim[seeds.faces].sum(axis=1)
        relieved = split[work.links.tets[seeds.elements]].any(axis=1)
        ready = waiting & ~relieved & ((shared >= 2) | ((shared == 0) & far))
        if len(cut.faces) >= settings.faces_per_edit or not ready.any():
            break
        k = int(np.argmax(ready))
        waiting[k] = False
        a, b, c = sorted(seeds.faces[k].tolist())
        able = [node for node in (a, b, c) if seeds.may_split[node]]
        fan = best_fan(work, material, cut, (a, b, c), seeds.direction[k], able)
        if fan is None or fan.pull < settings.pull_share * settings.threshold:
            continue
        add(work, cut, fan)
        if _splits_still_node(work, cut, fan) or _frees_crumb(work, cut, fan, settings):
            taken_back(work, cut, fan)
            continue
        new = np.array([fan.node, *fan.path])
        rim[new], split[fan.node] = True, True
        gap = middles[:, None] - work.positions[new]
        far &= (np.einsum("nmi,nmi->nm", gap, gap) > apart**2).all(axis=1)
    return cut


def _splits_still_node(work: Work, cut: Cut, fan: Fan) -> bool:
    """Whether a fixed or held node would come apart by a fan, which opens nothing."""
    nodes = np.unique(np.array([fan.node, *fan.path], dtype=np.int32))
    nodes = nodes[work.still[nodes]]
    return len(nodes) > 0 and len(unglue_at(work.links, cut.bits, nodes, 0).parents) > 0


def _frees_crumb(work: Work, cut: Cut, fan: Fan, settings: TearSettings) -> bool:
    """Whether a piece of too few elements would come off along a fan."""
    limit = settings.smallest_piece - 1
    if limit < 1:
        return False
    found = np.empty(limit + 1, dtype=np.int32)
    return any(
        piece_of(work.links, cut.bits, element, limit, found) <= limit
        for sides in fan.sides
        for element in sides
    )


def _mean_edge(work: Work, elements: Rows) -> float:
    corners = work.positions[work.links.tets[elements]]
    return float(np.linalg.norm(corners[:, 1:] - corners[:, :1], axis=2).mean())


def split_edit(work: Work, faces: Rows, ungluing: Ungluing, kind: str) -> TopologyEdit:
    """The edit that copies nodes and moves none.

    Args:
        work: The plan's.
        faces: Element row and opposite corner of the faces cut, shape (n, 2).
        ungluing: What is copied.
        kind: What makes the edit.
    """
    mesh, ids = work.mesh, work.mesh.node_ids
    is_copy = ungluing.nodes >= ungluing.first_copy
    rewritten = np.where(
        is_copy,
        (ungluing.nodes - ungluing.first_copy).astype(np.int64) + PROVISIONAL,
        ids[np.where(is_copy, 0, ungluing.nodes)],
    )
    nodes = np.unique(face_nodes(work.links, faces))
    return TopologyEdit(
        base_version=mesh.version,
        kind=kind,
        read_nodes=ids[nodes],
        read_elements=mesh.element_ids[mesh.incident.of_all(nodes)],
        copied_nodes=(np.arange(len(ungluing.parents)) + PROVISIONAL).astype(np.uint32),
        copy_parents=ids[ungluing.parents],
        rewritten_elements=mesh.element_ids[ungluing.elements],
        rewritten_nodes=rewritten.astype(np.uint32),
    )
