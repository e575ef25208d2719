"""Tissue that is made of triangles and springs, without tetrahedra."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.errors import MeshError

SURFACE, CONNECTING, BENDING, ANGULAR = range(4)
CATEGORIES = ("surface", "connecting", "bending", "angular")
"""Categories of springs; `surface` are the edges of the triangles."""

LARGEST_FACTOR = 1e6


@dataclass(frozen=True)
class SheetStiffness:
    """What multiplies the stiffness that the material gives each kind of spring.

    Attributes:
        surface: Edges of the triangles.
        connecting: Springs through the tissue to the opposite side.
        bending: Springs across two successive edges.
        angular: Springs between the opposite nodes of two triangles.
        torsion: Torsion springs at the edges between two triangles; 0: there are none.
    """

    surface: float = 1.0
    connecting: float = 1.0
    bending: float = 0.0
    angular: float = 0.0
    torsion: float = 0.0

    def checked(self) -> SheetStiffness:
        """This stiffness, if it is allowed.

        Raises:
            ValueError: A number is out of range.
        """
        for one, value in zip(fields(self), astuple(self), strict=True):
            low = 0.0 if one.name in ("bending", "angular", "torsion") else 1e-6
            if not low <= value <= LARGEST_FACTOR:
                raise ValueError(
                    f"stiffness.{one.name} = {value:g} is out of range; "
                    f"allowed: {low:g} to {LARGEST_FACTOR:g}"
                )
        return self


def _no_walls() -> NDArray[np.int32]:
    return np.empty((0, 3), dtype=np.int32)


@dataclass(frozen=True)
class Sheet:
    """Triangles, and the springs besides those along their edges; all in node rows.

    Attributes:
        triangles: Nodes of each triangle, normals out of the tissue, int32, shape (t, 3).
        thickness: Of the tissue that each triangle stands for [m], shape (t,).
        springs: Ends of the springs besides the triangles' edges, int32, shape (s, 2).
        categories: Category of each of them, an index of `CATEGORIES`, uint8, shape (s,).
        volumes: Volume of tissue whose stiffness each of them has [m^3], shape (s,).
        stiffness: Factors of stiffness by category.
        walls: Nodes of triangles that are shown between the two sides of a cut wall and carry
            nothing, int32, shape (w, 3).
    """

    triangles: NDArray[np.int32]
    thickness: NDArray[np.float64]
    springs: NDArray[np.int32]
    categories: NDArray[np.uint8]
    volumes: NDArray[np.float64]
    stiffness: SheetStiffness = field(default_factory=SheetStiffness)
    walls: NDArray[np.int32] = field(default_factory=_no_walls)

    def count(self, category: int) -> int:
        """Number of springs of a category other than `SURFACE`."""
        return int((self.categories == category).sum())

    def triangle_volumes(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Volume of the tissue that each triangle stands for [m^3], shape (t,)."""
        return triangle_areas(points, self.triangles) * self.thickness

    def node_volumes(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """A third of the volume of the triangles at each node [m^3], shape (len(points),)."""
        return per_node(self.triangles, self.triangle_volumes(points) / 3.0, len(points))


def checked_sheet(sheet: Sheet, points: NDArray[np.float64]) -> Sheet:
    """A sheet that is safe to simulate.

    Args:
        sheet: The sheet.
        points: Node positions at rest [m], shape (n, 3).

    Raises:
        MeshError: It names nodes that are not there, a triangle has no area or thickness, or a
            spring no length.
    """
    for rows, what in (
        (sheet.triangles, "triangle"), (sheet.springs, "spring"), (sheet.walls, "wall"),
    ):  # fmt: skip
        if len(rows) and (rows.min() < 0 or rows.max() >= len(points)):
            raise MeshError(f"a {what} names a node that is not there")
    if not len(sheet.triangles):
        raise MeshError("a surface needs triangles")
    lengths = [len(sheet.categories), len(sheet.volumes), len(sheet.springs)]
    if len(set(lengths)) > 1 or len(sheet.thickness) != len(sheet.triangles):
        raise MeshError("categories, volumes or thicknesses do not fit the springs and triangles")
    volumes = sheet.triangle_volumes(points)
    bad = ~(np.isfinite(volumes) & (volumes > 0.0))
    if bad.any():
        raise MeshError(f"{int(bad.sum())} triangles have no area or no thickness")
    if len(sheet.springs):
        ends = points[sheet.springs]
        if not (np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 0.0).all():
            raise MeshError("a spring joins two nodes at one place")
        if not (np.isfinite(sheet.volumes) & (sheet.volumes > 0.0)).all():
            raise MeshError("a spring has no share of the tissue")
        if sheet.categories.min() < CONNECTING or sheet.categories.max() >= len(CATEGORIES):
            raise MeshError(f"springs are {', '.join(CATEGORIES[1:])}")
    sheet.stiffness.checked()
    return sheet


def triangle_normals(
    points: NDArray[np.float64], triangles: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Normals of triangles, as long as twice their area [m^2], shape (t, 3)."""
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def triangle_areas(
    points: NDArray[np.float64], triangles: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Areas of triangles [m^2], shape (t,)."""
    return np.asarray(0.5 * np.linalg.norm(triangle_normals(points, triangles), axis=1))


def per_node(
    triangles: NDArray[np.integer], values: NDArray[np.float64], nodes: int
) -> NDArray[np.float64]:
    """Sum at each node of the values of the triangles there, shape (nodes,)."""
    sums = np.bincount(triangles.ravel(), weights=np.repeat(values, 3), minlength=nodes)
    return sums.astype(np.float64)


def edge_keys(pairs: NDArray[np.integer]) -> NDArray[np.int64]:
    """One number per unordered pair of nodes, ascending with the lower node first, shape (n,)."""
    low, high = pairs.min(axis=1).astype(np.int64), pairs.max(axis=1).astype(np.int64)
    return np.asarray((low << 32) | high)


def edges_of_keys(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """The pairs of nodes of `edge_keys`, lower node first, shape (n, 2)."""
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1).astype(np.int32)


def sides(triangles: NDArray[np.integer]) -> NDArray[np.integer]:
    """The directed sides of triangles, three of each in turn, shape (3 t, 2)."""
    return triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
