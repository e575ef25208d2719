"""Elements turned inside out turn back while released tissue comes to rest."""

from __future__ import annotations

import numpy as np
import pytest

from support.elastic_scenes import block_mesh, build, hold, release, steps
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import signed_volumes


def inverted(mesh: Mesh, u: np.ndarray) -> int:
    rows = mesh.node_rows
    points = mesh.rest[:rows] + u[:rows]
    return int((signed_volumes(points, mesh.tets[: mesh.element_rows]) <= 0).sum())


@pytest.mark.parametrize("name", ["quasi_static", "lr"])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_corner_pushed_through_the_block_comes_back(name: str, seed: int) -> None:
    mesh = block_mesh(7)
    model, state = build(name, mesh)
    points = mesh.rest[: mesh.node_rows]
    corners = [[0, 0, 0.06], [0.06, 0.06, 0.06]]
    corner = int(np.argmin(np.linalg.norm(points - corners[seed], axis=1)))
    hold(model, state, [corner], mesh)
    # Far through the elements at the corner: they are inside out.
    state.displacement[corner] = 1.2 * (points.mean(axis=0) - points[corner]) * [1, 1, 0.3]
    steps(model, state, 200)
    assert inverted(mesh, state.displacement) > 0
    release(model, state, mesh)
    steps(model, state, 1500)
    assert inverted(mesh, state.displacement) == 0
    assert np.abs(state.displacement).max() < 1e-5


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_scrambled_free_nodes_unscramble(share: float) -> None:
    mesh = block_mesh(9)
    model, state = build("lr", mesh)
    random = np.random.default_rng(11)
    rows = np.flatnonzero(~mesh.fixed[: mesh.node_rows])
    some = random.choice(rows, int(share * len(rows)), replace=False)
    state.displacement[some] = random.normal(0, 0.01, (len(some), 3))
    assert inverted(mesh, state.displacement) > 50
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    steps(model, state, 3000)
    assert inverted(mesh, state.displacement) == 0
    assert np.abs(state.displacement).max() < 1e-5
