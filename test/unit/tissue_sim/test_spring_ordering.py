"""Relaxation passes leave out what cannot be outside its limits; orders are made in parts."""

from __future__ import annotations

import numpy as np
import pytest

from support.elastic_scenes import apply, block_mesh, build, hold, split_edit, top_ball
from tissue_sim.elastic import spring_ordering
from tissue_sim.elastic.local_relaxation import LocalRelaxation


def pulled(seed: int, everything: bool) -> tuple[list[np.ndarray], list[int]]:
    """Shapes and springs outside after each step of a pull, a pause, a cut and a release."""
    mesh = block_mesh(9)
    model, state = build("lr", mesh, linear_factor=0.05)
    assert isinstance(model, LocalRelaxation)
    random = np.random.default_rng(seed)
    held = top_ball(mesh, 0.012)
    hold(model, state, held, mesh)
    shapes, outside = [], []
    for step in range(60):
        if step < 20:
            state.displacement[held] += random.normal(0, 2e-4, 3).astype(np.float32) + 3e-4
        if step == 30:
            apply(mesh, model, state, split_edit(mesh, 0.03, above=0.02))
        if step == 45:
            hold(model, state, [], mesh)
        if everything:
            model.relaxation._look_at_all = True
        model.step(state)
        shapes.append(state.displacement[: mesh.node_rows].copy())
        outside.append(model._outside)
    return shapes, outside


@pytest.mark.parametrize("nodes_a_pass", [50, 100_000])
def test_leaving_out_what_has_not_moved_changes_no_bit(
    monkeypatch: pytest.MonkeyPatch, nodes_a_pass: int
) -> None:
    monkeypatch.setattr(spring_ordering, "NODES_A_PASS", nodes_a_pass)
    shapes, outside = pulled(3, everything=False)
    all_shapes, all_outside = pulled(3, everything=True)
    assert outside == all_outside
    assert max(outside) > 100
    for one, other in zip(shapes, all_shapes, strict=True):
        assert one.tobytes() == other.tobytes()


def test_an_order_made_in_parts_is_the_one_made_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = block_mesh(8)
    model, state = build("lr", mesh)
    assert isinstance(model, LocalRelaxation)
    order = model.relaxation.order
    hold(model, state, top_ball(mesh, 0.012), mesh)
    assert order.advance()
    at_once = [array[: order.used].copy() for array in order.list]
    monkeypatch.setattr(spring_ordering, "NODES_A_PASS", 100)
    corner = np.flatnonzero(mesh.rest[: mesh.node_rows, :2].sum(axis=1) == 0)[-1:]
    hold(model, state, corner.tolist(), mesh)
    for _ in range(3):
        assert not order.advance()
    # Passes go on with the order before, and a change begins the new one again.
    assert all(
        np.array_equal(array[: order.used], before)
        for array, before in zip(order.list, at_once, strict=True)
    )
    hold(model, state, top_ball(mesh, 0.012), mesh)
    parts = 1
    while not order.advance():
        parts += 1
    assert parts == -(-model.active.ordering.used // 100)
    for array, before in zip(order.list, at_once, strict=True):
        np.testing.assert_array_equal(array[: order.used], before)
