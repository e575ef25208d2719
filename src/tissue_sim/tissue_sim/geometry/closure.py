"""How much of a hole is covered, and what is left open; definitions in docs/closure.md.

A hole is a loop of places on the tissue around it. It is spanned by a disc: over the plane that
the loop encloses most area in, the height of the disc is the mean value interpolation of the
loop's heights, which is smooth, and exact for a plane. The disc is looked at in samples.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from tissue_sim.geometry.closure_kernels import (
    Grid,
    cover,
    fill_disc,
    find_exits,
    height_at,
    nearest_places,
)

Reals = NDArray[np.float64]

SAMPLES = 128
"""Samples along the side of a square as large as the disc."""

MOST_SAMPLES = 400
"""Samples along the longest way across a disc that is long and narrow."""

TURN = 0.3
"""Angle [rad] between the loop's longest extent and the grid: what is straight there is not seen
by a whole row of samples at once."""

FINER = 9
"""Places along each axis, about the best sample, that are tried as the centre of a circle."""

LEAST_ROUNDNESS = 1e-3
"""Least 4 pi area / perimeter^2 of a loop that encloses something: a slit 1 wide and 4000 long."""


FARTHEST = 1e3
"""Largest coordinate of a loop [m]: what is beyond is a mistake, and its area may be no number."""


class LoopError(ValueError):
    """A loop that is not the edge of a hole."""


@dataclass(frozen=True)
class Pieces:
    """Triangles that may cover a hole.

    Attributes:
        corners: Current corners [m], shape (t, 3, 3).
        owners: Patch that each belongs to, shape (t,).
        thickness: Of the patch at each [m], shape (t,).
    """

    corners: Reals = field(default_factory=lambda: np.empty((0, 3, 3)))
    owners: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    thickness: Reals = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class Closure:
    """How far a hole is closed.

    Attributes:
        area: Of the disc [m^2].
        by_patches: Share of it that patches cover.
        by_tissue: Share that lies in tissue and that no patch covers.
        gap: Diameter of the widest circle in what is open, seen along the disc's normal [m].
        gap_at: Its centre [m], shape (3,); not a number where nothing is open.
        edge_gap: Largest distance of a place on the loop from the nearest patch [m]; infinite
            where there is no patch.
        edge_gap_at: That place [m], shape (3,).
        shares: Share that each patch covers which covers any, by its number; what several cover
            counts for the first.
        sampling: Distance of the samples [m]: what narrower than this is may be missed.
        normal: Of the disc's plane, shape (3,).
    """

    area: float
    by_patches: float
    by_tissue: float
    gap: float
    gap_at: Reals
    edge_gap: float
    edge_gap_at: Reals
    shares: dict[int, float]
    sampling: float
    normal: Reals

    @property
    def covered(self) -> float:
        """Share of the disc's area that is closed; 1 where nothing of it is left."""
        return min(1.0, self.by_patches + self.by_tissue)

    @property
    def open_area(self) -> float:
        """What is open [m^2]."""
        return self.area * (1.0 - self.covered)


@dataclass(frozen=True)
class Disc:
    """What a loop spans, in samples.

    Attributes:
        loop: The loop's corners in the disc's coordinates [m], shape (n, 3).
        middle: Origin of those coordinates [m], shape (3,).
        axes: Unit vectors: two in the plane and its normal, about which the loop runs
            counterclockwise, shape (3, 3).
        grid: Which samples the loop winds around, and the disc's heights there.
        areas: Area of the disc that each sample stands for [m^2], 0 outside, shape (nx, ny).
    """

    loop: Reals
    middle: Reals
    axes: Reals
    grid: Grid
    areas: Reals

    def local(self, places: Reals) -> Reals:
        """Places [m] in the disc's coordinates, same shape."""
        return np.ascontiguousarray((places - self.middle) @ self.axes.T)

    def place(self, x: float, y: float) -> Reals:
        """Where the disc is over a place of its plane [m], shape (3,)."""
        return self.middle + np.array([x, y, height_at(self.loop, x, y)]) @ self.axes


def checked_loop(loop: Reals) -> Reals:
    """A loop that is the edge of a hole; corners that repeat the one before are left out.

    Args:
        loop: Places [m], in turn; the last joins the first, shape (n, 3).

    Raises:
        LoopError: It is not finite, is beyond `FARTHEST`, has fewer than three places, encloses
            next to nothing, or crosses itself as seen along its normal.
    """
    loop = np.asarray(loop, dtype=np.float64).reshape(-1, 3)
    if not np.isfinite(loop).all():
        raise LoopError("a position of the loop is not finite")
    if (farthest := float(np.abs(loop).max(initial=0.0))) > FARTHEST:
        raise LoopError(
            f"a coordinate of the loop is {farthest:.3g} m; allowed: up to {FARTHEST:g} m"
        )
    loop = without_repeats(loop)
    if len(loop) < 3:
        raise LoopError(f"the loop has {len(loop)} different positions; allowed: at least 3")
    normal = area_vector(loop)
    area, way = float(np.linalg.norm(normal)), float(perimeter(loop))
    if 4.0 * np.pi * area < LEAST_ROUNDNESS * way * way:
        raise LoopError("the loop encloses no area: it runs there and back, or crosses itself")
    if crosses_itself((loop - loop.mean(axis=0)) @ _axes(loop).T):
        raise LoopError("the loop crosses itself, seen along its normal")
    return loop


def without_repeats(loop: Reals) -> Reals:
    """The corners that differ from the one before, shape (m, 3)."""
    return np.asarray(loop[(loop != np.roll(loop, 1, axis=0)).any(axis=1)])


def area_vector(loop: Reals) -> Reals:
    """Vector whose part along any direction is the area enclosed as seen from there [m^2]."""
    from_middle = loop - loop.mean(axis=0)
    return np.asarray(0.5 * np.cross(from_middle, np.roll(from_middle, -1, axis=0)).sum(axis=0))


def perimeter(loop: Reals) -> float:
    """Length of a closed loop [m]."""
    return float(np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1).sum())


def crosses_itself(flat: Reals) -> bool:
    """Whether sides of a closed line in the plane that are no neighbours touch, (n, 2 or more)."""
    a = flat[:, :2]
    b = np.roll(a, -1, axis=0)

    def turns(u: Reals, v: Reals, w: Reals) -> Reals:
        along, to = v - u, w - u
        return np.asarray(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0])

    one, other = (a[:, None], b[:, None]), (a[None], b[None])
    apart = turns(*one, other[0]) * turns(*one, other[1]) <= 0.0
    apart &= turns(*other, one[0]) * turns(*other, one[1]) <= 0.0
    # Sides in one line have no turn at all; they touch where they overlap.
    apart &= (np.maximum(one[0], one[1]) >= np.minimum(*other)).all(axis=2)
    apart &= (np.maximum(*other) >= np.minimum(one[0], one[1])).all(axis=2)
    rows = np.arange(len(a))
    ways = (rows[:, None] - rows) % len(a)
    return bool((apart & (ways > 1) & (ways < len(a) - 1)).any())


def disc_of(loop: Reals) -> Disc:
    """Span a loop.

    Args:
        loop: Places [m], in turn, shape (n, 3). Where lips have passed each other and the loop
            winds around something the other way, nothing is open.
    """
    loop = np.asarray(loop, dtype=np.float64)
    middle, axes = loop.mean(axis=0), _axes(loop)
    local = np.ascontiguousarray((loop - middle) @ axes.T)
    low, high = local[:, :2].min(axis=0), local[:, :2].max(axis=0)
    area, span = float(np.linalg.norm(area_vector(loop))), float((high - low).max())
    spacing = max(np.sqrt(area) / SAMPLES, span / MOST_SAMPLES, 1e-9)
    counts = np.maximum(np.ceil((high - low) / spacing).astype(np.int64), 1)
    # Samples lie evenly about the middle, so that turning a loop around changes nothing.
    origin = 0.5 * (low + high) - 0.5 * spacing * counts
    inside = np.zeros(tuple(counts), dtype=np.bool_)
    grid = Grid(origin, float(spacing), inside, np.zeros(tuple(counts)))
    fill_disc(local, grid)
    areas = np.where(inside, spacing**2 * _slopes(grid), 0.0)
    return Disc(local, middle, axes, grid, areas)


def measure(loop: Reals, depth: float, pieces: Pieces, tissue: Reals) -> Closure:
    """Find out how far a hole is closed.

    Args:
        loop: Its edge now [m], shape (n, 3).
        depth: How far over or under the disc a patch still covers it [m].
        pieces: Surface of the patches.
        tissue: Surface of everything else, normals outward [m], shape (t, 3, 3).
    """
    disc = disc_of(loop)
    covered = _covered(disc, depth, pieces)
    total = float(disc.areas.sum())
    in_tissue = _in_tissue(disc, tissue) & (covered == 0)
    shares = {
        int(owner): min(1.0, float(disc.areas[covered == owner].sum()) / total)
        for owner in np.unique(covered[covered > 0])
    }
    by_tissue = float(disc.areas[in_tissue].sum()) / total if total else 1.0
    by_patches = min(1.0, sum(shares.values()))
    gap, gap_at = _widest(disc, disc.grid.inside & (covered == 0) & ~in_tissue)
    edge_gap, edge_gap_at = _farthest_of_edge(loop, disc.grid.spacing, pieces.corners)
    return Closure(
        total, by_patches, by_tissue, gap, gap_at, edge_gap, edge_gap_at, shares,
        disc.grid.spacing, disc.axes[2],
    )  # fmt: skip


def _axes(loop: Reals) -> Reals:
    """Two axes in the loop's plane, turned against its longest extent, and the normal, (3, 3)."""
    normal = area_vector(loop)
    from_middle = loop - loop.mean(axis=0)
    directions = np.linalg.svd(from_middle, full_matrices=True)[2]
    length = float(np.linalg.norm(normal))
    if length <= 1e-12 * max(float((from_middle**2).sum()), 1e-300):
        normal, length = directions[2], 1.0
    normal = normal / length
    longest = directions[0] - normal * (directions[0] @ normal)
    if np.linalg.norm(longest) < 1e-6:
        longest = directions[1] - normal * (directions[1] @ normal)
    longest /= np.linalg.norm(longest)
    across = np.cross(normal, longest)
    first = np.cos(TURN) * longest + np.sin(TURN) * across
    return np.array([first, np.cross(normal, first), normal])


def _slopes(grid: Grid) -> Reals:
    """Area of the disc over the area of the plane at each sample."""
    _, spacing, inside, heights = grid
    square = np.ones(heights.shape)
    for axis in (0, 1):
        if heights.shape[axis] < 2:
            continue
        step = np.diff(heights, axis=axis) / spacing
        both = np.logical_and(*(np.delete(inside, end, axis=axis) for end in (0, -1)))
        total, count = np.zeros(heights.shape), np.zeros(heights.shape)
        for side in (slice(None, -1), slice(1, None)):
            at = (side, slice(None)) if axis == 0 else (slice(None), side)
            total[at] += np.where(both, step, 0.0)
            count[at] += both
        square += (total / np.maximum(count, 1)) ** 2
    return np.sqrt(square)


def _covered(disc: Disc, depth: float, pieces: Pieces) -> NDArray[np.int32]:
    covered = np.zeros(disc.areas.shape, dtype=np.int32)
    margins = 0.5 * pieces.thickness
    cover(disc.local(pieces.corners), pieces.owners, margins, depth, disc.grid, covered)
    return covered


def _in_tissue(disc: Disc, tissue: Reals) -> NDArray[np.bool_]:
    """Samples that lie in tissue: it ends above them and below."""
    above, below = np.empty(disc.areas.shape), np.empty(disc.areas.shape)
    find_exits(disc.local(tissue), disc.grid, above, below)
    return (
        disc.grid.inside & np.isfinite(above) & np.isfinite(below) & (above > 0.0) & (below > 0.0)
    )


def _widest(disc: Disc, is_open: NDArray[np.bool_]) -> tuple[float, Reals]:
    """Diameter of the largest circle in what is open, and its centre."""
    if not is_open.any():
        return 0.0, np.full(3, np.nan)
    spacing = disc.grid.spacing
    away = distance_transform_edt(np.pad(is_open, 1))[1:-1, 1:-1]
    i, j = np.unravel_index(int(np.argmax(away)), away.shape)
    # The best centre lies between samples.
    steps = np.linspace(-1.0, 1.0, FINER)
    middle = np.array([i, j]) + 0.5
    centres = middle + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    flat = disc.grid.origin + spacing * centres
    radii = _to_line(flat, disc.loop[:, :2])
    closed = np.argwhere(disc.grid.inside & ~is_open) + 0.5
    if len(closed):
        # The border of what is closed runs between two samples, on average half way.
        nearest, _ = cKDTree(closed).query(centres)
        radii = np.minimum(radii, (nearest - 0.5) * spacing)
    best = int(np.argmax(radii))
    x, y = flat[best].tolist()
    return 2.0 * float(max(radii[best], 0.0)), disc.place(x, y)


def _to_line(places: Reals, loop: Reals) -> Reals:
    """Distances of places from a closed line, both in the plane [m], shape (k,)."""
    sides = np.roll(loop, -1, axis=0) - loop
    squares = np.maximum(np.einsum("ij,ij->i", sides, sides), 1e-300)
    to = places[:, None] - loop
    along = np.clip(np.einsum("kij,ij->ki", to, sides) / squares, 0.0, 1.0)
    return np.asarray(np.linalg.norm(to - along[:, :, None] * sides, axis=2).min(axis=1))


def _farthest_of_edge(loop: Reals, spacing: float, patches: Reals) -> tuple[float, Reals]:
    """Largest distance of the loop from the patches, and where that is."""
    if not len(patches):
        return np.inf, np.full(3, np.nan)
    sides = np.roll(loop, -1, axis=0) - loop
    lengths = np.linalg.norm(sides, axis=1)
    step = max(2.0 * spacing, float(lengths.sum()) / 400)
    counts = np.maximum(np.ceil(lengths / step).astype(np.int64), 1)
    rows = np.repeat(np.arange(len(loop)), counts)
    shares = np.concatenate([np.arange(count) / count for count in counts])
    places = np.ascontiguousarray(loop[rows] + shares[:, None] * sides[rows])
    distances, nearest = np.empty(len(places)), np.empty(len(places), dtype=np.int64)
    nearest_places(patches, places, distances, nearest, np.empty((len(places), 3)))
    worst = int(np.argmax(distances))
    return float(distances[worst]), places[worst]
