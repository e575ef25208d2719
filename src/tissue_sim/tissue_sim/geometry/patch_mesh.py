"""From an outline to a flat mesh of triangles, and from that to a sheet of tissue.

Points are spread evenly along the outline and on a hexagonal lattice within it. Their Delaunay
triangulation is that of the patch as soon as it has all sides of the rim; until then those that it
lacks are divided. Where the lattice leaves a gap, long inner edges get a point amid them. Then
inner points are smoothed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from tissue_sim.geometry.outline import (
    OutlineError,
    along_sides,
    distance_from,
    perimeter,
    signed_area,
    spread_along,
    within,
)
from tissue_sim.geometry.sheet import edge_keys, sides

MOST_NODES = 5000
"""Most nodes of a patch, all layers together."""

_CLEAR = 0.62
"""Distance of inner points from the rim, as a share of the edge length."""

_LONG = 1.6
"""Edge lengths from which an inner edge gets a point amid it."""

_FILLINGS = 3
"""How often long inner edges are looked for."""

_DIVISIONS = 24
"""How often missing sides of the rim are divided."""

_SMOOTHINGS = 8


class TooManyNodesError(OutlineError):
    """An outline that is too large for the edge length."""


@dataclass(frozen=True)
class FlatMesh:
    """A flat mesh of triangles.

    Attributes:
        points: Its nodes, those of the rim first and in their order, counterclockwise [m],
            shape (n, 2).
        triangles: Nodes of each triangle, counterclockwise, int32, shape (t, 3).
        rim: Number of nodes of the rim.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int32]
    rim: int

    @property
    def area(self) -> float:
        """Area [m^2]."""
        return float(_double_areas(self.points, self.triangles).sum() / 2.0)

    @property
    def qualities(self) -> NDArray[np.float64]:
        """Twice the inscribed over the circumscribed radius of each triangle, shape (t,)."""
        return _qualities(self.points, self.triangles)


def expected_nodes(outline: NDArray[np.float64], edge: float) -> int:
    """About how many nodes a flat mesh with this edge length [m] will have."""
    # A node for each two triangles of a hexagonal lattice; those of the rim have half of it.
    inner = signed_area(outline) / (np.sqrt(0.75) * edge**2)
    return int(min(inner + perimeter(outline) / (2.0 * edge) + 1.0, 1e15))


def mesh_outline(outline: NDArray[np.float64], edge: float, layers: int = 2) -> FlatMesh:
    """Mesh what an outline encloses.

    Args:
        outline: A checked outline, counterclockwise [m], shape (n, 2).
        edge: Wanted length of edges [m].
        layers: How often the patch will have the nodes of the flat mesh; `MOST_NODES` are allowed.

    Raises:
        OutlineError: The outline is too narrow somewhere for any mesh, or it would have too many
            nodes (`TooManyNodesError`).
    """
    most = MOST_NODES // layers
    _refuse_count(layers * expected_nodes(outline, edge))
    middle = outline.mean(axis=0)
    rim = spread_along(outline - middle, edge)
    inner = _lattice(rim, edge)
    if len(_missing(np.concatenate([rim, inner]), len(rim))):
        # Points that divide its sides shall be on the outline as well.
        rim = along_sides(outline - middle, edge)
        rim, inner = _with_all_sides(rim, _lattice(rim, edge), most)
    points = np.concatenate([rim, inner])
    triangles = _triangles(points, rim)
    if triangles is None:
        raise OutlineError("the outline is too narrow somewhere to be meshed")
    points, triangles = _without_gaps(points, triangles, rim, edge)
    points, triangles = _smoothed(points, triangles, len(rim))
    _refuse_count(layers * len(points))
    return FlatMesh(points + middle, triangles, len(rim))


def _refuse_count(count: int) -> None:
    if count > MOST_NODES:
        raise TooManyNodesError(
            f"the patch would have about {count} nodes; allowed: up to {MOST_NODES}. Choose longer "
            "edges or a smaller outline"
        )


def _lattice(rim: NDArray[np.float64], edge: float) -> NDArray[np.float64]:
    """Points of a hexagonal lattice within a rim and clear of it [m], shape (n, 2)."""
    low, high = rim.min(axis=0), rim.max(axis=0)
    height = np.sqrt(0.75) * edge
    columns, lines = np.ceil((high - low) / [edge, height]).astype(int) + 2
    # Centred, so that a symmetric outline has a symmetric lattice.
    start = (low + high) / 2.0 - [edge * (columns // 2), height * (lines // 2)]
    line, column = np.mgrid[0:lines, 0:columns]
    x = start[0] + edge * (column + 0.5 * (line % 2))
    points = np.stack([x, start[1] + height * line], axis=-1).reshape(-1, 2)
    points = points[within(points, rim)]
    return points[distance_from(points, rim) > _CLEAR * edge]


def _with_all_sides(
    rim: NDArray[np.float64], inner: NDArray[np.float64], most: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A rim divided until the Delaunay triangulation has all its sides, and inner points."""
    # Points at the rim's own corners: sides there are divided at distances that are powers of two,
    # the same on both sides of a sharp corner, so that one does not force the other for ever.
    is_corner = np.ones(len(rim), dtype=np.bool_)
    for _ in range(_DIVISIONS):
        missing = _missing(np.concatenate([rim, inner]), len(rim))
        if not len(missing):
            return rim, inner
        if len(rim) + len(missing) > most:
            break
        ends = rim[missing], rim[(missing + 1) % len(rim)]
        new = _divided(*ends, is_corner[missing], is_corner[(missing + 1) % len(rim)])
        rim = np.insert(rim, missing + 1, new, axis=0)
        is_corner = np.insert(is_corner, missing + 1, False)
        # Inner points that a divided side would make flat triangles with go.
        half = np.linalg.norm(ends[1] - ends[0], axis=1) / 2.0
        gap = np.linalg.norm(inner[:, None] - (ends[0] + ends[1])[None] / 2.0, axis=2)
        inner = inner[(gap > half).all(axis=1)]
    raise OutlineError("the outline is too narrow somewhere to be meshed with this edge length")


def _divided(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    corner_a: NDArray[np.bool_],
    corner_b: NDArray[np.bool_],
) -> NDArray[np.float64]:
    length = np.linalg.norm(b - a, axis=1)
    shell = 2.0 ** np.round(np.log2(length / 2.0)) / length
    share = np.where(corner_a & ~corner_b, shell, np.where(corner_b & ~corner_a, 1 - shell, 0.5))
    return np.asarray(a + share[:, None] * (b - a))


def _delaunay(points: NDArray[np.float64]) -> NDArray[np.int32]:
    """Triangles of points and of a frame far around them, so that no side is on the hull."""
    size = float(np.ptp(points, axis=0).max())
    angle = np.arange(8) * np.pi / 4.0 + 0.1
    frame = points.mean(axis=0) + 8.0 * size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    try:
        found = Delaunay(np.concatenate([points, frame]) / size).simplices
    except QhullError as error:
        raise OutlineError(f"the outline cannot be meshed: {error}") from None
    return np.asarray(found, dtype=np.int32)


def _missing(points: NDArray[np.float64], rim: int) -> NDArray[np.intp]:
    """First nodes of the sides of the rim that the triangulation does not have."""
    first = np.arange(rim)
    wanted = edge_keys(np.stack([first, (first + 1) % rim], axis=1))
    return np.flatnonzero(~np.isin(wanted, edge_keys(sides(_delaunay(points)))))


def _triangles(points: NDArray[np.float64], rim: NDArray[np.float64]) -> NDArray[np.int32] | None:
    """Triangles within the rim, counterclockwise; None if a side of the rim is not among them."""
    found = _delaunay(points)
    found = found[(found < len(points)).all(axis=1)]
    found = found[within(points[found].mean(axis=1), rim)]
    turned = _double_areas(points, found) < 0.0
    found[turned] = found[turned][:, [0, 2, 1]]
    keys, count = np.unique(edge_keys(sides(found)), return_counts=True)
    first = np.arange(len(rim))
    wanted = edge_keys(np.stack([first, (first + 1) % len(rim)], axis=1))
    fits = np.array_equal(keys[count == 1], np.sort(wanted)) and count.max(initial=0) <= 2
    whole = len(np.unique(found)) == len(points)
    flat = _double_areas(points, found).min(initial=1.0) <= 0.0
    return found if fits and whole and not flat else None


def _without_gaps(
    points: NDArray[np.float64],
    triangles: NDArray[np.int32],
    rim: NDArray[np.float64],
    edge: float,
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Points and more of them amid inner edges that are too long, clear of the rim as all are."""
    for _ in range(_FILLINGS):
        _, first, count = np.unique(
            edge_keys(sides(triangles)), return_index=True, return_counts=True
        )
        ends = points[sides(triangles)[first[count == 2]]]
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        longest = np.argsort(-length, kind="stable")
        amid = ends[longest[length[longest] > _LONG * edge]].mean(axis=1)
        amid = amid[distance_from(amid, rim) > _CLEAR * edge]
        filled = points
        for point in amid:
            if np.linalg.norm(filled - point, axis=1).min() > _CLEAR * edge:
                filled = np.concatenate([filled, point[None]])
        if len(filled) == len(points):
            break
        found = _triangles(filled, rim)
        if found is None:
            break
        points, triangles = filled, found
    return points, triangles


def _smoothed(
    points: NDArray[np.float64], triangles: NDArray[np.int32], rim: int
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Inner points amid their neighbours, as long as the worst triangle gets better."""
    best, worst = (points, triangles), float(_qualities(points, triangles).min())
    for _ in range(_SMOOTHINGS if rim < len(points) else 0):
        ends = sides(triangles)
        ends = np.concatenate([ends, ends[:, ::-1]])
        # Inner edges are met from both of their triangles: neighbours count alike.
        weight = np.bincount(ends[:, 0], minlength=len(points))
        moved = points.copy()
        for axis in range(2):
            sums = np.bincount(ends[:, 0], points[ends[:, 1], axis], minlength=len(points))
            moved[rim:, axis] = sums[rim:] / weight[rim:]
        found = _triangles(moved, moved[:rim])
        if found is None:
            break
        points, triangles = moved, found
        quality = float(_qualities(points, triangles).min())
        if quality > worst:
            best, worst = (points, triangles), quality
    return best


def _double_areas(
    points: NDArray[np.float64], triangles: NDArray[np.integer]
) -> NDArray[np.float64]:
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    u, v = b - a, c - a
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def _qualities(points: NDArray[np.float64], triangles: NDArray[np.integer]) -> NDArray[np.float64]:
    corners = points[triangles]
    a, b, c = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).T
    # 2 r / R = 16 S^2 / (a b c (a + b + c)), S the area.
    double = _double_areas(points, triangles)
    return np.asarray(4.0 * double**2 / (a * b * c * (a + b + c)))
