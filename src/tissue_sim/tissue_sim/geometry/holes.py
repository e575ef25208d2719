"""Holes: loops of places on the tissue that are remembered by its nodes and move with them.

Nothing is followed edit by edit: where a place is now is found from its nodes, their copies and
their parents as the mesh knows them, so that whoever missed edits finds the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.closure import (
    Closure,
    LoopError,
    Pieces,
    checked_loop,
    disc_of,
    measure,
    without_repeats,
)
from tissue_sim.geometry.closure_kernels import nearest_places
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet_rows import NO_ROW
from tissue_sim.geometry.surface import boundary_triangles

Reals = NDArray[np.float64]

REACH = 0.003
"""Distance [m] within which a position is attached to the surface if none is named."""

FARTHEST_REACH = 0.1
"""Largest reach and depth [m] that are believed."""

MOST_POSITIONS = 500
"""Most positions of a loop: more is a mistake."""

DEPTH_SHARE = 0.5
"""How far over and under a hole a patch covers it by default, as a share of the radius of a circle
of the hole's first area."""

GENERATIONS = 8
"""How many copies of copies a place is followed through."""


class NothingThereError(LoopError):
    """A position without tissue within reach."""


class HoleLostError(LoopError):
    """A hole most of whose edge is no more."""


@dataclass(frozen=True)
class Surface:
    """The surface of a mesh, parted into tissue and patches.

    Attributes:
        tissue: Node rows of its triangles, normals outward, shape (t, 3).
        patches: The same of the patches, shape (p, 3).
        owners: Patch of each of these, shape (p,).
        thickness: Thickness of that patch [m], shape (p,).
    """

    tissue: NDArray[np.int32]
    patches: NDArray[np.int32]
    owners: NDArray[np.int32]
    thickness: Reals

    @classmethod
    def of(cls, mesh: Mesh) -> Surface:
        """Find the surface of a mesh as it is now."""
        triangles, elements = _surface(mesh)
        labels, owners = mesh.regions[elements], np.zeros(len(elements), dtype=np.int32)
        thickness = np.zeros(len(elements))
        for patch in mesh.patches:
            own = labels == patch.label
            owners[own], thickness[own] = patch.id, patch.thickness
        of_patch = owners > 0
        return cls(
            triangles[~of_patch], triangles[of_patch], owners[of_patch],
            thickness[of_patch],
        )  # fmt: skip

    def pieces(self, shape: Reals) -> Pieces:
        """The patches at a shape [m], shape (node_rows, 3)."""
        return Pieces(shape[self.patches], self.owners, self.thickness)


_SEEN: WeakKeyDictionary[Mesh, tuple[int, Surface]] = WeakKeyDictionary()


def surface_of(mesh: Mesh) -> Surface:
    """The surface of a mesh as it is now, looked for once at each version."""
    seen = _SEEN.get(mesh)
    if seen is None or seen[0] != mesh.version:
        seen = _SEEN[mesh] = (mesh.version, Surface.of(mesh))
    return seen[1]


@dataclass(frozen=True)
class Hole:
    """A hole that has a name.

    Attributes:
        name: Its name.
        nodes: Ids of the corners of the surface triangle that each position of its loop is on,
            shape (n, 3).
        weights: Where on it: barycentric weights, shape (n, 3).
        depth: How far over and under its disc a patch covers it [m].
        first_area: Its area when it was named [m^2].
    """

    name: str
    nodes: NDArray[np.uint32]
    weights: Reals
    depth: float
    first_area: float

    def loop(self, mesh: Mesh, shape: NDArray[np.floating]) -> Reals:
        """Where its edge is at a shape [m], shape (m, 3): without what is no more.

        Raises:
            HoleLostError: Fewer than three places are left, or they are not finite.
        """
        rows, weights = _places_now(mesh, self.nodes, self.weights)
        there = rows[:, 0] != NO_ROW
        places = np.asarray(shape, dtype=np.float64)[rows[there]]
        loop = without_repeats(np.einsum("ij,ijk->ik", weights[there], places))
        if len(loop) < 3:
            raise HoleLostError(
                f"the tissue around {self.name} is no more: {len(loop)} of {len(rows)} positions "
                "of its edge are left"
            )
        if not np.isfinite(loop).all():
            raise HoleLostError(f"the tissue around {self.name} is at places that are not finite")
        return loop

    def lost(self, mesh: Mesh) -> int:
        """How many positions of its edge are no more."""
        return int((_places_now(mesh, self.nodes, self.weights)[0][:, 0] == NO_ROW).sum())

    def closure(self, mesh: Mesh, shape: NDArray[np.floating]) -> Closure:
        """How far it is closed at a shape [m], shape (node_rows, 3).

        Raises:
            HoleLostError: Its edge is no more.
        """
        places = np.asarray(shape, dtype=np.float64)
        surface = surface_of(mesh)
        loop = self.loop(mesh, shape)
        return measure(loop, self.depth, surface.pieces(places), places[surface.tissue])


def name_hole(
    mesh: Mesh,
    shape: NDArray[np.floating],
    name: str,
    positions: Reals,
    reach: float = 0.0,
    depth: float = 0.0,
) -> Hole:
    """Remember a hole by the tissue around it.

    Args:
        mesh: The mesh, at the version that `shape` belongs to.
        shape: Current node positions [m], shape (node_rows, 3).
        name: What to call it.
        positions: A closed loop around it, in turn, on its edge [m], shape (n, 3). Each is attached
            to the closest point of the tissue's surface, patches left out.
        reach: Distance within which that point must be [m]; 0: `REACH`.
        depth: How far over and under the disc a patch covers it [m]; 0: half of the radius of a
            circle as large as the hole.

    Raises:
        LoopError: A number is not allowed, or the loop is no edge of a hole.
        NothingThereError: There is no tissue within reach of a position.
    """
    if not name or len(name) > 100 or not name.isprintable():
        raise LoopError("the name is not allowed; allowed: 1 to 100 printable characters")
    if not (0.0 <= reach <= FARTHEST_REACH and 0.0 <= depth <= FARTHEST_REACH):
        raise LoopError(f"reach and depth must be from 0 to {FARTHEST_REACH:g} m")
    if len(positions) > MOST_POSITIONS:
        raise LoopError(f"{len(positions)} positions; allowed: up to {MOST_POSITIONS}")
    wanted = checked_loop(positions)
    places = np.asarray(shape, dtype=np.float64)
    nodes, weights = _attach(mesh, places, wanted, reach or REACH)
    loop = checked_loop(np.einsum("ij,ijk->ik", weights, places[nodes]))
    area = float(disc_of(loop).areas.sum())
    depth = depth or DEPTH_SHARE * float(np.sqrt(area / np.pi))
    return Hole(name, mesh.node_ids[nodes], weights, depth, area)


def _surface(mesh: Mesh) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Triangles of the surface, and the element that each belongs to."""
    rows = mesh.element_rows
    if mesh.sheet_rows is None:
        triangles, elements = boundary_triangles(
            mesh.tets[:rows], mesh.element_alive[:rows], mesh.node_rows
        )
        return triangles, elements.astype(np.int64)
    # A triangle or a wall has three nodes, a spring two.
    found = np.flatnonzero(mesh.element_alive[:rows] & (mesh.tets[:rows, 2] >= 0))
    return mesh.tets[found, :3], found


def _attach(
    mesh: Mesh, shape: Reals, positions: Reals, reach: float
) -> tuple[NDArray[np.int32], Reals]:
    """Triangles of the tissue's surface closest to positions, and the weights there."""
    triangles = surface_of(mesh).tissue
    corners = shape[triangles]
    low, high = positions.min(axis=0) - reach, positions.max(axis=0) + reach
    near = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    triangles, count = triangles[near], len(positions)
    distances, nearest, weights = np.empty(count), np.empty(count, np.int64), np.empty((count, 3))
    nearest_places(np.ascontiguousarray(corners[near]), positions, distances, nearest, weights)
    far = np.flatnonzero(~(distances <= reach))
    if len(far):
        where = ", ".join(f"{1e3 * value:.1f}" for value in positions[far[0]])
        raise NothingThereError(
            f"no tissue within {1e3 * reach:g} mm of ({where}) mm"
            + (f" and {len(far) - 1} other positions" if len(far) > 1 else "")
        )
    return triangles[nearest], weights


def _places_now(
    mesh: Mesh, nodes: NDArray[np.uint32], weights: Reals
) -> tuple[NDArray[np.int32], Reals]:
    """Node rows and weights of places as the mesh is now; -1 for places that are no more.

    A node that is no more is stood in for by the closest of its parents that is. A triangle that a
    cut has drawn apart is looked for among copies of its nodes; where it is no more, the place goes
    to the node that had the most weight.
    """
    rows, weights = mesh.node_rows_of(nodes), weights.copy()
    for k in np.flatnonzero(~_together(mesh, rows)):
        own = [_ancestor(mesh, int(node)) for node in nodes[k]]
        best = _reunited(mesh, own)
        if best is None:
            alive = np.array(own) != NO_ROW
            best = [own[int(np.argmax(np.where(alive, weights[k], -1.0)))]] * 3
        rows[k] = best
    return rows, weights


def _together(mesh: Mesh, rows: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which triples of nodes have an element in common."""
    return np.array([(triple >= 0).all() and _shared(mesh, triple) for triple in rows], np.bool_)


def _shared(mesh: Mesh, triple: NDArray[np.integer]) -> bool:
    a, b, c = (int(row) for row in triple)
    around = mesh.tets[mesh.incident.of(a)]
    return bool(((around == b).any(axis=1) & (around == c).any(axis=1)).any())


def _ancestor(mesh: Mesh, node: int) -> int:
    """Row of a node or, if it is no more, of the closest of its parents that is; -1: none is."""
    while True:
        row = int(mesh.node_rows_of(np.array([node], dtype=np.uint32))[0])
        if row != NO_ROW:
            return row
        at = np.flatnonzero(mesh.node_ids[: mesh.node_rows] == node)
        if not len(at) or mesh.node_parents[at[0]] == node:
            return NO_ROW
        node = int(mesh.node_parents[at[0]])


def _reunited(mesh: Mesh, rows: list[int]) -> list[int] | None:
    """A triangle made of three nodes or copies of them, the fewest copies; None: there is none."""
    if NO_ROW in rows:
        return None
    families = [_family(mesh, row) for row in rows]
    triples = sorted(
        product(*(range(len(family)) for family in families)), key=lambda places: sum(places)
    )
    for places in triples:
        triple = [family[place] for family, place in zip(families, places, strict=True)]
        if _shared(mesh, np.array(triple)):
            return triple
    return None


def _family(mesh: Mesh, row: int) -> list[int]:
    """A node and its living copies and copies of copies, the closest relatives first."""
    parents, found, last = mesh.node_parents[: mesh.node_rows], [row], [row]
    for _ in range(GENERATIONS):
        ids = mesh.node_ids[last]
        children = np.flatnonzero(np.isin(parents, ids))
        last = [child for child in children.tolist() if child not in found]
        found += last
        if not last:
            break
    return [member for member in found if mesh.node_alive[member]]
