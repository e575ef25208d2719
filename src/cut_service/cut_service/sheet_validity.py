"""What a sheet of triangles and springs must be after every edit, found out on its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cut_service.joined_parts import count_parts
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import Sheet

_SIDES = np.array([[0, 1], [1, 2], [2, 0]])


def _sheet(mesh: Mesh) -> Sheet:
    sheet = mesh.sheet
    if sheet is None:
        raise ValueError(f"{mesh.name} is made of tetrahedra")
    return sheet


def _keys(ends: NDArray[np.integer]) -> NDArray[np.int64]:
    """A number for each unordered pair of nodes."""
    pair = np.sort(ends.reshape(-1, 2), axis=1).astype(np.int64)
    return np.asarray(pair[:, 0] << 32 | pair[:, 1])


def sheet_faults(mesh: Mesh) -> list[str]:
    """What is wrong with a sheet, in words; empty if nothing.

    Triangles have an area; an edge is in one or two of them; all triangles at a node hang together
    through edges at it, every node has one; springs and walls are at such nodes; no two springs,
    and no spring and an edge, join the same nodes; and what springs stand for has a volume.
    """
    sheet, faults = _sheet(mesh), []
    triangles = sheet.triangles
    areas = _areas(mesh.rest, triangles)
    if not (areas > 0.0).all():
        faults.append(f"{int((~(areas > 0.0)).sum())} triangles without an area at rest")
    edges = _keys(triangles[:, _SIDES])
    if np.unique(edges, return_counts=True)[1].max(initial=0) > 2:
        faults.append("edges in more than two triangles")
    used = np.unique(triangles)
    if not np.array_equal(used, np.flatnonzero(mesh.node_alive[: mesh.node_rows])):
        faults.append("nodes without triangles")
    if not np.isin(sheet.springs, used).all() or not np.isin(sheet.walls, used).all():
        faults.append("springs or walls at nodes without triangles")
    springs = _keys(sheet.springs)
    if (sheet.springs[:, 0] == sheet.springs[:, 1]).any():
        faults.append("springs from a node to itself")
    if len(np.unique(springs)) != len(springs) or np.isin(springs, edges).any():
        faults.append("two springs between the same nodes")
    if not (sheet.volumes > 0.0).all() or not (sheet.thickness > 0.0).all():
        faults.append("springs or triangles that stand for no tissue")
    if _fans(triangles, edges) != len(used):
        faults.append("triangles at a node that are not connected through edges")
    return faults


def _fans(triangles: NDArray[np.int32], edges: NDArray[np.int64]) -> int:
    """Groups of triangles that hang together at a node, counted over all nodes."""
    nodes = triangles[:, _SIDES].reshape(-1, 2)
    corners = (3 * np.arange(len(triangles))[:, None, None] + _SIDES).reshape(-1, 2)
    turned = nodes[:, 0] > nodes[:, 1]
    corners[turned] = corners[turned][:, ::-1]
    order = np.argsort(edges, kind="stable")
    same = np.flatnonzero(edges[order][1:] == edges[order][:-1])
    first, second = corners[order[same]].ravel(), corners[order[same + 1]].ravel()
    return count_parts(first, second, 3 * len(triangles))


def sheet_joints(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Pairs of nodes that edges or springs join, nodes numbered anew, and how many there are."""
    sheet = _sheet(mesh)
    pairs = np.concatenate([sheet.triangles[:, _SIDES].reshape(-1, 2), sheet.springs])
    used, ends = np.unique(pairs, return_inverse=True)
    ends = ends.reshape(-1, 2)
    return ends[:, 0], ends[:, 1], len(used)


def sheet_quality(mesh: Mesh) -> tuple[float, float]:
    """Volume of what the triangles stand for at rest [m^3]; smallest 2 r / R of a triangle."""
    sheet = _sheet(mesh)
    areas = _areas(mesh.rest, sheet.triangles)
    sides = mesh.rest[sheet.triangles[:, _SIDES]]
    lengths = np.linalg.norm(sides[:, :, 1] - sides[:, :, 0], axis=2)
    # r = 2 A / (a + b + c) and R = a b c / (4 A).
    ratios = 16.0 * areas**2 / np.maximum(lengths.sum(axis=1) * lengths.prod(axis=1), 1e-300)
    return float(areas @ sheet.thickness), float(ratios.min(initial=1.0))


def _areas(rest: NDArray[np.float64], triangles: NDArray[np.int32]) -> NDArray[np.float64]:
    a, b, c = (rest[triangles[:, k]] for k in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))
