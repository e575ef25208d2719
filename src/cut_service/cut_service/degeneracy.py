"""Removing the degeneracies that a cut leaves: flat elements, and edges that have become short.

Snapping and dividing bring nodes close to each other and elements close to flat. That costs twice:
conjugate gradients take more iterations, and a node's highest frequency, which bounds an explicit
integrator's step, grows like one over its shortest edge. What is wanted of an element is therefore
a radius ratio and a *length*: with springs of stiffness E V / l^2 and masses of V / 4 at its
corners, the square of a corner's frequency is a multiple of the sum of 1 / l^2 over its three
edges; the length is sqrt(3 / sum) at the worst corner, that of the edges if all are equal.

An element's figure is the smaller of ratio and length, as shares of what is wanted. It is
degenerate if the figure is below 1 and below what it was before the cut. Two things are done:

1. *Shift*: nodes at a degenerate element are moved, each to where the worst of the elements around
   the node is best: nodes of the cut along the sweep, inner nodes next to the cut anywhere. The cut
   stays where it is, and so does the organ's surface: the volume is kept.
2. *Step back*: what shifting leaves is taken back from the snap, the least that makes up for it,
   at the node of the element where that costs least distance.

A node's place is the weights of the nodes of an element of the mesh before, at rest and deformed,
as when it was snapped. No move makes the worst of the elements around a node worse, nor a radius
ratio below the quality floor smaller.

Limitations: nodes of the organ's surface are not shifted, and elements that are degenerate because
of the surface alone stay so. Elements are neither collapsed nor flipped; docs/cutting.md says why.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cut_service.degeneracy_kernels import Stage, find_kinds, find_lacking, set_limits, shift_all
from cut_service.degeneracy_kernels import step_back as step_back_all
from cut_service.neighbours import NOBODY, Links
from cut_service.snapping import Snapping
from cut_service.work import Work
from tissue_sim.geometry.incidence import sorted_unique

Reals = NDArray[np.float64]
Rows = NDArray[np.int32]

DIVIDED = 0.5
"""Share of what is wanted of elements that is wanted of the parts of divided ones."""

ROUNDS = 3
"""How often it is looked for elements that still are degenerate, and stepped back."""


@dataclass(frozen=True)
class Made:
    """Nodes that a cut makes, in places within elements of the mesh before.

    Attributes:
        holders: Row of the element each lies in, shape (n,).
        ends: Rows of the nodes of the edge each was made on, shape (n, 2).
        weights: Barycentric weights in the element, shape (n, 4).
        rest: Rest positions [m], shape (n, 3).
        positions: Current positions [m], shape (n, 3).
    """

    holders: Rows
    ends: Rows
    weights: Reals
    rest: Reals
    positions: Reals

    @classmethod
    def none(cls) -> Made:
        """No nodes."""
        empty = np.empty((0, 4), dtype=np.int32)
        return cls(empty[:, 0], empty[:, :2], np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 3)))


@dataclass(frozen=True)
class Relief:
    """What is left of a cut's degeneracies.

    Attributes:
        snapping: All old nodes that move, those that were snapped among them.
        made: The new nodes.
        change: Change of rest volume by all that moves [m^3].
        found: Degenerate elements before.
        left: Degenerate elements that are left.
    """

    snapping: Snapping
    made: Made
    change: float
    found: int = 0
    left: int = 0


def relieve(
    work: Work,
    links: Links,
    nodes: Rows,
    snapping: Snapping,
    change: float,
    budget: float,
    made: Made | None = None,
) -> Relief:
    """Move nodes so that elements at a cut are not degenerate.

    Args:
        work: The plan's.
        links: The mesh whose elements are judged, its rows those of the plan's mesh and then
            others.
        nodes: Rows of the nodes of the cut, new ones behind the mesh's own.
        snapping: What snapping did.
        change: Change of the rest volume by that [m^3].
        budget: Largest change of the rest volume [m^3].
        made: New nodes of divided elements; None: no element was divided.
    """
    wanted = 1.0 if made is None else DIVIDED
    made = made or Made.none()
    if not work.settings.remove_degeneracies or not len(nodes):
        return Relief(snapping, made, change)
    stage = _stage(work, links, snapping, made, wanted)
    rows = len(stage.rest)
    on_cut, still = np.zeros(rows, dtype=np.bool_), np.zeros(rows, dtype=np.bool_)
    on_cut[nodes] = True
    still[: len(work.still)] = work.still
    suspects = _at(links, nodes)
    set_limits(stage, suspects, work.settings.quality_floor)
    lacking = _lacking(stage, suspects)
    found = len(lacking)
    if not found:
        return Relief(snapping, made, change)
    near = sorted_unique(links.tets[lacking].ravel())
    around = _at(links, near)
    find_kinds(links, near, on_cut, still, stage.kinds)
    set_limits(stage, around, work.settings.quality_floor)
    shift_all(stage, lacking)
    suspects = np.union1d(suspects, around)
    lacking = _lacking(stage, suspects)
    for _ in range(ROUNDS):
        if not len(lacking):
            break
        change, stepped = step_back_all(stage, lacking, change, budget)
        if not stepped:
            break
        lacking = _lacking(stage, suspects)
    return Relief(_moves(work, stage), _remade(work, stage, made), change, found, len(lacking))


def _lacking(stage: Stage, elements: Rows) -> Rows:
    """Those of some elements that are degenerate."""
    out = np.empty(len(elements), dtype=np.int32)
    return out[: find_lacking(stage, elements, out)]


def _at(links: Links, nodes: Rows) -> Rows:
    """Rows of the elements that meet any of the nodes, ascending."""
    count = links.length[nodes]
    first = np.repeat(links.start[nodes] - np.cumsum(count) + count, count)
    return sorted_unique(links.data[first + np.arange(int(count.sum()))])


def _stage(work: Work, links: Links, snapping: Snapping, made: Made, wanted: float) -> Stage:
    own, new = len(work.positions), len(made.holders)
    rest = np.concatenate([work.rest, made.rest])
    shape = np.concatenate([work.positions, made.positions])
    rest[snapping.nodes] = snapping.rest
    shape[snapping.nodes] = np.einsum(
        "ij,ijk->ik", snapping.weights, work.positions[snapping.anchors]
    )
    homes = np.repeat(np.arange(own, dtype=np.int32)[:, None], 2, axis=1)
    anchors = np.full(own + new, NOBODY, dtype=np.int32)
    weights = np.zeros((own + new, 4))
    anchors[snapping.nodes], weights[snapping.nodes] = snapping.elements, snapping.weights
    anchors[own:], weights[own:] = made.holders, made.weights
    how = work.settings
    return Stage(
        links, work.links, work.rest, work.positions, rest, shape,
        np.concatenate([homes, made.ends]), anchors, weights,
        np.zeros(own + new, dtype=np.uint8), work.sweep.measured,
        np.zeros((2, len(links.tets))), np.zeros((2, len(links.tets))),
        wanted * np.array([how.wanted_ratio, how.wanted_length * work.mean_edge]),
    )  # fmt: skip


def _moves(work: Work, stage: Stage) -> Snapping:
    own = len(work.positions)
    nodes = np.flatnonzero(stage.anchors[:own] != NOBODY).astype(np.int32)
    nodes = nodes[(stage.rest[nodes] != work.rest[nodes]).any(axis=1)]
    elements = stage.anchors[nodes]
    return Snapping(
        nodes, stage.rest[nodes], work.links.tets[elements], stage.weights[nodes], elements
    )


def _remade(work: Work, stage: Stage, made: Made) -> Made:
    own = len(work.positions)
    return Made(
        stage.anchors[own:], made.ends, stage.weights[own:], stage.rest[own:], stage.shape[own:]
    )
