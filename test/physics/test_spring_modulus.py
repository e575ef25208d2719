"""What the guess of a spring's stiffness from Young's modulus is worth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay

from support.elastic_scenes import MATERIAL, build
from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block

SIZE = np.array([0.06, 0.02, 0.02])
STRAIN = 1e-4
E = MATERIAL.young_modulus


def grid_bar(inner: float = 0.0) -> Mesh:
    """A bar of a regular grid, its inner nodes moved at random by a share of the spacing."""
    raw = block(13, 5, 5, *SIZE)
    points = raw.points.copy()
    within = ((points > 1e-9) & (points < SIZE - 1e-9)).all(axis=1)
    random = np.random.default_rng(0)
    points[within] += random.uniform(-inner, inner, (int(within.sum()), 3)) * 0.005
    return Mesh(RawMesh(points, raw.tetrahedra), np.zeros(len(points), dtype=np.bool_))


def irregular_bar() -> Mesh:
    """A bar filled with Delaunay's tetrahedra of scattered points, by SciPy."""
    sides = [np.linspace(0.0, size, round(size / 0.005) + 1) for size in SIZE]
    points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    free = (points > 1e-9) & (points < SIZE - 1e-9)
    points[free] += np.random.default_rng(1).uniform(-0.35, 0.35, int(free.sum())) * 0.005
    tets = Delaunay(points).simplices
    a, b, c = (points[tets[:, k]] - points[tets[:, 0]] for k in (1, 2, 3))
    volume = np.einsum("ij,ij->i", np.cross(a, b), c) / 6.0
    tets[volume < 0] = tets[volume < 0][:, [1, 0, 2, 3]]
    tets = tets[np.abs(volume) > 1e-3 * 0.005**3]
    return Mesh(RawMesh(points, tets.astype(np.int64)), np.zeros(len(points), dtype=np.bool_))


def stretched(mesh: Mesh, springs: SpringNetwork) -> tuple[NDArray[np.float64], float, float]:
    """Displacements of a bar stretched along x, free across; modulus and Poisson's ratio."""
    rows, count = mesh.node_rows, springs.rows
    ends, k = springs.springs.ends[:count], springs.springs.stiffness[:count]
    points = mesh.rest[:rows]
    along = points[ends[:, 1]] - points[ends[:, 0]]
    along /= np.linalg.norm(along, axis=1)[:, None]
    blocks = k[:, None, None] * along[:, :, None] * along[:, None, :]
    axes = np.arange(3)
    parts = [(a, b, 1.0 if a == b else -1.0) for a in (0, 1) for b in (0, 1)]
    i = [
        np.broadcast_to(3 * ends[:, a, None, None] + axes[:, None], blocks.shape)
        for a, _, _ in parts
    ]
    j = [np.broadcast_to(3 * ends[:, b, None, None] + axes, blocks.shape) for _, b, _ in parts]
    values = np.concatenate([sign * blocks.ravel() for _, _, sign in parts])
    where = (np.concatenate([x.ravel() for x in i]), np.concatenate([x.ravel() for x in j]))
    matrix = coo_array((values, where), shape=(3 * rows, 3 * rows)).tocsr()
    left, right = points[:, 0] < 1e-9, points[:, 0] > SIZE[0] - 1e-9
    u, given = np.zeros((rows, 3)), np.zeros((rows, 3), dtype=np.bool_)
    given[left | right, 0] = True
    u[right, 0] = STRAIN * SIZE[0]
    # One end does not slide or turn as a whole.
    corner = np.linalg.norm(points, axis=1).argmin()
    beside = np.linalg.norm(points - [0.0, SIZE[1], 0.0], axis=1).argmin()
    given[corner, 1:], given[beside, 2] = True, True
    known, flat = given.ravel(), u.ravel()
    flat[~known] = spsolve(matrix[~known][:, ~known], -matrix[~known][:, known] @ flat[known])
    u = flat.reshape(rows, 3)
    force = (matrix @ flat).reshape(rows, 3)[right, 0].sum()
    middle = np.abs(points[:, 0] - SIZE[0] / 2) < SIZE[0] / 4
    fit = np.linalg.lstsq(np.c_[points[middle], np.ones(middle.sum())], u[middle], rcond=None)[0]
    ratio = -(fit[1, 1] + fit[2, 2]) / 2 / STRAIN
    return u, float(force / (SIZE[1] * SIZE[2]) / STRAIN), float(ratio)


@pytest.mark.parametrize(
    ("mesh", "ratio"),
    [
        pytest.param(grid_bar(), (0.0, 0.1), id="grid"),
        pytest.param(grid_bar(0.15), (0.0, 0.1), id="scattered grid"),
        pytest.param(irregular_bar(), (0.15, 0.3), id="irregular"),
    ],
)
def test_a_bar_of_springs_has_the_modulus_within_a_tenth(
    mesh: Mesh, ratio: tuple[float, float]
) -> None:
    springs = SpringNetwork(mesh, MATERIAL, np.float64)
    u, modulus, poisson = stretched(mesh, springs)
    assert abs(modulus / E - 1.0) < 0.1
    # Along the edges of a grid springs across do not follow; an irregular mesh is nearer to 1/4.
    assert ratio[0] < poisson < ratio[1]
    # The models' own forces are those of the springs so stretched.
    model, _ = build("quasi_static", mesh, springs)
    state = State(mesh, np.float64)
    state.displacement[: mesh.node_rows] = u
    right = np.flatnonzero(mesh.rest[: mesh.node_rows, 0] > SIZE[0] - 1e-9).astype(np.int32)
    pull = -model.forces(state, right)[:, 0].sum() / (SIZE[1] * SIZE[2]) / STRAIN
    assert abs(pull / modulus - 1.0) < 1e-3


def test_a_regular_tetrahedron_s_springs_are_within_a_twentieth_of_those_of_lloyd() -> None:
    length = 0.01
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=np.float64)
    corners *= length / np.sqrt(8.0)
    mesh = Mesh(RawMesh(corners[[0, 2, 1, 3]], np.array([[0, 1, 2, 3]])))
    springs = SpringNetwork(mesh, MATERIAL, np.float64)
    stiffness = springs.springs.stiffness[: springs.rows]
    assert len(stiffness) == 6
    np.testing.assert_allclose(stiffness, E * length / (6.0 * np.sqrt(2.0)), rtol=1e-12)
    np.testing.assert_allclose(2.0 * np.sqrt(2.0) / 25.0 * E * length / stiffness, 0.96)


def test_all_springs_together_resist_as_much_on_every_mesh() -> None:
    for mesh in (grid_bar(), irregular_bar()):
        springs = SpringNetwork(mesh, MATERIAL, np.float64)
        rows = springs.springs
        total = (rows.stiffness * rows.length**2)[: springs.rows].sum()
        np.testing.assert_allclose(total, 6.0 * E * SIZE.prod(), rtol=1e-6)
