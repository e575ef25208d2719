"""Directions at an organ's hold: out of the tissue, and in its plane away from what is fixed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.organ import Organ
from tissue_sim.geometry.surface import surface_triangles

AROUND = 2.0
"""The surface within so many radii of the hold counts."""

FEWEST = 12
"""At least so many triangles count."""

CLEAR = 0.1
"""Cosine below which a direction does not tell one sign, or one tangent, from the other."""


@dataclass(frozen=True)
class Axes:
    """An orthonormal frame.

    Attributes:
        in_plane: In the tissue's plane, away from the fixed nodes, shape (3,).
        normal: Normal of that plane, outward, shape (3,).
        side: normal x in_plane, shape (3,).
    """

    in_plane: NDArray[np.float64]
    normal: NDArray[np.float64]
    side: NDArray[np.float64]


def axes_at(organ: Organ) -> Axes:
    """The axes at an organ's hold.

    The normal is the direction that most of the surface around the hold faces, to one side or the
    other: the eigenvector of the largest eigenvalue of sum(A n n^T) over its triangles. On the free
    side of a wall that is the wall's normal, though the rim itself faces along the wall.

    Args:
        organ: The organ; its hold is not empty.
    """
    centre, radius = _hold(organ)
    areas = _area_normals(organ, centre, AROUND * radius)
    length = np.linalg.norm(areas, axis=1)
    faces = np.einsum("ni,nj->ij", areas / np.where(length > 0.0, length, 1.0)[:, None], areas)
    normal = np.linalg.eigh(faces)[1][:, -1]
    outward = areas.sum(axis=0)
    if abs(normal @ outward) < CLEAR * float(np.linalg.norm(outward)):
        # As much of it faces one way as the other: the sign is a convention.
        outward = np.eye(3)[int(np.argmax(np.abs(normal)))]
    if normal @ outward < 0.0:
        normal = -normal
    in_plane = _in_plane(organ, centre, normal)
    return Axes(in_plane, normal, np.cross(normal, in_plane))


def _hold(organ: Organ) -> tuple[NDArray[np.float64], float]:
    """Centre of the hold and its radius [m]."""
    places = organ.rest[organ.hold]
    centre: NDArray[np.float64] = places.mean(axis=0)
    return centre, float(np.linalg.norm(places - centre, axis=1).max())


def _area_normals(organ: Organ, centre: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Normals of surface triangles near a place, as long as twice their areas, shape (n, 3)."""
    corners = organ.rest[surface_triangles(organ.mesh)]
    away = np.linalg.norm(corners.mean(axis=1) - centre, axis=1)
    order = np.argsort(away, kind="stable")
    count = max(int((away <= radius).sum()), min(FEWEST, len(away)))
    a, b, c = np.moveaxis(corners[order[:count]], 1, 0)
    return np.cross(b - a, c - a)


def _in_plane(
    organ: Organ, centre: NDArray[np.float64], normal: NDArray[np.float64]
) -> NDArray[np.float64]:
    rows = organ.mesh.node_rows
    fixed = organ.mesh.fixed[:rows] & organ.mesh.node_alive[:rows]
    away = centre - organ.rest[fixed if fixed.any() else organ.mesh.node_alive[:rows]].mean(axis=0)
    tangent = away - (away @ normal) * normal
    length = float(np.linalg.norm(tangent))
    if length < CLEAR * float(np.linalg.norm(away)) or length == 0.0:
        # Right above what is fixed: any tangent does, and this one is the same in every run.
        axis = np.eye(3)[int(np.argmin(np.abs(normal)))]
        tangent = axis - (axis @ normal) * normal
        length = float(np.linalg.norm(tangent))
    unit: NDArray[np.float64] = tangent / length
    return unit
