"""Where to grab, pull and cut a mesh that nobody has written a scene for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.surface import surface_triangles, vertex_normals

_PULL = 0.15
_WANTED_NODES = 60
_CANDIDATES = 200
_SMOOTHING = 6
_FAR_ENOUGH = 0.6
"""Share of the greatest distance from the fixed nodes beyond which more is no better."""


@dataclass(frozen=True)
class Interaction:
    """A place to work at, in the tissue's frame at rest.

    Attributes:
        grab_point: A point of the outer surface far from the fixed nodes [m], shape (3,).
        outward: Unit direction out of the tissue there, shape (3,).
        radius: Radius of a sphere around the point that takes in about 60 nodes [m].
        pull: A vector to pull the point along: outward, 15 % of the size [m], shape (3,).
        tool_start: A place for the tool to come from, in front of the point [m], shape (3,).
        cut: Corners of a rectangle through the wall beside the point, in order [m], shape (4, 3).
        thickness: Thickness of the tissue under the point [m].
    """

    grab_point: NDArray[np.float64]
    outward: NDArray[np.float64]
    radius: float
    pull: NDArray[np.float64]
    tool_start: NDArray[np.float64]
    cut: NDArray[np.float64]
    thickness: float


def suggest_interaction(mesh: Mesh) -> Interaction:
    """Find where to grab, pull and cut."""
    points = mesh.rest[: mesh.node_rows]
    alive = mesh.node_alive[: mesh.node_rows]
    triangles = surface_triangles(mesh)
    normals = np.zeros_like(points)
    vertex_normals(points, triangles, normals)
    size = float(np.ptp(points[alive], axis=0).max())
    corners = points[triangles]
    node = _outer_node(points, normals, triangles, alive & mesh.fixed[: mesh.node_rows])
    point, outward = points[node], normals[node]

    wanted = min(_WANTED_NODES, max(4, int(alive.sum()) // 10))
    distances = np.linalg.norm(points[alive] - point, axis=1)
    radius = float(np.partition(distances, wanted - 1)[wanted - 1])
    thickness = min(_first_hit(corners, point - 1e-4 * size * outward, -outward), 0.5 * size)
    return Interaction(
        grab_point=point,
        outward=outward,
        radius=radius,
        pull=_PULL * size * outward,
        tool_start=point + 0.1 * size * outward,
        cut=_rectangle(
            point, outward, points[triangles].mean(axis=(0, 1)), size, radius, thickness
        ),
        thickness=thickness,
    )


def _outer_node(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    triangles: NDArray[np.int32],
    fixed: NDArray[np.bool_],
) -> int:
    """A surface node far from the fixed ones, amid a smooth patch, which sees the outside."""
    surface = np.unique(triangles)
    surface = surface[~fixed[surface]] if not fixed[surface].all() else surface
    centre = points[surface].mean(axis=0)
    far = np.linalg.norm(points[surface] - centre, axis=1)
    if fixed.any():
        far = cKDTree(points[fixed]).query(points[surface])[0]
    away = points[surface] - centre
    facing = np.einsum("ij,ij->i", away, normals[surface]) / np.maximum(
        np.linalg.norm(away, axis=1), 1e-12
    )
    score = np.minimum(far, _FAR_ENOUGH * far.max()) * np.clip(facing, 0.2, 1.0)
    order = np.argsort(-score * _flatness(normals, triangles)[surface] ** 2, kind="stable")
    corners, size = points[triangles], float(np.ptp(points, axis=0).max())
    for row in surface[order[:_CANDIDATES]].tolist():
        start = points[row] + 1e-4 * size * normals[row]
        if not np.isfinite(_first_hit(corners, start, normals[row])):
            return int(row)
    return int(surface[order[0]])


def _flatness(normals: NDArray[np.float64], triangles: NDArray[np.int32]) -> NDArray[np.float64]:
    """Length of the mean normal of each node's surroundings: 1 in a plane, little at rims."""
    corners = triangles.ravel()
    degree = np.maximum(np.bincount(corners, minlength=len(normals)), 1)
    for _ in range(_SMOOTHING):
        means = np.repeat(normals[triangles].mean(axis=1), 3, axis=0)
        sums = [np.bincount(corners, weights=axis, minlength=len(normals)) for axis in means.T]
        normals = np.stack(sums, axis=1) / degree[:, None]
    return np.asarray(np.linalg.norm(normals, axis=1))


def _first_hit(
    corners: NDArray[np.float64], start: NDArray[np.float64], direction: NDArray[np.float64]
) -> float:
    """Distance along a ray to the first triangle, infinite if there is none (Moeller, Trumbore)."""
    a = corners[:, 0]
    u, v = corners[:, 1] - a, corners[:, 2] - a
    p = np.cross(direction, v)
    determinant = np.einsum("ij,ij->i", u, p)
    crosses = np.abs(determinant) > 1e-18
    inverse = 1.0 / np.where(crosses, determinant, 1.0)
    s = start - a
    along_u = np.einsum("ij,ij->i", s, p) * inverse
    q = np.cross(s, u)
    along_v = (q @ direction) * inverse
    distance = np.einsum("ij,ij->i", v, q) * inverse
    hit = crosses & (along_u >= 0) & (along_v >= 0) & (along_u + along_v <= 1) & (distance > 0)
    return float(distance[hit].min()) if hit.any() else float("inf")


def _rectangle(
    point: NDArray[np.float64],
    outward: NDArray[np.float64],
    centre: NDArray[np.float64],
    size: float,
    radius: float,
    thickness: float,
) -> NDArray[np.float64]:
    """A rectangle through the wall, standing on the surface beside the point."""
    towards = centre - point
    side = towards - (towards @ outward) * outward
    if np.linalg.norm(side) < 1e-3 * size:
        side = np.cross(outward, np.eye(3)[int(np.argmin(np.abs(outward)))])
    side /= np.linalg.norm(side)
    along = np.cross(outward, side)
    middle = point + 1.5 * radius * side
    half = 0.1 * size * along
    out, into = (0.5 * thickness + 0.05 * size) * outward, -1.5 * thickness * outward
    return np.stack([middle - half + out, middle + half + out, middle + half + into,
                     middle - half + into])  # fmt: skip
