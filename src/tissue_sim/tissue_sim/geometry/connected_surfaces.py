"""Connected surfaces: springs from each node through the tissue to the opposite side.

From every node a ray goes against the normal; the nearest triangle through which it leaves the
tissue is the opposite side, and the node is joined to its three nodes. Rays are traced by trimesh,
with embree where it is installed (the same result, a hundred times as fast).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.errors import MeshError
from tissue_sim.geometry.sheet import edge_keys, edges_of_keys, sides, triangle_normals
from tissue_sim.geometry.surface import vertex_normals

_MOST_LOST = 0.2
"""Share of nodes that may see no opposite side."""

_START = 1e-6
"""How far below the surface rays start, as a share of the surface's size."""


class Opposite(NamedTuple):
    """What lies on the other side of the tissue.

    Attributes:
        triangle: Row of the triangle opposite each node, -1 if there is none, shape (n,).
        depth: Distance to it along the ray [m], infinite if there is none, shape (n,).
    """

    triangle: NDArray[np.int64]
    depth: NDArray[np.float64]


class Connections(NamedTuple):
    """Connecting springs.

    Attributes:
        ends: Nodes, the lower first, each pair once and none that is an edge, shape (n, 2).
        volumes: Tissue each stands for [m^3], shape (n,).
    """

    ends: NDArray[np.int32]
    volumes: NDArray[np.float64]


def opposite_side(points: NDArray[np.float64], triangles: NDArray[np.int32]) -> Opposite:
    """Find the triangle opposite each node.

    Args:
        points: Node positions [m], shape (n, 3).
        triangles: Nodes of triangles with normals out of the tissue, shape (t, 3).

    Raises:
        MeshError: Too many nodes see no opposite side: the surface is open or turned.
    """
    import trimesh

    normals = np.zeros_like(points)
    vertex_normals(points, triangles, normals)
    size = float(np.ptp(points, axis=0).max())
    # Embree traces in single precision: in units of the organ, about its middle.
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    scaled = (points - middle) / size
    shape = trimesh.Trimesh(scaled, triangles, process=False, validate=False)
    rays = np.flatnonzero(normals.any(axis=1))
    hit, ray, places = shape.ray.intersects_id(
        scaled[rays] - _START * normals[rays], -normals[rays],
        multiple_hits=True, return_locations=True,
    )  # fmt: skip
    hit, node = np.asarray(hit, dtype=np.int64), rays[np.asarray(ray, dtype=np.int64)]
    places = np.asarray(places, dtype=np.float64).reshape(-1, 3)
    depth = np.einsum("ij,ij->i", scaled[node] - places, normals[node])
    leaves = np.einsum("ij,ij->i", triangle_normals(points, triangles)[hit], normals[node]) < 0.0
    own = (triangles[hit] == node[:, None]).any(axis=1)
    good = np.flatnonzero(leaves & ~own & (depth > 0.0))
    order = good[np.lexsort((hit[good], depth[good], node[good]))]
    seeing, first = np.unique(node[order], return_index=True)
    found = Opposite(np.full(len(points), -1), np.full(len(points), np.inf))
    found.triangle[seeing] = hit[order[first]]
    found.depth[seeing] = size * depth[order[first]]
    _refuse_lost(found)
    return found


def _refuse_lost(found: Opposite) -> None:
    lost = int((found.triangle < 0).sum())
    if lost > _MOST_LOST * len(found.triangle):
        raise MeshError(
            f"{lost} of {len(found.triangle)} nodes see no opposite side: connected surfaces need "
            "a closed surface around the tissue, with normals outward; for an open one choose "
            "geometry_kind surface"
        )


def column_thickness(
    triangles: NDArray[np.int32], depth: NDArray[np.float64], areas: NDArray[np.float64],
    volume: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Thickness of the tissue that each triangle stands for [m], shape (t,).

    Half of the depth below its nodes, the other half being that of the opposite side, and all of
    it scaled so that nothing is counted twice where columns narrow.

    Args:
        triangles: Nodes of triangles, shape (t, 3).
        depth: Distance to the opposite side below each node [m]; infinite where there is none.
        areas: Areas of the triangles [m^2], shape (t,).
        volume: Volume that the surface encloses [m^3]; not positive: it is not known.
    """
    known = np.isfinite(depth)
    depth = np.where(known, depth, np.median(depth[known]))
    thickness = depth[triangles].mean(axis=1) / 2.0
    scale = volume / float(areas @ thickness)
    return np.asarray(thickness * scale if volume > 0.0 else thickness)


def connect(
    triangles: NDArray[np.int32], opposite: Opposite, node_volumes: NDArray[np.float64]
) -> Connections:
    """Join every node to the three nodes of its opposite triangle, unless a spring is there.

    The tissue of a node is shared out evenly to its springs; two nodes that choose each other get
    one spring with both shares.

    Args:
        triangles: Nodes of triangles, shape (t, 3).
        opposite: The triangle opposite each node.
        node_volumes: Tissue of each node [m^3], shape (n,).
    """
    nodes = np.flatnonzero(opposite.triangle >= 0)
    pairs = np.stack([np.repeat(nodes, 3), triangles[opposite.triangle[nodes]].ravel()], axis=1)
    shares = np.repeat(node_volumes[nodes] / 3.0, 3)
    keys = edge_keys(pairs)
    free = ~np.isin(keys, edge_keys(sides(triangles)))
    keys, place = np.unique(keys[free], return_inverse=True)
    volumes = np.bincount(place.ravel(), weights=shares[free], minlength=len(keys))
    return Connections(edges_of_keys(keys), volumes.astype(np.float64))
