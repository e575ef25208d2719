"""Relaxation reaches its limits."""

from __future__ import annotations

import numpy as np
import pytest

from support.elastic_scenes import (
    MATERIAL,
    block_mesh,
    build,
    double,
    hold,
    steps,
    top_ball,
)
from tissue_sim.elastic.relaxation import Relaxation
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.kernels.relaxation import REMOVED_LENGTH

LENGTH = 0.01


def single_spring(limit: float, u: float, held: list[int], full: int = 0) -> float:
    """Length of a spring after one pass; the other nodes of its tetrahedron go with it."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 0.5, 1]]) * LENGTH
    mesh = Mesh(RawMesh(points, np.array([[0, 1, 2, 3]])))
    springs, state = double(mesh)
    model = Relaxation(
        mesh, MATERIAL, {"linear_factor": limit, "full_excess": float(full)}, springs
    )
    hold(model, state, held, mesh)
    order = model.relaxation.order
    order.advance()
    for k in range(order.used):
        if {order.list.first[k], order.list.second[k]} != {0, 1}:
            order.list.length[k] = REMOVED_LENGTH
    state.displacement[1, 0] = u
    model.step(state)
    x = mesh.rest + state.displacement
    return float(np.linalg.norm(x[1] - x[0]))


@pytest.mark.parametrize("held", [[2, 3], [0], [1]])
@pytest.mark.parametrize(("u", "limit"), [(0.004, 1.1), (-0.005, 0.9), (0.0005, 1.05)])
def test_a_single_spring_is_put_at_its_limit(u: float, limit: float, held: list[int]) -> None:
    assert single_spring(0.1, u, held) == pytest.approx(LENGTH * limit, rel=1e-12)


def test_the_full_excess_variant_overshoots_by_the_excess() -> None:
    stretched, limit = LENGTH * 1.4, LENGTH * 1.1
    expected = stretched - 2 * (stretched - limit)
    assert single_spring(0.1, 0.4 * LENGTH, [2, 3], full=1) == pytest.approx(expected, rel=1e-12)


def test_both_ends_of_a_free_spring_move_alike() -> None:
    mesh = block_mesh(5, fixed=False)
    model, state = build("relaxation", mesh)
    random = np.random.default_rng(2)
    rows = mesh.node_rows
    state.displacement[:rows] = random.normal(0, 1e-3, (rows, 3))
    before = state.displacement[:rows].mean(axis=0, dtype=np.float64)
    steps(model, state, 50)
    after = state.displacement[:rows].mean(axis=0, dtype=np.float64)
    np.testing.assert_allclose(after, before, atol=1e-9)


@pytest.mark.parametrize("limit", [0.05, 0.2])
def test_every_spring_of_a_pulled_block_ends_within_its_limits(limit: float) -> None:
    mesh = block_mesh(7)
    model, state = build("relaxation", mesh, linear_factor=limit)
    held = hold(model, state, top_ball(mesh, 0.012), mesh)
    state.displacement[held] = [0.002, 0.0, 0.002]
    assert lengths(model.springs, state.displacement).max() > 1 + 2 * limit or limit > 0.1  # type: ignore[attr-defined]
    steps(model, state, 5000)
    stretch = lengths(model.springs, state.displacement)  # type: ignore[attr-defined]
    assert stretch.max() < 1 + limit + 1e-4
    assert stretch.min() > 1 - limit - 1e-4


def lengths(springs: SpringNetwork, u: np.ndarray) -> np.ndarray:
    ends = springs.springs.ends[: springs.rows]
    x = springs.mesh.rest + u
    now = np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1)
    return now / springs.springs.length[: springs.rows]


def test_it_has_no_forces_and_says_so() -> None:
    mesh = block_mesh(4)
    model, state = build("relaxation", mesh)
    state.displacement[mesh.node_rows - 1] = 0.01
    assert not model.has_forces
    assert not model.forces(state, np.arange(mesh.node_rows, dtype=np.int32)).any()
    assert np.isnan(model.residual(state))
