"""Boundary triangles, normals and connected parts, against trimesh and scipy."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix, csgraph

from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.faces import face_nodes, pair_faces
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block, sphere_shell, wall
from tissue_sim.geometry.surface import boundary_triangles, vertex_normals

SHELL = sphere_shell(subdivisions=2)
BLOCK = block(5, 5, 5)


@pytest.mark.parametrize("raw", [wall(), BLOCK, SHELL], ids=lambda raw: raw.name)
def test_the_boundary_is_closed_and_points_outwards(raw: RawMesh) -> None:
    tets = raw.tetrahedra.astype(np.int32)
    triangles, elements = boundary_triangles(tets, np.ones(len(tets), bool), len(raw.points))
    surface = trimesh.Trimesh(raw.points, triangles, process=False)
    assert surface.is_watertight
    corners = raw.points[tets]
    volumes = np.einsum(
        "ij,ij->i",
        corners[:, 1] - corners[:, 0],
        np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 0]),
    )
    assert surface.volume == pytest.approx(volumes.sum() / 6)
    assert (np.isin(triangles, tets[elements])).all()
    assert (np.diff(elements) >= 0).all()


def test_a_shells_normals_point_away_from_both_its_sides() -> None:
    tets = SHELL.tetrahedra.astype(np.int32)
    triangles, _ = boundary_triangles(tets, np.ones(len(tets), bool), len(SHELL.points))
    normals = np.ones_like(SHELL.points)
    vertex_normals(SHELL.points, triangles, normals)
    radial = SHELL.points / np.linalg.norm(SHELL.points, axis=1, keepdims=True)
    outer, inner = SHELL.node_sets["outer"], SHELL.node_sets["inner"]
    along = np.einsum("ij,ij->i", normals, radial)
    assert (along[outer] > 0.995).all()
    assert (along[inner] < -0.995).all()
    middle = np.setdiff1d(np.arange(len(SHELL.points)), np.concatenate([outer, inner]))
    assert not normals[middle].any()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_boundary_and_parts_of_any_living_elements_equal_an_independent_count(
    seed: int, share: float
) -> None:
    random = np.random.default_rng(seed)
    tets = BLOCK.tetrahedra[random.permutation(len(BLOCK.tetrahedra))].astype(np.int32)
    alive = random.random(len(tets)) < share
    triangles, elements = boundary_triangles(tets, alive, len(BLOCK.points))
    living = np.flatnonzero(alive)
    pairs = pair_faces(tets[living])
    assert np.array_equal(triangles, face_nodes(tets[living], pairs.border))
    assert np.array_equal(elements, living[pairs.border // 4])

    count, labels = connected_components(tets, alive, len(BLOCK.points))
    edges = tets[living][:, [[0, 1], [0, 2], [0, 3]]].reshape(-1, 2)
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(BLOCK.points),) * 2)
    _, expected = csgraph.connected_components(graph, directed=False)
    used = np.zeros(len(BLOCK.points), dtype=bool)
    used[tets[living]] = True
    assert (labels[~used] == -1).all()
    assert count == len(np.unique(expected[used]))
    assert len(set(zip(labels[used].tolist(), expected[used].tolist(), strict=True))) == count
    first = [int(np.flatnonzero(labels == part)[0]) for part in range(count)]
    assert first == sorted(first)
