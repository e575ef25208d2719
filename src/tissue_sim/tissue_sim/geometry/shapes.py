"""Generated shapes: wall, block and sphere shell."""

from __future__ import annotations

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.geometry.raw_mesh import RawMesh

LARGEST = 2_000_000
"""Most nodes a generated shape may have."""


def _grid(counts: tuple[int, int, int], sizes: tuple[float, float, float], name: str) -> RawMesh:
    """A box of nodes with six tetrahedra per cell, all around the cells' main diagonals (Kuhn)."""
    if min(counts) < 2 or np.prod(counts, dtype=np.float64) > LARGEST:
        raise ValueError(
            f"{name}: {' x '.join(map(str, counts))} nodes; allowed: at least 2 along each "
            f"axis, {LARGEST} in all"
        )
    if not all(np.isfinite(s) and s > 0 for s in sizes):
        raise ValueError(f"{name}: sizes {sizes} must be positive lengths in metres")
    axes = [np.linspace(0.0, s, n) for s, n in zip(sizes, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    row = np.arange(len(points)).reshape(counts)
    cells = row[:-1, :-1, :-1].ravel()
    step = np.array([counts[1] * counts[2], counts[2], 1])
    paths = []
    for order in permutations(range(3)):
        corners = np.concatenate([[0], np.cumsum(step[list(order)])])
        paths.append(cells[:, None] + corners)
    tetrahedra = np.stack(paths, axis=1).reshape(-1, 4)
    return RawMesh(points=points, tetrahedra=_oriented(points, tetrahedra), name=name, source=name)


def _oriented(points: NDArray[np.float64], tetrahedra: NDArray[np.int64]) -> NDArray[np.int64]:
    negative = signed_volumes(points, tetrahedra) < 0
    return np.where(negative[:, None], tetrahedra[:, [0, 1, 3, 2]], tetrahedra)


def wall(
    columns: int = 17,
    rows: int = 26,
    layers: int = 2,
    width: float = 0.064,
    height: float = 0.1,
    thickness: float = 0.004,
) -> RawMesh:
    """The thesis' wall: 17 x 26 x 2 nodes, fixed on three of its four narrow sides.

    Six tetrahedra per cell give 884 nodes and 2,400 tetrahedra, close to the 884 and 2,408 of the
    thesis, whose mesh is lost. The wall lies in the plane of x (width) and y (height); the side of
    greatest y is free.

    Args:
        columns: Nodes along x.
        rows: Nodes along y.
        layers: Nodes along z.
        width: Size along x [m].
        height: Size along y [m].
        thickness: Size along z [m].

    Returns:
        The wall, with node sets `fixed` (three sides), `free_side`, and `hold` (the middle third of
        the free side).
    """
    raw = _grid((columns, rows, layers), (width, height, thickness), "wall")
    x, y = raw.points[:, 0], raw.points[:, 1]
    near = 1e-9 * max(width, height)
    fixed = (x <= near) | (x >= width - near) | (y <= near)
    free = (y >= height - near) & ~fixed
    raw.node_sets["fixed"] = np.flatnonzero(fixed)
    raw.node_sets["free_side"] = np.flatnonzero(free)
    raw.node_sets["hold"] = np.flatnonzero(free & (np.abs(x - 0.5 * width) <= width / 6 + near))
    return raw


def block(
    nodes_x: int = 13,
    nodes_y: int = 13,
    nodes_z: int = 13,
    size_x: float = 0.06,
    size_y: float = 0.06,
    size_z: float = 0.06,
) -> RawMesh:
    """A box with its bottom fixed.

    Args:
        nodes_x: Nodes along x.
        nodes_y: Nodes along y.
        nodes_z: Nodes along z.
        size_x: Size along x [m].
        size_y: Size along y [m].
        size_z: Size along z [m].

    Returns:
        The block, with node sets `fixed` (z = 0) and `top`.
    """
    raw = _grid((nodes_x, nodes_y, nodes_z), (size_x, size_y, size_z), "block")
    z = raw.points[:, 2]
    raw.node_sets["fixed"] = np.flatnonzero(z <= 1e-9 * size_z)
    raw.node_sets["top"] = np.flatnonzero(z >= size_z * (1 - 1e-9))
    return raw


def sphere_shell(
    radius: float = 0.03, thickness: float = 0.004, subdivisions: int = 4, layers: int = 3
) -> RawMesh:
    """A hollow ball, fixed at its lowest tenth.

    Args:
        radius: Outer radius [m].
        thickness: Thickness of the wall [m].
        subdivisions: How often the icosahedron's triangles are quartered, 1 to 7.
        layers: Layers of nodes through the wall, at least 2.

    Returns:
        The shell, with node sets `fixed`, `outer` and `inner`.
    """
    if not 1 <= subdivisions <= 7:
        raise ValueError(f"sphere_shell: subdivisions = {subdivisions}; allowed: 1 to 7")
    if layers < 2 or layers * (10 * 4**subdivisions + 2) > LARGEST:
        raise ValueError(
            f"sphere_shell: layers = {layers}; allowed: from 2, {LARGEST} nodes in all"
        )
    if not 0 < thickness < radius < np.inf:
        raise ValueError(
            f"sphere_shell: radius {radius} m and thickness {thickness} m; "
            "the thickness must be positive and below the radius"
        )
    directions, triangles = _icosphere(subdivisions)
    count = len(directions)
    radii = np.linspace(radius - thickness, radius, layers)
    points = (radii[:, None, None] * directions).reshape(-1, 3)
    # Corners sorted by row: neighbouring prisms then choose the same diagonal on their common side.
    a, b, c = np.sort(triangles, axis=1).T
    prisms = np.concatenate([np.stack([a, b, c, c + count], axis=1),
                             np.stack([a, b, b + count, c + count], axis=1),
                             np.stack([a, a + count, b + count, c + count], axis=1)])  # fmt: skip
    tetrahedra = np.concatenate([prisms + layer * count for layer in range(layers - 1)])
    return RawMesh(
        points=points,
        tetrahedra=_oriented(points, tetrahedra),
        node_sets={
            "fixed": np.flatnonzero(points[:, 2] <= -0.8 * radius),
            "inner": np.arange(count),
            "outer": np.arange((layers - 1) * count, layers * count),
        },
        name="sphere_shell",
        source="sphere_shell",
    )


def _icosphere(subdivisions: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Unit directions and triangles of an icosahedron whose triangles are quartered repeatedly."""
    golden = (1 + 5**0.5) / 2
    points = np.array([[s, t * golden, 0] for s in (-1, 1) for t in (-1, 1)])
    points = np.concatenate([points, np.roll(points, 1, axis=1), np.roll(points, 2, axis=1)])
    # Neighbouring corners of this icosahedron are two apart.
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    near = np.isclose(distance, 2.0)
    triangles = np.array([
        (i, j, k)
        for i in range(12) for j in range(i + 1, 12) for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ])  # fmt: skip
    points /= np.linalg.norm(points[0])
    for _ in range(subdivisions):
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        middles = points[unique].mean(axis=1)
        middles /= np.linalg.norm(middles, axis=1, keepdims=True)
        ab, bc, ca = (inverse.reshape(-1, 3) + len(points)).T
        a, b, c = triangles.T
        points = np.concatenate([points, middles])
        triangles = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
        )
    return points, triangles
