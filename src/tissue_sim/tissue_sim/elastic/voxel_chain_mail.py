"""3D ChainMail on a regular grid of voxels, as Gibson described it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tissue_sim.kernels import voxel_chain_mail as kernels

AXES = 3


@dataclass(frozen=True)
class LinkLimits:
    """How links of a grid give before they pull.

    Attributes:
        nearest: Least distance along the link, for links along each axis [m], shape (3,).
        farthest: Largest distance along the link [m], shape (3,).
        shear: How far its ends may shift across it [m], shape (3,).
    """

    nearest: tuple[float, float, float]
    farthest: tuple[float, float, float]
    shear: tuple[float, float, float]


class VoxelChainMail:
    """Voxels with six neighbours each; one beyond a limit with its neighbour follows it.

    After `move` every link between two voxels that are neither fixed nor held is within its limits,
    and so is every other link if fixed and held voxels leave it a way to be. No voxel moved that
    need not, and none farther along an axis than it had to. In a grid without holes and with one
    voxel moved each voxel is visited once; around holes, or from several, some are visited again.

    Limitations: limits are along the axes of the grid; where fixed and held voxels are farther
    apart than the limits between them, the whole grid is visited and half of what is too much shows
    at either.

    Attributes:
        spacing: Distances of voxels at rest [m], shape (3,).
        displacement: From rest [m], shape (nx ny nz, 3), the last axis of the grid running fastest.
        fixed: Voxels that never move, shape (nx ny nz,).
        visits: Visits of voxels in the last `move`.
        moved: Voxels that followed in the last `move`.

    References:
        S. Gibson, 3D ChainMail: a fast algorithm for deforming volumetric objects, Symposium on
        Interactive 3D Graphics, 1997, doi 10.1145/253284.253324.
    """

    def __init__(
        self,
        size: tuple[int, int, int],
        spacing: tuple[float, float, float],
        limits: LinkLimits,
        fixed: NDArray[np.bool_] | None = None,
        dtype: type[np.floating] = np.float32,
    ) -> None:
        """Make a grid at rest.

        Args:
            size: Voxels along each axis.
            spacing: Their distances [m].
            limits: What its links allow.
            fixed: Voxels that never move, any shape of nx ny nz values; none by default.
            dtype: Precision.

        Raises:
            ValueError: Sizes, distances or limits make no sense.
        """
        _refuse(size, spacing, limits)
        voxels = int(np.prod(size))
        self.size, self.spacing = size, np.array(spacing, dtype=np.float64)
        self.displacement = np.zeros((voxels, AXES), dtype=dtype)
        self.fixed = np.zeros(voxels, dtype=np.bool_)
        if fixed is not None:
            self.fixed[:] = np.asarray(fixed, dtype=np.bool_).reshape(voxels)
        self._grid = kernels.Grid(
            np.array(size, dtype=np.int64), _box(self.spacing, limits).astype(dtype),
            np.ones(voxels, dtype=np.bool_), self.fixed.copy(),
        )  # fmt: skip
        self._wave = kernels.Wave(
            np.full((2, voxels, AXES), -np.inf, dtype), np.zeros(voxels, dtype=np.int64),
            np.zeros(voxels, dtype=np.bool_), np.zeros(voxels, dtype=np.int64),
            np.zeros(voxels, dtype=np.bool_),
        )  # fmt: skip
        self.visits = self.moved = 0

    @property
    def filled(self) -> NDArray[np.bool_]:
        """Where there are voxels, shape (nx, ny, nz)."""
        return self._grid.filled.reshape(self.size)

    @property
    def positions(self) -> NDArray[np.float64]:
        """Where voxels are [m], shape (nx, ny, nz, 3); the first is at the origin at rest."""
        rest = np.moveaxis(np.indices(self.size), 0, -1) * self.spacing
        return rest + self.displacement.reshape(*self.size, AXES)

    def rows(self, voxels: ArrayLike) -> NDArray[np.int64]:
        """Rows of voxels given by their places in the grid, shape (n, 3).

        Raises:
            ValueError: A place is outside the grid.
        """
        places = np.atleast_2d(np.asarray(voxels, dtype=np.int64))
        if places.shape[1] != AXES or (places < 0).any() or (places >= self.size).any():
            raise ValueError(f"a voxel lies outside of the grid; allowed: 0 to {self.size} - 1")
        return (places[:, 0] * self.size[1] + places[:, 1]) * self.size[2] + places[:, 2]

    def remove(self, voxels: ArrayLike) -> None:
        """Take voxels out, with their links: nothing is passed on through them."""
        self._grid.filled[self.rows(voxels)] = False

    def release(self) -> None:
        """Let go of what is held; what was held beyond its limits comes back within them."""
        rows = np.flatnonzero(self._grid.prescribed & ~self.fixed)
        self._grid.prescribed[:] = self.fixed
        arguments = (self._grid, self.displacement, self._wave)
        count, _, crossed = kernels.spread(rows, False, *arguments)
        kernels.settle(count, not crossed, *arguments)
        if crossed:
            count, _, _ = kernels.spread(np.flatnonzero(self._grid.filled), True, *arguments)
            kernels.settle(count, True, *arguments)
            self._follow(np.flatnonzero(self.fixed))

    def move(self, voxels: ArrayLike, displacement: ArrayLike) -> None:
        """Put voxels somewhere and let the others follow. They are held until `release`.

        Args:
            voxels: Their places in the grid, shape (n, 3).
            displacement: From rest [m], shape (3,) or (n, 3).

        Raises:
            ValueError: A place is outside the grid or a displacement is not finite.
        """
        rows, goal = self.rows(voxels), np.asarray(displacement, dtype=np.float64)
        if not np.isfinite(goal).all():
            raise ValueError("a displacement is not finite")
        self._grid.prescribed[rows] = True
        free = ~self.fixed[rows]
        self.displacement[rows[free]] = np.broadcast_to(goal, (len(rows), AXES))[free]
        self._follow(rows[free])

    def _follow(self, sources: NDArray[np.int64]) -> None:
        arguments = (self._grid, self.displacement, self._wave)
        count, self.visits, crossed = kernels.spread(sources, False, *arguments)
        if crossed:
            kernels.settle(count, False, *arguments)
            sources = np.flatnonzero(self._grid.prescribed)
            count, visits, _ = kernels.spread(sources, True, *arguments)
            self.visits += visits
        self.moved = kernels.settle(count, True, *arguments)

    def relax(self, sweeps: int = 1, rate: float = 1.0) -> float:
        """Pull every voxel towards where its neighbours want it, within the limits.

        Args:
            sweeps: How often.
            rate: Share of the way, in (0, 2); between 1.5 and 1.95 it returns soonest.

        Returns:
            Largest move along an axis in the last sweep [m].

        Raises:
            ValueError: The rate is out of range.
        """
        if not 0.0 < rate < 2.0:
            raise ValueError(f"rate = {rate:g} is out of range; allowed: between 0 and 2")
        largest = 0.0
        for _ in range(sweeps):
            share = self.displacement.dtype.type(rate)
            largest = float(kernels.average(share, self._grid, self.displacement))
        return largest


def _box(spacing: NDArray[np.float64], limits: LinkLimits) -> NDArray[np.float64]:
    """How far w may be below and above zero [m], by axis of the link, component and side."""
    box = np.zeros((AXES, AXES, 2))
    for axis in range(AXES):
        box[axis] = limits.shear[axis]
        box[axis, axis, 0] = spacing[axis] - limits.nearest[axis]
        box[axis, axis, 1] = limits.farthest[axis] - spacing[axis]
    return box


def _refuse(
    size: tuple[int, int, int], spacing: tuple[float, float, float], limits: LinkLimits
) -> None:
    """Refuse a grid that makes no sense.

    Raises:
        ValueError: A size, distance or limit is out of range.
    """
    if len(size) != AXES or min(size) < 1:
        raise ValueError(f"size = {size} is out of range; allowed: three numbers of at least 1")
    for axis in range(AXES):
        nearest, rest, farthest = limits.nearest[axis], spacing[axis], limits.farthest[axis]
        if not (0.0 <= nearest <= rest <= farthest < np.inf and rest > 0.0):
            raise ValueError(
                f"distances {nearest:g}, {rest:g}, {farthest:g} m along axis {axis} are out of "
                "range; allowed: 0 <= nearest <= spacing <= farthest, spacing above 0"
            )
        if not 0.0 <= limits.shear[axis] < np.inf:
            raise ValueError(f"shear = {limits.shear[axis]:g} m is out of range; allowed: from 0")
