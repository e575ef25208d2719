"""Isosurface stuffing: good elements, right topology and second-order volume for any shape."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from support.tet_topology import (
    boundary,
    component_count,
    dihedral_angles,
    euler_characteristic,
    is_cut_regular,
    is_manifold,
)
from tissue_sim.geometry.quality import radius_ratios, signed_volumes
from tissue_sim.geometry.stuffing import Implicit, StuffedMesh, stuff

BOX = ([-1.53, -1.51, -1.52], [1.5, 1.5, 1.5])
SMALLEST_ANGLE, LARGEST_ANGLE = 10.7, 164.8


def sphere(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(points, axis=1) - 1.0


def torus(points: NDArray[np.float64]) -> NDArray[np.float64]:
    across = np.hypot(points[:, 0], points[:, 1]) - 1.0
    return np.hypot(across, points[:, 2]) - 0.35


def waves(seed: int, level: float) -> Implicit:
    """A random shape with details down to the lattice's size, inside a ball."""
    random = np.random.default_rng(seed)
    wave_vectors = random.normal(scale=6.0, size=(12, 3))
    phases, sizes = random.uniform(0.0, 6.28, 12), random.normal(size=12)

    def distance(points: NDArray[np.float64]) -> NDArray[np.float64]:
        ripple = (sizes * np.cos(points @ wave_vectors.T + phases)).sum(axis=1)
        return np.maximum(0.05 * (ripple + level), np.linalg.norm(points, axis=1) - 1.3)

    return distance


def noise(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """A shape that the lattice cannot resolve at all: every sign and every cut comes about."""
    hashed = np.sin(points @ np.array([1271.3, 3117.7, 7419.2])) * 43758.5453
    ripple = hashed - np.floor(hashed) - 0.5
    return np.where(np.linalg.norm(points, axis=1) > 1.3, 1.0, ripple)


def assert_valid(mesh: StuffedMesh) -> None:
    points, tets = mesh.points, mesh.tetrahedra
    assert signed_volumes(points, tets).min() > 0.0
    angles = dihedral_angles(points, tets)
    assert angles.min() > SMALLEST_ANGLE
    assert angles.max() < LARGEST_ANGLE
    assert radius_ratios(points, tets).min() > 0.1
    assert is_cut_regular(tets)
    assert is_manifold(boundary(tets))


@pytest.mark.parametrize(
    ("shape", "exact"), [(sphere, 4 * np.pi / 3), (torus, 2 * 0.35**2 * np.pi**2)]
)
def test_volume_converges_with_second_order(shape: Implicit, exact: float) -> None:
    cells = np.array([0.16, 0.08, 0.04])
    errors = []
    for cell in cells:
        mesh = stuff(shape, *BOX, cell)
        errors.append(abs(signed_volumes(mesh.points, mesh.tetrahedra).sum() - exact))
    order = np.polyfit(np.log(cells), np.log(errors), 1)[0]
    assert 1.8 < order < 2.3


@pytest.mark.parametrize(("shape", "characteristic"), [(sphere, 2), (torus, 0)])
def test_closed_forms_have_their_euler_characteristic(shape: Implicit, characteristic: int) -> None:
    mesh = stuff(shape, *BOX, 0.1)
    assert_valid(mesh)
    assert component_count(mesh.tetrahedra) == 1
    assert euler_characteristic(boundary(mesh.tetrahedra)) == characteristic


def test_border_nodes_lie_on_the_surface() -> None:
    mesh = stuff(sphere, *BOX, 0.1)
    border = np.unique(boundary(mesh.tetrahedra))
    assert np.abs(sphere(mesh.points[border])).max() < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_every_shape_gives_good_elements_and_a_manifold(seed: int) -> None:
    assert_valid(stuff(waves(seed, level=0.5), *BOX, 0.1))


def test_even_noise_gives_good_elements_and_a_manifold() -> None:
    mesh = stuff(noise, *BOX, 0.12)
    assert len(mesh.thickened) > 0
    assert_valid(mesh)


def test_a_thin_sheet_is_thickened_where_it_would_pinch_and_moves_less_than_half_a_cell() -> None:
    cell = 0.1

    def sheet(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.abs(np.linalg.norm(points, axis=1) - 1.0) - 0.43 * cell

    mesh = stuff(sheet, *BOX, cell)
    assert len(mesh.thickened) > 0
    assert_valid(mesh)
    assert sheet(mesh.points).max() < 0.5 * cell


def test_a_wall_of_one_and_a_half_cells_has_no_hole() -> None:
    cell = 0.1

    def shell(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.abs(np.linalg.norm(points, axis=1) - 1.0) - 0.75 * cell

    mesh = stuff(shell, *BOX, cell)
    assert_valid(mesh)
    assert euler_characteristic(boundary(mesh.tetrahedra)) == 4  # two closed spheres


def test_the_same_input_gives_the_same_bits() -> None:
    first, second = (stuff(torus, *BOX, 0.13) for _ in range(2))
    assert np.array_equal(first.points, second.points)
    assert np.array_equal(first.tetrahedra, second.tetrahedra)


@pytest.mark.parametrize(
    ("distance", "box", "cell", "message"),
    [
        (sphere, BOX, 0.0, "positive length"),
        (sphere, ([0, 0, 0], [1, 1, 0]), 0.1, "empty"),
        (sphere, ([-1, -1, -1], [1, 1, 1]), 0.1, "border"),
        (lambda points: sphere(points) + 2.0, BOX, 0.1, "no lattice node"),
        (lambda points: sphere(points) * np.nan, BOX, 0.1, "not finite"),
        (lambda points: points, BOX, 0.1, "one number per point"),
    ],
)
def test_bad_input_is_named(
    distance: Implicit, box: tuple[list[float], list[float]], cell: float, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        stuff(distance, *box, cell)
