"""Moving the nodes of a cut onto the sweep, along the edges that it crosses.

Where the sweep crosses an edge there is a place that lies on the surface and on the sweep. A node
that an edge gave up goes to the nearest such place, so that it stays on the surface whatever its
shape. Nodes of a border or a crease go along border or crease only. Steps are halved until no
triangle turns over and none gets worse than the floor of quality, at rest and as deformed, and the
tissue at rest does not get more or less than a cut may change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.sheet_selection import Crossing
from cut_service.sweep import Sweep
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import edge_keys, sides, triangle_normals

Reals = NDArray[np.float64]
Rows = NDArray[np.int32]

LEAST_STEP = 0.1
"""Share of the way to the sweep below which a node is not moved at all."""


@dataclass(frozen=True)
class SheetSnapping:
    """Where nodes go.

    Attributes:
        nodes: Rows of the nodes that move, shape (m,).
        towards: Rows of the nodes at the other ends of the edges they go along, shape (m,).
        share: How far along the edge they go, shape (m,).
    """

    nodes: Rows
    towards: Rows
    share: NDArray[np.float64]

    def moved(self, places: Reals) -> Reals:
        """The places of all nodes [m] when these have moved, shape (n, 3); a copy."""
        there = places.copy()
        t = self.share[:, None]
        there[self.nodes] = (1.0 - t) * places[self.nodes] + t * places[self.towards]
        return there


def snap(
    mesh: Mesh,
    positions: Reals,
    crossing: Crossing,
    movable: Rows,
    sweep: Sweep,
    floor: float,
    crease_cosine: float,
    budget: float,
) -> SheetSnapping:
    """Find where the nodes of a cut go.

    Args:
        mesh: A mesh that is a sheet.
        positions: Node positions [m], shape (node_rows, 3).
        crossing: What the sweep crosses.
        movable: Nodes that may move, ascending.
        sweep: What the cut follows.
        floor: Least quality of a triangle, 1 for an equilateral one.
        crease_cosine: Cosine of the angle between triangles above which their edge is a crease.
        budget: Largest change of the volume of what the triangles stand for at rest [m^3].
    """
    edges = crossing.edges[np.isin(crossing.edges[:, 0], movable)]
    edges = edges[_allowed(mesh, positions, edges, crease_cosine)]
    share = _crossing_places(positions, edges, sweep)
    length = np.linalg.norm(positions[edges[:, 1]] - positions[edges[:, 0]], axis=1)
    order = np.lexsort((edges[:, 1], share * length, edges[:, 0]))
    nodes, first = np.unique(edges[order, 0], return_index=True)
    best = order[first]
    best = best[np.isfinite(share[best]) & (share[best] > 0.0)]
    nodes, towards, wanted = edges[best, 0], edges[best, 1], share[best]
    if not len(nodes):
        return SheetSnapping(nodes, towards, wanted)
    near = mesh.incident.of_all(nodes)
    if mesh.sheet_rows is not None:
        near = near[mesh.sheet_rows.carries(near)]
    used, local = np.unique(mesh.tets[near, :3], return_inverse=True)
    local = local.reshape(-1, 3).astype(np.int32)
    of = np.searchsorted(used, nodes)
    rest, now = mesh.rest[used], positions[used]
    goals = [
        (1.0 - wanted[:, None]) * x[nodes] + wanted[:, None] * x[towards]
        for x in (mesh.rest, positions)
    ]
    steps = np.zeros(len(nodes))
    tissue = np.ones(len(near)) if mesh.sheet_rows is None else mesh.sheet_rows.tissue[near]
    _step_back(
        of.astype(np.int64), local, tissue, rest.copy(), now.copy(), *goals, floor, budget, steps
    )
    moves = steps > 0.0
    return SheetSnapping(nodes[moves], towards[moves], (wanted * steps)[moves])


def _crossing_places(positions: Reals, edges: Rows, sweep: Sweep) -> Reals:
    """Where along edges the sweep crosses them, 0 to 1; infinite where it does not."""
    begin, way = positions[edges[:, 0]], positions[edges[:, 1]] - positions[edges[:, 0]]
    found = np.full(len(edges), np.inf)
    for a, b, c in sweep.corners:
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (a - begin) @ normal / (way @ normal)
        there = begin + np.where(np.isfinite(t), t, 0.0)[:, None] * way
        inside = np.isfinite(t) & (t >= 0.0) & (t <= 1.0)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= np.einsum("ij,j->i", np.cross(q - p, there - p), normal) >= -1e-9 * (
                normal @ normal
            )
        found = np.where(inside & (t < found), t, found)
    return found


def _allowed(mesh: Mesh, positions: Reals, edges: Rows, crease_cosine: float) -> NDArray[np.bool_]:
    """Which edges their first node may go along: any, or creases and borders only."""
    if not len(edges):
        return np.zeros(0, dtype=np.bool_)
    near = mesh.incident.of_all(np.unique(edges[:, 0]).astype(np.int32))
    if mesh.sheet_rows is not None:
        near = near[mesh.sheet_rows.carries(near)]
    triangles = mesh.tets[near, :3]
    normals = triangle_normals(positions, triangles)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    keys = edge_keys(sides(triangles))
    order = np.argsort(keys, kind="stable")
    known, start, count = np.unique(keys[order], return_index=True, return_counts=True)
    one, other = order[start] // 3, order[np.minimum(start + 1, len(order) - 1)] // 3
    flat = (count == 2) & (np.einsum("ij,ij->i", normals[one], normals[other]) > crease_cosine)
    sharp = known[~flat]
    ends = np.stack([sharp >> 32, sharp & 0xFFFFFFFF], axis=1)
    # Edges away from the nodes may have one triangle here only because the other is not near.
    at = np.bincount(ends.ravel(), minlength=len(positions))
    is_sharp = np.isin(edge_keys(edges), sharp)
    creases = at[edges[:, 0]]
    return np.asarray((creases == 0) | (is_sharp & (creases == 2)))


@njit(cache=True, nogil=True)
def _quality(x, a, b, c, normal):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """4 sqrt(3) area over the sum of squared sides; `normal` gets twice the area vector."""
    p0, p1, p2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    q0, q1, q2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    normal[0], normal[1], normal[2] = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
    doubled = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    r0, r1, r2 = q0 - p0, q1 - p1, q2 - p2
    squares = p0 * p0 + p1 * p1 + p2 * p2 + q0 * q0 + q1 * q1 + q2 * q2
    squares += r0 * r0 + r1 * r1 + r2 * r2
    return 2.0 * np.sqrt(3.0) * doubled / squares


@njit(cache=True, nogil=True)
def _grows(x, triangle, node, goal, floor, before, after):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """How much the area grows when a node goes to its goal; nan: the triangle would be bad."""
    a, b, c = triangle
    was = _quality(x, a, b, c, before)
    old0, old1, old2 = x[node, 0], x[node, 1], x[node, 2]
    x[node, 0], x[node, 1], x[node, 2] = goal[0], goal[1], goal[2]
    now = _quality(x, a, b, c, after)
    x[node, 0], x[node, 1], x[node, 2] = old0, old1, old2
    turned = before[0] * after[0] + before[1] * after[1] + before[2] * after[2]
    if not (turned > 0.0 and now >= min(floor, was)):
        return np.nan
    doubled_before = np.sqrt(before[0] ** 2 + before[1] ** 2 + before[2] ** 2)
    return 0.5 * (np.sqrt(after[0] ** 2 + after[1] ** 2 + after[2] ** 2) - doubled_before)


@njit(cache=True, nogil=True)
def _step_back(
    nodes: NDArray[np.int64],
    triangles: Rows,
    tissue: Reals,
    rest: Reals,
    now: Reals,
    rest_goals: Reals,
    now_goals: Reals,
    floor: float,
    budget: float,
    steps: Reals,
) -> None:
    """The share of its way that each node goes, one after the other.

    `tissue` is the thickness of each triangle. Modifies `rest`, `now` and `steps`.
    """
    before, after = np.zeros(3), np.zeros(3)
    spent = 0.0
    for k in range(nodes.shape[0]):
        node, step = nodes[k], 1.0
        while step >= LEAST_STEP:
            rest_goal = rest[node] + step * (rest_goals[k] - rest[node])
            now_goal = now[node] + step * (now_goals[k] - now[node])
            good, grown = True, 0.0
            for t in range(triangles.shape[0]):
                a, b, c = triangles[t]
                if a != node and b != node and c != node:
                    continue
                more = _grows(rest, triangles[t], node, rest_goal, floor, before, after)
                if np.isnan(more) or np.isnan(
                    _grows(now, triangles[t], node, now_goal, floor, before, after)
                ):
                    good = False
                    break
                grown += more * tissue[t]
            if good and abs(spent + grown) <= budget:
                spent += grown
                rest[node], now[node], steps[k] = rest_goal, now_goal, step
                break
            step *= 0.5
