"""Nodes that a cut makes on edges: in a running simulation, under holds, and in replicas."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from cut_service.planner import plan
from support.cut_scenes import square
from support.small_block import block_simulation, tool_at
from tissue_sim.frame import Budget, Command, FrameInputs
from tissue_sim.geometry.edit import EditError
from tissue_sim.replica import Replica

ONE = Budget(steps=1)
OLD = b"o" * 16


def test_a_new_node_between_held_nodes_is_held_where_it_is_and_one_beside_a_free_node_is_free() -> (
    None
):
    simulation = block_simulation(tool_at((0.03, 0.06, 0.03)))
    simulation.advance(FrameInputs((Command("grab", {"tool": "grasper", "radius": 0.022}),)), ONE)
    (hold,) = simulation.holds.by_id.values()
    before = np.sort(hold.rows)
    mesh, state = simulation.mesh, simulation.state
    sweep = square(np.array([0.036, 0.05, 0.03]), np.array([1.0, 0.1, 0.05]), 0.03)
    edit = plan(mesh, state.positions(mesh), sweep, "subdivide").edit
    anchors, weights = mesh.node_rows_of(edit.moved_anchors), edit.moved_weights
    frame = simulation.advance(FrameInputs(edits=(edit,)), ONE)
    (applied,) = frame.edits
    change = applied.change
    made = np.isin(change.moved_nodes, change.copied_nodes)
    between = (np.isin(anchors, before) | (weights == 0.0)).all(axis=1) & made
    assert between.any()
    assert not between[made].all()
    is_held = simulation.holds.owner[change.moved_nodes] == hold.id
    np.testing.assert_array_equal(is_held[made], between[made])
    np.testing.assert_array_equal(
        state.prescribed[change.moved_nodes[made]],
        (between | mesh.fixed[change.moved_nodes])[made],
    )
    # The tool has not moved: what it holds has not either.
    np.testing.assert_allclose(
        frame.positions[change.moved_nodes[between]], edit.moved_rest[between], atol=1e-7
    )
    assert len(hold.rows) == len(hold.local) == len(np.unique(hold.rows))


@pytest.mark.parametrize("method", ["subdivide", "remove"])
def test_a_replica_follows_and_its_shape_is_the_simulations(method: str) -> None:
    simulation = block_simulation()
    mesh, state = simulation.mesh, simulation.state
    state.displacement[: mesh.node_rows, 0] = 0.1 * mesh.rest[: mesh.node_rows, 1]
    replica = Replica(shapes_kept=3)
    replica.take_keyframe(OLD, copy.deepcopy(mesh))
    replica.take_state(OLD, 1, 1, state.positions(mesh).astype(np.float32))
    for where in (0.024, 0.041):
        sweep = square(np.array([where, 0.05, 0.03]), np.array([1.0, 0.1, 0.05]), 0.03)
        change = mesh.apply(plan(mesh, state.positions(mesh), sweep, method).edit)
        state.follow(mesh, change)
        assert replica.take_edit(OLD, change.edit) is not None
    followed, shape = replica.mesh, replica.shape_at(1)
    assert followed is not None
    assert shape is not None
    rows = mesh.node_rows
    alive = mesh.node_alive[:rows]
    np.testing.assert_array_equal(followed.rest[:rows], mesh.rest[:rows])
    np.testing.assert_array_equal(followed.node_alive[:rows], alive)
    np.testing.assert_array_equal(
        followed.tets[: mesh.element_rows], mesh.tets[: mesh.element_rows]
    )
    np.testing.assert_allclose(shape.positions[alive], state.positions(mesh)[alive], atol=1e-8)


def test_a_new_node_that_would_make_an_element_flat_is_refused() -> None:
    simulation = block_simulation()
    mesh = simulation.mesh
    sweep = square(np.array([0.036, 0.05, 0.03]), np.array([1.0, 0.1, 0.05]), 0.03)
    edit = plan(mesh, mesh.rest[: mesh.node_rows], sweep, "subdivide").edit
    version, rows = mesh.version, mesh.node_rows
    edit.moved_rest[-1] += 0.05
    with pytest.raises(EditError, match="no positive rest volume"):
        mesh.apply(edit)
    assert (mesh.version, mesh.node_rows) == (version, rows)
