"""LR: quasi-static near the hold, relaxation everywhere."""

from __future__ import annotations

import numpy as np

from support.elastic_scenes import (
    MATERIAL,
    block_mesh,
    build,
    hold,
    release,
    steps,
    top_ball,
    wall_mesh,
)
from tissue_sim.elastic.lingering import Lingering
from tissue_sim.elastic.local_relaxation import LocalRelaxation
from tissue_sim.elastic.model import State
from tissue_sim.elastic.ordering import WHOLE_ORGAN, NodeOrdering
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.kernels.orderings import UNREACHED


def test_with_the_whole_organ_as_region_it_is_quasi_static_and_relaxation_bit_for_bit() -> None:
    mesh = block_mesh(8)
    springs = SpringNetwork(mesh, MATERIAL)
    lr, state = build("lr", mesh, springs, levels=WHOLE_ORGAN, linear_factor=0.02, step=1.5)
    combined = State(mesh)
    sweep, _ = build("quasi_static", mesh, springs, combined, levels=WHOLE_ORGAN, step=1.5)
    relax, _ = build("relaxation", mesh, springs, combined, linear_factor=0.02)
    held = hold(lr, state, top_ball(mesh), mesh)
    hold(sweep, combined, held, mesh)
    hold(relax, combined, held, mesh)
    for frame in range(1, 31):
        state.displacement[held] = combined.displacement[held] = [0, 0.0002 * frame, 0.0004 * frame]
        for _ in range(4):
            lr.step(state)
            sweep.step(combined)
            relax.step(combined)
    assert (state.displacement[: mesh.node_rows] != 0).any(axis=1).mean() > 0.5
    np.testing.assert_array_equal(state.displacement, combined.displacement)


def test_far_from_the_hold_only_relaxation_moves_the_tissue() -> None:
    mesh = block_mesh(9)
    model, state = build("lr", mesh, levels=2, linear_factor=0.1)
    held = hold(model, state, top_ball(mesh), mesh)
    # So little that no spring leaves its limits: nothing beyond the region moves.
    state.displacement[held] = [0, 0, 0.0004]
    steps(model, state, 50)
    level = model.active.ordering.level[: mesh.node_rows]  # type: ignore[attr-defined]
    moved = (state.displacement[: mesh.node_rows] != 0).any(axis=1)
    assert not moved[level > 2].any()
    assert moved[level == 2].any()
    state.displacement[held] = [0, 0, 0.012]
    steps(model, state, 50)
    moved = (state.displacement[: mesh.node_rows] != 0).any(axis=1)
    assert moved[level > 2].any()


def test_passing_over_resting_tissue_moves_nothing_elsewhere() -> None:
    mesh = block_mesh(15)
    springs = SpringNetwork(mesh, MATERIAL)
    shapes, looked = [], []
    for sleeping in (True, False):
        model, state = build("lr", mesh, springs, levels=2)
        assert isinstance(model, LocalRelaxation)
        model.relaxation.sleeping = sleeping
        held = hold(model, state, top_ball(mesh), mesh)
        seen = 0
        for frame in range(60):
            # To and fro, then a pause.
            state.displacement[held] = [0, 0, 0.004 * np.sin(min(frame, 40) / 6)]
            steps(model, state, 2)
            seen += model.relaxation.looked
        release(model, state, mesh)
        steps(model, state, 100)
        shapes.append(state.displacement[: mesh.node_rows].copy())
        looked.append(seen)
    # A micrometre would do.
    np.testing.assert_array_equal(shapes[0], shapes[1])
    assert looked[0] < 0.8 * looked[1]


def test_a_thin_wall_pulled_far_stays_smooth_and_springs_back() -> None:
    mesh = wall_mesh()
    model, state = build("lr", mesh)
    points = mesh.rest[: mesh.node_rows]
    near = np.linalg.norm(points - [0.032, 0.06, 0.002], axis=1) < 0.008
    held = hold(model, state, np.flatnonzero(near).tolist(), mesh)
    for frame in range(1, 61):
        state.displacement[held] = [0, 0, 0.012 * frame / 60]
        steps(model, state, 4)
    volumes = signed_volumes(
        points + state.displacement[: mesh.node_rows], mesh.tets[: mesh.element_rows]
    )
    assert (volumes <= 0).mean() < 0.01
    assert np.isfinite(state.displacement).all()
    assert np.abs(state.displacement).max() < 0.0121
    release(model, state, mesh)
    steps(model, state, 480)
    assert np.abs(state.displacement).max() < 0.05 * 0.012


def test_two_holds_let_go_one_after_the_other_leave_nothing_behind() -> None:
    mesh = block_mesh(9)
    model, state = build("lr", mesh)
    points = mesh.rest[: mesh.node_rows]
    left = np.flatnonzero(np.linalg.norm(points - [0.0, 0.0, 0.06], axis=1) < 0.012)
    right = np.flatnonzero(np.linalg.norm(points - [0.06, 0.06, 0.06], axis=1) < 0.012)
    hold(model, state, [*left, *right], mesh)
    for frame in range(1, 31):
        state.displacement[left] = state.displacement[right] = [0, 0, 0.0003 * frame]
        steps(model, state, 4)
    hold(model, state, right.tolist(), mesh)
    steps(model, state, 480)
    assert np.abs(state.displacement[left]).max() < 0.05 * 0.009
    np.testing.assert_allclose(state.displacement[right], [[0, 0, 0.009]] * len(right), rtol=1e-6)
    release(model, state, mesh)
    steps(model, state, 2000)
    assert np.abs(state.displacement).max() < 1e-5


def test_a_node_that_lingers_again_does_not_repeat_the_move_of_its_last_time() -> None:
    mesh = block_mesh()
    springs, state = SpringNetwork(mesh, MATERIAL), State(mesh)
    order = NodeOrdering(springs)
    order.search(np.empty(0, dtype=np.int32), state.prescribed)
    lingering = Lingering(springs, momentum=0.7, joins=False)
    nodes, near = top_ball(mesh), NodeOrdering(springs)
    near.search(nodes, state.prescribed, depth=0)
    state.displacement[nodes] = [0, 0, 0.002]
    lingering.join(state, near, order.level, UNREACHED)
    lingering.sweep(state, order, 0, np.float32(1))
    assert (state.displacement[nodes] != [0, 0, 0.002]).any()
    lingering.clear()
    state.displacement[:] = 0
    lingering.join(state, near, order.level, UNREACHED)
    lingering.sweep(state, order, 0, np.float32(1))
    assert np.abs(state.displacement).max() < 1e-9
