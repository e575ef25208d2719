"""Kernels equal plain numpy, in double precision."""

from __future__ import annotations

import numpy as np
import pytest

from support.elastic_scenes import (
    MATERIAL,
    block_mesh,
    build,
    double,
    hold,
    plain_force,
    plain_forces,
    top_ball,
)
from tissue_sim.elastic.model import State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.quasi_static import QuasiStatic
from tissue_sim.elastic.relaxation import Relaxation
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.kernels.vectors import LANES

MICROMETRE = 1e-6


def shaken(mesh: Mesh, size: float = 1e-3) -> tuple[SpringNetwork, State]:
    springs, state = double(mesh)
    random = np.random.default_rng(3)
    free = ~mesh.fixed[: mesh.node_rows]
    state.displacement[: mesh.node_rows][free] = random.normal(0, size, (int(free.sum()), 3))
    return springs, state


def test_forces_equal_the_textbook_formula() -> None:
    mesh = block_mesh(5)
    springs, state = shaken(mesh)
    model = QuasiStatic(mesh, MATERIAL, {}, springs)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    plain = plain_forces(springs, state.displacement)[rows]
    np.testing.assert_allclose(model.forces(state, rows), plain, rtol=1e-9, atol=1e-12)


def test_a_single_precision_force_is_precise_for_small_displacements() -> None:
    mesh = block_mesh(5)
    springs, state = shaken(mesh, 0.01 * MICROMETRE)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    exact = plain_forces(springs, state.displacement)[rows]
    single = State(mesh)
    single.displacement[:] = state.displacement
    forces = QuasiStatic(mesh, MATERIAL, {}).forces(single, rows)
    # Subtracting lengths of 1 cm in single precision would be off by 10 % and more.
    assert np.abs(forces - exact).max() < 1e-5 * np.abs(exact).max()


def test_a_node_sweep_equals_plain_gauss_seidel_in_breadth_first_order() -> None:
    mesh = block_mesh(4)
    springs, state = shaken(mesh)
    held = top_ball(mesh, 0.022)
    model, _ = build("quasi_static", mesh, springs, state, levels=WHOLE_ORGAN, step=1.3)
    assert isinstance(model, QuasiStatic)
    hold(model, state, held, mesh)
    u = state.displacement.copy()
    model.step(state)
    stiffness = springs.node_stiffness(np.arange(mesh.node_rows, dtype=np.int32))
    ordering = model.active.ordering
    for node in ordering.nodes[: ordering.used]:
        if not state.prescribed[node]:
            u[node] += 1.3 * plain_force(springs, u, int(node)) / stiffness[node]
    np.testing.assert_allclose(state.displacement, u, rtol=1e-9, atol=1e-14)


def test_a_relaxation_pass_equals_plain_numpy() -> None:
    mesh = block_mesh(4)
    springs, state = shaken(mesh)
    model, _ = build("relaxation", mesh, springs, state, linear_factor=0.03)
    assert isinstance(model, Relaxation)
    hold(model, state, top_ball(mesh, 0.022), mesh)
    u = state.displacement.copy()
    model.step(state)
    order = model.relaxation.order
    seen = set()
    for k in range(order.used):
        a, b = int(order.list.first[k]), int(order.list.second[k])
        if a == b:  # The tombstones that fill up a group.
            continue
        seen.add((min(a, b), max(a, b)))
        e = mesh.rest[b] + u[b] - mesh.rest[a] - u[a]
        l0, length = np.linalg.norm(mesh.rest[b] - mesh.rest[a]), np.linalg.norm(e)
        excess = length - np.clip(length, 0.97 * l0, 1.03 * l0)
        shares = {(False, False): (0.5, 0.5), (False, True): (1, 0), (True, False): (0, 1)}
        shares[True, True] = (0, 0)
        share_a, share_b = shares[bool(state.prescribed[a]), bool(state.prescribed[b])]
        u[a] += share_a * excess * e / length
        u[b] -= share_b * excess * e / length
    np.testing.assert_allclose(state.displacement, u, rtol=1e-9, atol=1e-14)
    fixed = mesh.fixed[springs.springs.ends[: springs.rows]].all(axis=1)
    assert seen == set(map(tuple, springs.springs.ends[: springs.rows][~fixed].tolist()))


def test_springs_relaxed_at_once_share_no_node_and_those_at_a_node_keep_their_turn() -> None:
    mesh = block_mesh(7)
    model, state = build("relaxation", mesh)
    assert isinstance(model, Relaxation)
    hold(model, state, top_ball(mesh, 0.022), mesh)
    order, nodes = model.relaxation.order, model.relaxation._breadth_first
    while not order.advance():
        pass
    first, second = order.list.first[: order.used], order.list.second[: order.used]
    for begin in range(0, order.used, LANES):
        real = first[begin : begin + LANES] != second[begin : begin + LANES]
        ends = [*first[begin : begin + LANES][real], *second[begin : begin + LANES][real]]
        assert len(set(ends)) == len(ends)
    turns: dict[int, list[tuple[int, int]]] = {}
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        if a != b:
            turns.setdefault(a, []).append((a, b))
            turns.setdefault(b, []).append((a, b))
    # The plain sequence: every node in turn lists its springs that have not been listed.
    plain: dict[int, list[tuple[int, int]]] = {}
    arrays = model.springs.arrays
    for place, node in enumerate(nodes.nodes[: nodes.used].tolist()):
        begin = int(arrays.start[node])
        for other in arrays.neighbour[begin : begin + int(arrays.degree[node])].tolist():
            if not 0 <= nodes.rank[other] < place:
                plain.setdefault(node, []).append((node, other))
                plain.setdefault(other, []).append((node, other))
    assert turns == plain


def test_a_time_step_equals_plain_verlet() -> None:
    mesh = block_mesh(4)
    springs, state = shaken(mesh, 1e-4)
    state.previous[:] = 0.9 * state.displacement
    model, _ = build("spring_mass", mesh, springs, state, damping=0.1)
    assert model.time_step is not None
    u, before = state.displacement.copy(), state.previous.copy()
    model.step(state)
    free = springs.masses > 0
    free &= ~mesh.fixed
    F = plain_forces(springs, u)
    expected = u.copy()
    h2_over_m = model.time_step**2 / springs.masses[free]
    expected[free] = 1.9 * u[free] - 0.9 * before[free] + h2_over_m[:, None] * F[free]
    np.testing.assert_allclose(state.displacement, expected, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(state.previous[free], u[free], rtol=0, atol=0)


def test_stiffness_and_mass_are_sums_over_elements() -> None:
    mesh = block_mesh(4)
    springs = SpringNetwork(mesh, MATERIAL, np.float64)
    tets = mesh.tets[: mesh.element_rows]
    volumes = signed_volumes(mesh.rest, tets)
    for row in range(0, springs.rows, 7):
        a, b = springs.springs.ends[row]
        at_edge = (tets == a).any(axis=1) & (tets == b).any(axis=1)
        squared = np.sum((mesh.rest[a] - mesh.rest[b]) ** 2)
        plain = MATERIAL.young_modulus * volumes[at_edge].sum() / squared
        assert springs.springs.stiffness[row] == pytest.approx(plain, rel=1e-12)
    total = MATERIAL.density * volumes.sum()
    assert springs.masses.sum() == pytest.approx(total, rel=1e-12)


def test_the_springs_of_any_mesh_sum_to_the_modulus_of_the_material() -> None:
    mesh = block_mesh(4)
    springs = SpringNetwork(mesh, MATERIAL, np.float64)
    used = springs.springs.alive[: springs.rows]
    k, l0 = springs.springs.stiffness[: springs.rows][used], springs.springs.length[: springs.rows]
    # The trace C_iijj of the stiffness tensor; 9 lambda + 6 mu = 6 E for lambda = mu = 0.4 E.
    volume = signed_volumes(mesh.rest, mesh.tets[: mesh.element_rows]).sum()
    assert (k * l0**2).sum() / volume == pytest.approx(6 * MATERIAL.young_modulus, rel=1e-12)
