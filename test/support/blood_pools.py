"""Blood pools of a hollow mesh, found by filling voxels: the heart tests' independent witness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from tissue_sim.geometry.heart_anatomy import VESSELS, Vessel
from tissue_sim.geometry.implicit import dot
from tissue_sim.geometry.raw_mesh import RawMesh

VOXEL = 0.5
"""Voxel size [mm]."""
_PLUG_HALF_THICKNESS = 0.9


@njit(cache=True)
def _rasterise(
    points: NDArray[np.float64], tets: NDArray[np.int64], solid: NDArray[np.bool_]
) -> None:
    """Mark voxels whose centre lies in a tetrahedron; points in voxel units."""
    for t in range(len(tets)):
        p0, p1 = points[tets[t, 0]], points[tets[t, 1]]
        p2, p3 = points[tets[t, 2]], points[tets[t, 3]]
        normals = np.stack(
            (
                np.cross(p3 - p1, p2 - p1),
                np.cross(p2 - p0, p3 - p0),
                np.cross(p3 - p0, p1 - p0),
                np.cross(p1 - p0, p2 - p0),
            )
        )
        starts = np.stack((p1, p0, p0, p0))
        low = np.minimum(np.minimum(p0, p1), np.minimum(p2, p3))
        high = np.maximum(np.maximum(p0, p1), np.maximum(p2, p3))
        for i in range(int(np.ceil(low[0])), int(np.floor(high[0])) + 1):
            for j in range(int(np.ceil(low[1])), int(np.floor(high[1])) + 1):
                for k in range(int(np.ceil(low[2])), int(np.floor(high[2])) + 1):
                    place = np.array((float(i), float(j), float(k)))
                    inside = True
                    for face in range(4):
                        inside &= np.dot(normals[face], place - starts[face]) >= -1e-9
                    if inside:
                        solid[i, j, k] = True


@dataclass(frozen=True)
class Pools:
    """Labels of the connected spaces around the solid voxels.

    Attributes:
        labels: Zero in the solid and in plugs, shape (nx, ny, nz).
        lower: Place of voxel (0, 0, 0) [mm].
    """

    labels: NDArray[np.int32]
    lower: NDArray[np.float64]

    def at(self, place: NDArray[np.float64]) -> int:
        """Label of the voxel nearest to a place [mm]."""
        index = np.rint((np.asarray(place) - self.lower) / VOXEL).astype(int)
        return int(self.labels[tuple(index)])

    @property
    def outside(self) -> int:
        """Label of the space around the organ."""
        return int(self.labels[0, 0, 0])

    @property
    def count(self) -> int:
        """How many separate spaces there are."""
        return int(self.labels.max())


class VoxelHeart:
    """The heart as voxels, in which vessels can be plugged."""

    def __init__(self, mesh: RawMesh) -> None:
        points = mesh.points * 1e3
        self._lower = points.min(axis=0) - 3.0 * VOXEL
        size = np.ceil((points.max(axis=0) - self._lower) / VOXEL).astype(int) + 4
        self._solid = np.zeros(tuple(size), dtype=bool)
        _rasterise((points - self._lower) / VOXEL, mesh.tetrahedra, self._solid)

    def pools(self, unplugged: tuple[str, ...] = ()) -> Pools:
        """Label the spaces with the vessels' open ends plugged, except those named."""
        blocked = self._solid.copy()
        for vessel in VESSELS:
            if vessel.name not in unplugged:
                self._plug(vessel, blocked)
        labels = np.asarray(ndimage.label(~blocked)[0], dtype=np.int32)
        return Pools(labels, self._lower)

    def _plug(self, vessel: Vessel, blocked: NDArray[np.bool_]) -> None:
        radius = vessel.line[-1, 3] + 0.8 * vessel.wall
        middle = vessel.end - 1.6 * vessel.end_direction
        first = np.floor((middle - radius - 2.0 - self._lower) / VOXEL).astype(int)
        last = np.ceil((middle + radius + 2.0 - self._lower) / VOXEL).astype(int)
        box = tuple(slice(max(a, 0), b) for a, b in zip(first, last, strict=True))
        index = np.moveaxis(np.indices(blocked[box].shape), 0, -1) + np.maximum(first, 0)
        offset = index * VOXEL + self._lower - middle
        along = dot(offset, vessel.end_direction)
        across = np.sqrt(dot(offset, offset) - along * along)
        blocked[box] |= (np.abs(along) < _PLUG_HALF_THICKNESS) & (across < radius)
