"""What a cut has opened: its surface in the organ at rest, its length and depth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tissue_sim.geometry.faces import LOCAL_FACES
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import SURFACE
from tissue_sim.geometry.surface import boundary_triangles

DIGITS = 10
"""Decimals [m] by which points at rest are told apart: copies are exactly where their nodes are."""
BEND = 0.5
"""Cosine of the angle by which the surface may bend along a line of cut; beyond, it is another."""

SIDES = [[0, 1], [1, 2], [2, 0]]
"""Corners of a triangle's sides."""

Reals = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class CutSurface:
    """What one cut has opened, in the organ at rest.

    Attributes:
        faces: Corners of one of its two lips [m], shape (n, 3, 3); n = 0 in a sheet.
        lines: Where it meets the organ's surface: lines of edges [m], shape (m, 2, 3) each, the
            longest first. A cut through a wall has one on either side.
    """

    faces: Reals
    lines: tuple[Reals, ...]

    @property
    def length(self) -> float:
        """Of its longest line on the surface [m]; nan: it does not reach the surface."""
        return lengths_of(self.lines[0]).sum() if self.lines else float("nan")

    @property
    def area(self) -> float:
        """Of one lip [m^2]; nan in a sheet."""
        if not len(self.faces):
            return float("nan")
        a, b, c = self.faces.transpose(1, 0, 2)
        return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())

    @property
    def mean_depth(self) -> float:
        """Area over length [m]."""
        return self.area / self.length

    @property
    def depth(self) -> float:
        """Largest distance of the cut from its longest line [m]; through a wall its thickness."""
        if not (len(self.faces) and self.lines):
            return float("nan")
        points = np.unique(self.faces.reshape(-1, 3), axis=0)
        return float(distances_from_lines(points, self.lines[0]).max())


def lengths_of(edges: Reals) -> Reals:
    """Lengths of edges [m], shape (n,), from their ends, shape (n, 2, 3)."""
    lengths: Reals = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    return lengths


def distances_from_lines(points: Reals, edges: Reals) -> Reals:
    """Distance of each point from the nearest of some edges [m], shape (n,).

    Args:
        points: Points [m], shape (n, 3).
        edges: Ends of edges [m], shape (m, 2, 3), m at least 1.
    """
    nearest = np.full(len(points), np.inf)
    for begin, end in edges:
        along = end - begin
        squared = max(float(along @ along), 1e-300)
        share = np.clip((points - begin) @ along / squared, 0.0, 1.0)
        apart = points - (begin + share[:, None] * along)
        np.minimum(nearest, np.einsum("ij,ij->i", apart, apart), out=nearest)
    return np.sqrt(nearest)


@dataclass
class OpenedFaces:
    """Faces that cuts open, found edit by edit.

    Two lips of a cut lie upon each other at rest: a face of the boundary that another one covers
    there has been opened. Faces are named 4 x element + corner, edges of sheets by their triangle.

    Attributes:
        known: Faces that are open.
    """

    known: set[int] = field(default_factory=set)

    def look(self, mesh: Mesh) -> tuple[Rows, Rows]:
        """Faces that were opened since the last look: one lip and the other, shape (n,) each."""
        names, nodes = _border(mesh)
        first, second = _covering(mesh.rest[nodes])
        new = [k for k, face in enumerate(names[first].tolist()) if face not in self.known]
        self.known = set(names[first].tolist()) | set(names[second].tolist())
        return names[first[new]], names[second[new]]


def surface_of_cut(mesh: Mesh, lip: Rows, other: Rows) -> CutSurface:
    """What a cut has opened.

    Args:
        mesh: The organ after it.
        lip: Faces of one lip, as `OpenedFaces` names them.
        other: Faces of the other.
    """
    names, nodes = _border(mesh)
    if mesh.sheet_rows is not None:
        edges = mesh.rest[nodes[np.isin(names, lip)]]
        return CutSurface(np.empty((0, 3, 3)), _connected(edges, np.zeros((len(edges), 3))))
    is_cut = np.isin(names, np.concatenate([lip, other]))
    faces = mesh.rest[nodes[np.isin(names, lip)]]
    edges, normals = _rim(mesh.rest, nodes, is_cut)
    return CutSurface(faces, _connected(edges, normals))


def _border(mesh: Mesh) -> tuple[Rows, Rows]:
    """Names of the faces of the boundary, and their node rows, shape (n, 3) or (n, 2)."""
    rows = mesh.element_rows
    tets, alive = mesh.tets[:rows], mesh.element_alive[:rows]
    if mesh.sheet_rows is not None:
        elements = np.flatnonzero(alive & (mesh.sheet_rows.kinds[:rows] == SURFACE))
        edges = np.sort(tets[elements][:, SIDES].reshape(-1, 2), axis=1).astype(np.int64)
        _, inverse, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
        alone = np.flatnonzero(count[inverse] == 1)
        return 4 * elements[alone // 3] + alone % 3, edges[alone]
    triangles, owners = boundary_triangles(tets, alive, mesh.node_rows)
    corners = tets[owners][:, LOCAL_FACES]
    corner = (corners == triangles[:, None, :]).all(axis=2).argmax(axis=1)
    return 4 * owners.astype(np.int64) + corner, triangles.astype(np.int64)


def _covering(corners: Reals) -> tuple[Rows, Rows]:
    """Pairs of faces that lie upon each other, from their corners [m], shape (n, k, 3)."""
    _, which = np.unique(corners.reshape(-1, 3).round(DIGITS), axis=0, return_inverse=True)
    faces = np.sort(which.reshape(corners.shape[:2]), axis=1)
    order = np.lexsort(faces.T)
    alike = (faces[order[1:]] == faces[order[:-1]]).all(axis=1)
    pairs = np.flatnonzero(alike)
    return order[pairs], order[pairs + 1]


def _rim(rest: Reals, triangles: Rows, is_cut: NDArray[np.bool_]) -> tuple[Reals, Reals]:
    """Edges between a cut and the rest of the surface, each place once, and normals there.

    Returns:
        Ends [m], shape (n, 2, 3), and unit normals of the uncut side, shape (n, 3).
    """
    edges = np.sort(triangles[:, SIDES].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(triangles)), 3)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    same = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    one, other = owner[same], owner[same + 1]
    between = is_cut[one] != is_cut[other]
    ends = rest[edges[same[between]]]
    uncut = triangles[np.where(is_cut[one], other, one)[between]]
    a, b, c = rest[uncut].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    # Both lips have the same edges.
    _, once = np.unique(ends.mean(axis=1).round(DIGITS), axis=0, return_index=True)
    return ends[once], normals[once]


def _connected(edges: Reals, normals: Reals) -> tuple[Reals, ...]:
    """Edges as lines, the longest first: those that share an end where the surface is not bent."""
    if not len(edges):
        return ()
    _, ends = np.unique(edges.reshape(-1, 3).round(DIGITS), axis=0, return_inverse=True)
    order = np.argsort(ends, kind="stable")
    at, owner = ends[order], order // 2
    joined = []
    for point in np.split(owner, np.flatnonzero(np.diff(at)) + 1):
        for k, one in enumerate(point):
            joined += [(one, two) for two in point[k + 1 :] if _smooth(normals[one], normals[two])]
    pairs = np.array(joined, dtype=np.int64).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=2 * (len(edges),))
    count, part = connected_components(graph, directed=False)
    lines = [edges[part == number] for number in range(count)]
    return tuple(sorted(lines, key=lambda line: -lengths_of(line).sum()))


def _smooth(one: Reals, other: Reals) -> bool:
    return bool(one @ other > BEND) or not one.any()
