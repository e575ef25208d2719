"""Organs, deformations and sweeps for tests of cuts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cut_service.sweep import Sweep
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import radius_ratios
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block, sphere_shell, wall

SIDE = 0.06
"""Size of the blocks [m]."""


@cache
def raw_organ(name: str) -> RawMesh:
    if name == "wall":
        return wall()
    if name == "shell":
        return sphere_shell(subdivisions=3, layers=2)
    raw = block(7, 6, 8, SIDE, SIDE, SIDE)
    if name == "block":
        return raw
    # A block with its inner nodes shaken: no ties, all kinds of elements.
    random = np.random.default_rng(5)
    lower, upper = raw.points.min(axis=0), raw.points.max(axis=0)
    inner = (raw.points > lower + 1e-9) & (raw.points < upper - 1e-9)
    shake = random.uniform(-0.2, 0.2, raw.points.shape) * SIDE / 7
    return replace(raw, points=raw.points + inner * shake)


def new(name: str, fixed: NDArray[np.bool_] | None = None) -> Mesh:
    return Mesh(raw_organ(name), fixed)


def rest(mesh: Mesh) -> NDArray[np.float64]:
    return mesh.rest[: mesh.node_rows]


def square(
    centre: NDArray[np.float64], normal: NDArray[np.float64], half: float, turn: float = 0.3
) -> Sweep:
    """A flat square about a centre."""
    n = normal / np.linalg.norm(normal)
    u = np.cross(n, [0.3, 0.5, 0.8] if abs(n @ [0.3, 0.5, 0.8]) < 0.95 else [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    v = np.cross(n, u)
    u, v = np.cos(turn) * u + np.sin(turn) * v, np.cos(turn) * v - np.sin(turn) * u
    corners = [centre + half * (i * u + j * v) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return Sweep.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])


def middle(mesh: Mesh) -> NDArray[np.float64]:
    return 0.5 * (rest(mesh).min(axis=0) + rest(mesh).max(axis=0))


def quality(mesh: Mesh) -> NDArray[np.float64]:
    rows = mesh.element_rows
    return radius_ratios(mesh.rest, mesh.tets[:rows][mesh.element_alive[:rows]])


def bent(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """A smooth large deformation."""
    x, y, z = points.T
    return np.stack([x * (1.2 + 5 * z), y + 0.15 * np.sin(40 * x) * z, 1.1 * z + 3 * x * y], axis=1)


def heart(shared_meshes: Path) -> RawMesh:
    """The generated heart of 35,000 nodes."""
    meshio = pytest.importorskip("meshio")
    read = meshio.read(shared_meshes / "generated_heart" / "heart_35k.vtu")
    tets = read.cells_dict["tetra"].astype(np.int64)
    points = np.asarray(read.points, dtype=np.float64) * 1e-3
    a, b, c, d = (points[tets[:, k]] for k in range(4))
    negative = np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) < 0
    tets[negative] = tets[negative][:, [0, 1, 3, 2]]
    return RawMesh(points, tets)
