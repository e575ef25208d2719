"""Whether a flat sheet overlaps tissue."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.outline import Plane, within


def overlap_of(
    mesh: Mesh,
    positions: NDArray[np.float64],
    plane: Plane,
    outline: NDArray[np.float64],
    points: NDArray[np.float64],
    thickness: float,
) -> int:
    """Nodes of a sheet that lie in tissue, and nodes of tissue that lie in the sheet.

    Of tissue that is made of surfaces it is not known what is within: only the latter are counted.

    Args:
        mesh: The organ.
        positions: Its shape [m], shape (node_rows, 3).
        plane: The sheet's plane, in its middle.
        outline: Corners of the sheet in the plane [m], shape (n, 2).
        points: Nodes of the sheet in the plane's axes [m], shape (m, 3).
        thickness: Of the sheet [m].
    """
    alive = mesh.node_alive[: len(positions)]
    local = plane.to_plane(positions)
    near = np.flatnonzero(alive & (np.abs(local[:, 2]) <= 0.5 * thickness))
    count = int(within(local[near, :2], outline).sum())
    if mesh.sheet_rows is None:
        count += _in_tetrahedra(mesh, local, points)
    return count


def _in_tetrahedra(mesh: Mesh, local: NDArray[np.float64], points: NDArray[np.float64]) -> int:
    """Points that lie in a living tetrahedron."""
    rows = np.flatnonzero(mesh.element_alive[: mesh.element_rows])
    tets = mesh.tets[rows]
    heights = local[:, 2][tets]
    low, high = points.min(axis=0), points.max(axis=0)
    tets = tets[(heights.min(axis=1) <= high[2]) & (heights.max(axis=1) >= low[2])]
    corners = local[tets]
    near = (corners.min(axis=1) <= high).all(axis=1) & (corners.max(axis=1) >= low).all(axis=1)
    corners = corners[near]
    if not len(corners):
        return 0
    middles = corners.mean(axis=1)
    reach = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
    found = cKDTree(points).query_ball_point(middles, reach)
    which = np.repeat(np.arange(len(corners)), [len(places) for places in found])
    point = np.concatenate([np.asarray(places, dtype=np.int64) for places in found])
    if not len(point):
        return 0
    edges = (corners[:, 1:] - corners[:, :1])[which]
    offset = points[point] - corners[which, 0]
    # Cramer's rule: shares of the volume opposite each corner, of whatever sign the element is.
    volume = np.einsum("ij,ij->i", edges[:, 0], np.cross(edges[:, 1], edges[:, 2]))
    one = np.einsum("ij,ij->i", offset, np.cross(edges[:, 1], edges[:, 2]))
    two = np.einsum("ij,ij->i", edges[:, 0], np.cross(offset, edges[:, 2]))
    three = np.einsum("ij,ij->i", edges[:, 0], np.cross(edges[:, 1], offset))
    shares = (
        np.stack([one, two, three, volume - one - two - three], axis=1) * np.sign(volume)[:, None]
    )
    return len(np.unique(point[(shares >= 0.0).all(axis=1) & (volume != 0.0)]))
