"""Which edges of a surface a sweep cuts, and which nodes have to be copied for it.

The method of Nienhuys and van der Stappen with one dimension less than in tetrahedra (`selection`):
every edge of a triangle that the sweep crosses gives up its end closer to the sweep. The corner
farthest from the sweep is never chosen, so at most two are, and two make an edge of the cut. At
every node of such edges the triangles are grouped across the edges that are not cut; every group
but the first gets a copy of the node.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cut_service.selection import TIE
from cut_service.sweep import Sweep
from cut_service.sweep_kernels import crossed_edges
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import edge_keys, edges_of_keys

Rows = NDArray[np.int32]
Keys = NDArray[np.int64]

SIDES = np.array([[0, 1], [0, 2], [1, 2]])
"""The edges of a triangle, in the order of the bits of `crossed_edges`."""

BITS = np.array([1 << 0, 1 << 1, 1 << 3])


@dataclass(frozen=True)
class Crossing:
    """What the sweep crosses.

    Attributes:
        triangles: Rows of the triangles with a crossed edge, ascending.
        chosen: Nodes that crossed edges give up, ascending.
        edges: Ends of every crossed edge, the chosen one first, each once, shape (n, 2).
        keys: `edge_keys` of the edges to cut, ascending.
    """

    triangles: Rows
    chosen: Rows
    edges: Rows
    keys: Keys


@dataclass(frozen=True)
class Parting:
    """The nodes that come apart.

    Attributes:
        parents: Row of the node each copy is made of, shape (copies,).
        corners: Old nodes and new nodes of triangles that change, by row: see `rows`.
        rows: Rows of the triangles whose nodes change, ascending, shape (n,).
        nodes: Their new nodes, shape (n, 3); copies are numbered from `first_copy`.
        first_copy: One more than the last row of nodes.
        fans: For every node that was parted, the triangles at each of its versions.
    """

    parents: Rows
    rows: Rows
    nodes: Rows
    first_copy: int
    fans: dict[int, dict[int, list[int]]]


def segments_crossed(
    begin: NDArray[np.float64], end: NDArray[np.float64], sweep: Sweep
) -> NDArray[np.bool_]:
    """Which straight lines from `begin` to `end` [m], shape (n, 3), the sweep crosses."""
    n = len(begin)
    points = np.concatenate([begin, end])
    pairs = np.arange(n, dtype=np.int32)[:, None] + np.array([0, n, n, n], dtype=np.int32)
    masks = np.zeros(n, dtype=np.uint8)
    rows = np.arange(n, dtype=np.int32)
    crossed_edges(points, pairs, rows, sweep.vertices, sweep.triangles, masks)
    return np.asarray(masks > 0)


def near(positions: NDArray[np.float64], items: Rows, sweep: Sweep) -> NDArray[np.bool_]:
    """Which items have boxes that meet that of the sweep, shape (len(items),)."""
    lower, upper = sweep.box
    places = positions[items]
    return np.asarray(((places.max(axis=1) >= lower) & (places.min(axis=1) <= upper)).all(axis=1))


def cross(mesh: Mesh, positions: NDArray[np.float64], solid: Rows, sweep: Sweep) -> Crossing:
    """What the sweep crosses, in the configuration given.

    Args:
        mesh: A mesh that is a sheet.
        positions: Node positions [m], shape (node_rows, 3).
        solid: Rows of the triangles of tissue.
        sweep: What the cut follows.
    """
    rows = solid[near(positions, mesh.tets[solid, :3], sweep)]
    corners = mesh.tets[rows][:, [0, 1, 2, 2]]
    places, masks = sweep.crossed(positions, corners, np.arange(len(rows), dtype=np.int32))
    rows, corners = rows[places], corners[places]
    is_crossed = (masks[:, None] & BITS) > 0
    triangle, side = np.nonzero(is_crossed)
    edges = corners[triangle[:, None], SIDES[side]]
    ranks = _ranks(positions, corners, sweep)
    first, second = edges.T
    keep = (ranks[first] < ranks[second]) | ((ranks[first] == ranks[second]) & (first < second))
    edges = np.where(keep[:, None], edges, edges[:, ::-1])
    given = _give_up(rows, corners, triangle, edges)
    return _give_up(rows, corners, triangle, _without_spurs(edges, given.keys))


def _give_up(rows: Rows, corners: Rows, triangle: NDArray[np.intp], edges: Rows) -> Crossing:
    """What is crossed if the crossed edges of the triangles give up their first ends."""
    chosen = np.zeros((len(rows), 3), dtype=np.bool_)
    for place in range(3):
        chosen[triangle[corners[triangle, place] == edges[:, 0]], place] = True
    two = np.flatnonzero(chosen.sum(axis=1) == 2)
    ends = corners[two][:, :3][chosen[two]].reshape(-1, 2)
    return Crossing(
        rows, np.unique(edges[:, 0]), np.unique(edges, axis=0), np.unique(edge_keys(ends))
    )


def _without_spurs(edges: Rows, keys: Keys) -> Rows:
    """The crossed edges, those turned that would be slit from a line of the cut to its side.

    Where a node is alone on its side of the sweep, all edges at it are crossed and give it up, but
    for one whose other end is closer. Both ends of that one are given up, so it would be cut as a
    spur of the line through the node, though the sweep only passes by its closer end.
    """
    if not len(keys):
        return edges
    degree = np.bincount(edges_of_keys(keys).ravel(), minlength=edges.max() + 1)
    given_up = np.bincount(np.unique(edges, axis=0)[:, 0], minlength=len(degree))
    closer, branch = edges.T
    spurs = np.isin(edge_keys(edges), keys) & (given_up[closer] == 1)
    spurs &= (degree[closer] == 1) & (degree[branch] > 2)
    return np.where(spurs[:, None], edges[:, ::-1], edges)


def _ranks(positions: NDArray[np.float64], corners: Rows, sweep: Sweep) -> NDArray[np.int64]:
    """Distance from the sweep in whole multiples of a small length: noise leaves ties equal."""
    ranks = np.zeros(len(positions), dtype=np.int64)
    nodes = np.unique(corners)
    if len(nodes):
        edge = np.linalg.norm(positions[corners[:, 1]] - positions[corners[:, 0]], axis=1).mean()
        ranks[nodes] = np.rint(sweep.distance(positions[nodes]) / (TIE * edge))
    return ranks


def part(mesh: Mesh, keys: Keys, first_copy: int) -> Parting:
    """Copy the nodes at which triangles come apart along edges.

    Args:
        mesh: A mesh that is a sheet.
        keys: `edge_keys` of the edges to cut.
        first_copy: Number of the first copy.
    """
    cut = set(keys.tolist())
    nodes = np.unique(np.concatenate([keys >> 32, keys & 0xFFFFFFFF]))
    parents: list[int] = []
    changed: dict[int, dict[int, int]] = {}
    fans: dict[int, dict[int, list[int]]] = {}
    for node in nodes.tolist():
        groups = _fans(mesh, node, cut)
        if len(groups) < 2:
            continue
        fans[node] = {node: groups[0]}
        for group in groups[1:]:
            copy = first_copy + len(parents)
            parents.append(node)
            fans[node][copy] = group
            for triangle in group:
                changed.setdefault(triangle, {})[node] = copy
    rows = np.array(sorted(changed), dtype=np.int32)
    new = mesh.tets[rows, :3].copy()
    for place, row in enumerate(rows.tolist()):
        for node, copy in changed[row].items():
            new[place][mesh.tets[row, :3] == node] = copy
    return Parting(np.array(parents, dtype=np.int32), rows, new, first_copy, fans)


def _fans(mesh: Mesh, node: int, cut: set[int]) -> list[list[int]]:
    """The triangles of tissue at a node, joined across edges that are not cut; lowest row first."""
    around = mesh.incident.of(node)
    if mesh.sheet_rows is not None:
        around = around[mesh.sheet_rows.carries(around)]
    at_edge: dict[int, list[int]] = {}
    for triangle, corners in zip(around.tolist(), mesh.tets[around, :3].tolist(), strict=True):
        for other in corners:
            key = (min(node, other) << 32) | max(node, other)
            if other != node and key not in cut:
                at_edge.setdefault(other, []).append(triangle)
    joined: dict[int, set[int]] = {triangle: {triangle} for triangle in around.tolist()}
    for sharing in at_edge.values():
        for other in sharing[1:]:
            if joined[other] is not joined[sharing[0]]:
                whole = joined[sharing[0]] | joined[other]
                for triangle in whole:
                    joined[triangle] = whole
    groups = {id(group): sorted(group) for group in joined.values()}
    return sorted(groups.values())
