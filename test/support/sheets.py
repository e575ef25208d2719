"""Small sheets of tissue, and the energy of torsion springs in plain numpy."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sheet import SheetStiffness
from tissue_sim.geometry.sheet_geometry import CONNECTED, SURFACE, SheetSettings, with_sheet

EVERYTHING = SheetStiffness(bending=1.0, angular=1.0, torsion=1.0)
WITH_TORSION = SheetStiffness(torsion=1.0)


def lattice(columns: int, rows: int, edge: float = 0.002) -> RawMesh:
    """Equilateral triangles in the plane z = 0, in a parallelogram."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(columns), np.arange(rows)))
    points = edge * np.stack([i + 0.5 * j, np.sqrt(0.75) * j, 0.0 * i], axis=1)
    at = (i + columns * j).reshape(rows, columns)
    a, b = at[:-1, :-1].ravel(), at[:-1, 1:].ravel()
    c, d = at[1:, :-1].ravel(), at[1:, 1:].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    return RawMesh(points, triangles=triangles, name="lattice")


def strip(columns: int, rows: int, edge: float = 0.002) -> RawMesh:
    """Equilateral triangles in a rectangle whose short sides are ragged by half an edge."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(columns), np.arange(rows)))
    points = edge * np.stack([i + 0.5 * (j % 2), np.sqrt(0.75) * j, 0.0 * i], axis=1)
    triangles: list[tuple[int, int, int]] = []
    for row in range(rows - 1):
        for a in range(columns * row, columns * row + columns - 1):
            b, c, d = a + 1, a + columns, a + columns + 1
            triangles += [(a, b, c), (b, d, c)] if row % 2 == 0 else [(a, b, d), (a, d, c)]
    return RawMesh(points, triangles=np.array(triangles), name="strip")


def ball(radius: float = 0.02, subdivisions: int = 2) -> RawMesh:
    """A sphere of 42, 162, 642, ... nodes."""
    shape = trimesh.creation.icosphere(subdivisions, radius)
    return RawMesh(
        np.asarray(shape.vertices), triangles=np.asarray(shape.faces, np.int64), name="ball"
    )


def shell(inner: float = 0.016, outer: float = 0.02, subdivisions: int = 2) -> RawMesh:
    """Two concentric spheres around a spherical wall, normals out of it."""
    outside, inside = ball(outer, subdivisions), ball(inner, subdivisions)
    turned = inside.triangles[:, ::-1] + len(outside.points)
    return RawMesh(
        np.concatenate([outside.points, inside.points]),
        triangles=np.concatenate([outside.triangles, turned]),
        name="shell",
    )


def sheet_mesh(
    raw: RawMesh,
    stiffness: SheetStiffness = WITH_TORSION,
    kind: str = SURFACE,
    thickness: float = 0.0,
    fixed: NDArray[np.bool_] | None = None,
) -> Mesh:
    return Mesh(with_sheet(raw, SheetSettings(kind, thickness, stiffness), []), fixed)


def connected(stiffness: SheetStiffness | None = None, fixed: bool = False) -> Mesh:
    """A spherical wall of connected surfaces, fixed at its bottom or not at all."""
    raw = shell()
    low = raw.points[:, 2] < -0.012
    return sheet_mesh(
        raw, stiffness or SheetStiffness(), CONNECTED, fixed=low if fixed else np.zeros_like(low)
    )


def fold_angles(x: NDArray[np.float64], nodes: NDArray[np.int32]) -> NDArray[np.float64]:
    """Angles between the triangles at edges [rad], positive where they fold towards the normals."""
    a, b, c, d = (x[nodes[:, k]] for k in range(4))
    n, m = np.cross(b - a, c - a), np.cross(d - a, b - a)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    sine = np.einsum("ij,ij->i", np.cross(n, m), along)
    return np.arctan2(sine, np.einsum("ij,ij->i", n, m))


def torsion_energy(springs: SpringNetwork, u: NDArray[np.float64]) -> float:
    """Energy of the torsion springs [J]."""
    torsion, rest = springs.torsion, springs.mesh.rest
    assert torsion is not None
    change = fold_angles(rest + u, torsion.nodes) - fold_angles(rest, torsion.nodes)
    return float(0.5 * (torsion.stiffness * change**2).sum())
