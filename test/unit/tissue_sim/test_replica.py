from __future__ import annotations

import copy

import numpy as np
import pytest
from numpy.typing import NDArray

from tissue_sim.elastic.model import State
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.replica import Replica

OLD, NEW = b"o" * 16, b"n" * 16


class Original:
    """A simulation: mesh and state, and edits that it applies."""

    def __init__(self) -> None:
        self.mesh = Mesh(block(4, 4, 4))
        self.state = State(self.mesh)
        random = np.random.default_rng(2)
        self.state.displacement += random.normal(scale=1e-3, size=self.state.displacement.shape)

    @property
    def positions(self) -> NDArray[np.float32]:
        return self.state.positions(self.mesh).astype(np.float32)

    def snapshot(self) -> Mesh:
        return copy.deepcopy(self.mesh)

    def edit(self, element: int) -> TopologyEdit:
        """Move the first node of an element towards the next, then give the element its own."""
        mesh = self.mesh
        nodes = mesh.tets[element]
        ids = mesh.node_ids[nodes]
        weights = np.array([[0.9, 0.1, 0.0, 0.0]])
        rewritten = ids.copy()
        rewritten[0] = PROVISIONAL
        change = mesh.apply(
            TopologyEdit(
                base_version=mesh.version,
                moved_nodes=ids[:1],
                moved_rest=weights @ mesh.rest[nodes],
                moved_anchors=ids[None],
                moved_weights=weights,
                copied_nodes=np.array([PROVISIONAL], dtype=np.uint32),
                copy_parents=ids[:1],
                rewritten_elements=mesh.element_ids[[element]],
                rewritten_nodes=rewritten[None],
            )
        )
        self.state.follow(mesh, change)
        return change.edit


def same(one: Mesh, other: Mesh) -> bool:
    n, e = one.node_rows, one.element_rows
    return (
        one.version == other.version
        and (n, e) == (other.node_rows, other.element_rows)
        and np.array_equal(one.rest[:n], other.rest[:n])
        and np.array_equal(one.tets[:e], other.tets[:e])
    )


@pytest.fixture
def original() -> Original:
    return Original()


@pytest.fixture
def replica(original: Original) -> Replica:
    made = Replica(shapes_kept=3)
    made.take_keyframe(OLD, original.snapshot())
    made.take_state(OLD, 1, 1, original.positions)
    return made


def test_is_ready_with_a_keyframe_and_a_state(original: Original) -> None:
    replica = Replica()
    assert not replica.ready
    assert replica.version == 0
    assert replica.shape_at() is None
    assert not replica.take_state(OLD, 1, 1, original.positions)
    assert replica.wants_keyframe(OLD, 1)
    assert replica.take_keyframe(OLD, original.snapshot())
    # The state that came first belongs to it.
    assert replica.ready
    assert not replica.wants_keyframe(OLD, 1)
    assert not replica.take_keyframe(OLD, original.snapshot())


def test_follows_edits_and_carries_older_shapes_as_the_simulation_does(
    original: Original, replica: Replica
) -> None:
    for element in (5, 40, 6):
        assert replica.take_edit(OLD, original.edit(element)) is not None
    mesh = replica.mesh
    assert mesh is not None
    assert same(mesh, original.mesh)
    shape = replica.shape_at(1)
    assert shape is not None
    assert shape.version == original.mesh.version
    np.testing.assert_allclose(shape.positions, original.positions, atol=1e-8)


def test_repeated_edits_are_known_and_a_gap_waits_for_a_keyframe(
    original: Original, replica: Replica
) -> None:
    first, second, third = original.edit(5), original.edit(40), original.edit(6)
    assert replica.take_edit(OLD, first) is not None
    assert replica.take_edit(OLD, first) is None
    assert replica.take_edit(OLD, third) is None
    assert (replica.gaps, replica.ready) == (1, False)
    assert replica.shape_at() is None
    keyframe = Original()
    for element in (5, 40):
        keyframe.edit(element)
    assert not replica.wants_keyframe(OLD, first.version)
    assert replica.wants_keyframe(OLD, second.version)
    assert replica.take_keyframe(OLD, keyframe.snapshot())
    # The edit after the gap has waited for the keyframe.
    mesh = replica.mesh
    assert mesh is not None
    assert same(mesh, original.mesh)
    assert not replica.ready
    assert replica.take_state(OLD, original.mesh.version, 9, original.positions)
    assert replica.ready


def test_a_late_joiner_takes_the_keyframe_then_newer_edits(original: Original) -> None:
    keyframe = original.snapshot()
    edits = [original.edit(5), original.edit(40)]
    replica = Replica()
    for edit in edits:
        assert replica.take_edit(OLD, edit) is None
    replica.take_keyframe(OLD, keyframe)
    mesh = replica.mesh
    assert mesh is not None
    assert same(mesh, original.mesh)


def test_a_state_that_overtakes_its_edit_waits_for_it(original: Original, replica: Replica) -> None:
    edit = original.edit(5)
    assert not replica.take_state(OLD, edit.version, 2, original.positions)
    assert replica.newest_frame == 1
    replica.take_edit(OLD, edit)
    assert replica.newest_frame == 2


def test_states_of_older_versions_and_other_epochs_are_ignored(
    original: Original, replica: Replica
) -> None:
    before = original.positions
    replica.take_edit(OLD, original.edit(5))
    assert not replica.take_state(OLD, 1, 2, before)
    assert not replica.take_state(NEW, 2, 2, original.positions)
    assert not replica.take_state(OLD, 2, 2, before)  # of the wrong length
    assert replica.ignored_states == 3
    assert replica.newest_frame == 1


def test_a_new_epoch_starts_from_its_keyframe(original: Original, replica: Replica) -> None:
    replica.take_edit(OLD, original.edit(5))
    fresh = Original()
    assert replica.take_keyframe(NEW, fresh.snapshot())
    assert replica.epoch == NEW
    assert not replica.ready
    assert replica.take_edit(OLD, original.edit(40)) is None
    assert replica.version == 1
    replica.take_state(NEW, 1, 1, fresh.positions)
    assert replica.ready


def test_frames_are_kept_for_a_while_and_a_lost_one_is_stood_in_for(
    original: Original, replica: Replica
) -> None:
    for frame in (2, 4, 5):
        replica.take_state(OLD, 1, frame, original.positions)
    assert (replica.oldest_frame, replica.newest_frame) == (2, 5)
    assert replica.shape_at(1) is None
    assert replica.shape_at(6) is None
    found = [replica.shape_at(frame) for frame in (2, 3, 4, 0)]
    assert [shape.frame for shape in found if shape] == [2, 4, 4, 5]


def test_an_edit_that_does_not_apply_is_a_gap(original: Original, replica: Replica) -> None:
    edit = original.edit(5)
    bad = TopologyEdit(
        base_version=1, version=2, removed_elements=np.array([10**6], dtype=np.uint32)
    )
    assert replica.take_edit(OLD, bad) is None
    assert replica.gaps == 1
    assert replica.wants_keyframe(OLD, edit.version)
