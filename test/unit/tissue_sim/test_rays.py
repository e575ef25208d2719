"""Rays against surfaces: closed forms, and an independent library."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.rays import crossings
from tissue_sim.geometry.shapes import block, sphere_shell
from tissue_sim.geometry.surface import surface_triangles


def surface(raw: object) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    mesh = Mesh(raw)  # type: ignore[arg-type]
    return mesh.rest[: mesh.node_rows].copy(), surface_triangles(mesh)


def test_a_ray_through_a_block_comes_in_and_goes_out() -> None:
    points, triangles = surface(block(5, 5, 5))
    direction = np.array([0.1, 0.2, -1.0]) / np.sqrt(1.05)
    eye = np.array([0.022, 0.015, 0.1])
    found = crossings(points, triangles, eye, direction)
    np.testing.assert_allclose(found.distance, np.array([0.04, 0.1]) * np.sqrt(1.05))
    assert found.leaving.tolist() == [False, True]
    corners = points[triangles[found.triangle]]
    np.testing.assert_allclose(corners[0, :, 2], 0.06)
    np.testing.assert_allclose(corners[1, :, 2], 0.0, atol=1e-12)
    assert len(crossings(points, triangles, eye, -direction).distance) == 0


@pytest.mark.parametrize("at", [(0.0, 0.0), (0.015, 0.03), (0.0075, 0.0075), (0.06, 0.06)])
def test_a_ray_through_a_node_or_an_edge_does_not_slip_through(at: tuple[float, float]) -> None:
    points, triangles = surface(block(5, 5, 5))
    found = crossings(points, triangles, np.array([*at, 0.1]), np.array([0.0, 0.0, -1.0]))
    assert set(np.round(found.distance, 9)) == {0.04, 0.1}
    for distance, leaving in ((0.04, False), (0.1, True)):
        assert (found.leaving[np.isclose(found.distance, distance)] == leaving).all()


def test_rays_agree_with_trimesh() -> None:
    trimesh = pytest.importorskip("trimesh")
    points, triangles = surface(sphere_shell(subdivisions=3, layers=2))
    shape = trimesh.Trimesh(points, triangles, process=False, validate=False)
    plain = trimesh.ray.ray_triangle.RayMeshIntersector(shape)
    random = np.random.default_rng(3)
    size = np.ptp(points, axis=0).max()
    for _ in range(20):
        eye = points.mean(axis=0) + size * random.normal(size=3)
        direction = points.mean(axis=0) + 0.2 * size * random.normal(size=3) - eye
        direction /= np.linalg.norm(direction)
        found = crossings(points.astype(np.float32), triangles, eye, direction)
        places, _, rows = plain.intersects_location([eye], [direction])
        far = np.sort(np.linalg.norm(places - eye, axis=1))
        np.testing.assert_allclose(found.distance, far, rtol=1e-6)
        assert set(found.triangle) == set(rows)
        assert found.leaving.sum() * 2 == len(found.leaving)
