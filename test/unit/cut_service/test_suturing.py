"""Planning sutures: what positions are attached to, how threads are spread, what is refused."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tissue_interfaces.srv import Suture

from cut_service.errors import CutError
from cut_service.planner import plan
from cut_service.suturing import (
    Sewing,
    SutureCode,
    SutureError,
    chosen,
    plan_removal,
    plan_sewing,
    plan_tightening,
    pulls,
)
from cut_service.sweep import Sweep
from support.sewn_blocks import SIZE, two_blocks
from tissue_sim.geometry.edit import StaleEditError, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sutures import DEFAULT_STIFFNESS

GAP = 0.001
EDGES = np.array(
    [[SIZE, 0, 0.006], [SIZE, 0.009, 0.006], [SIZE + GAP, 0, 0.006], [SIZE + GAP, 0.009, 0.006]]
)
"""The upper edges of both lips, each from y = 0 to y = 9 mm."""


def organ() -> tuple[Mesh, NDArray[np.float64]]:
    mesh, _, _ = two_blocks(GAP)
    return mesh, mesh.rest[: mesh.node_rows].copy()


def node_at(mesh: Mesh, *place: float) -> int:
    return int(np.linalg.norm(mesh.rest[: mesh.node_rows] - place, axis=1).argmin())


def test_the_codes_are_those_of_the_service() -> None:
    for code in SutureCode:
        assert getattr(Suture.Response, code.name) == code


def test_pairs_are_attached_to_the_closest_nodes_of_the_deformed_surface() -> None:
    mesh, shape = organ()
    shape += [0.1, 0.0, 0.0]
    pair = np.array([[SIZE + 0.0998, 0.0032, 0.0062], [SIZE + GAP + 0.1001, 0.0029, 0.0063]])
    edit = plan_sewing(mesh, shape, Sewing(pair, length=0.0002))
    expected = [node_at(mesh, SIZE, 0.003, 0.006), node_at(mesh, SIZE + GAP, 0.003, 0.006)]
    assert edit.suture_nodes.tolist() == [expected]
    assert edit.read_nodes.tolist() == sorted(expected)
    assert edit.suture_lengths.tolist() == [0.0002]
    assert edit.suture_stiffness.tolist() == [DEFAULT_STIFFNESS]
    mesh.apply(edit)
    np.testing.assert_allclose(pulls(mesh.sutures, shape), [1000 * 0.0008], rtol=1e-6)


def test_a_position_inside_goes_to_the_surface() -> None:
    mesh, shape = organ()
    inside = shape[node_at(mesh, 0.006, 0.003, 0.003)]
    pair = np.array([inside, [SIZE + GAP, 0.003, 0.006]])
    edit = plan_sewing(mesh, shape, Sewing(pair, reach=0.004))
    x, y, z = shape[edit.suture_nodes[0, 0]]
    assert z in (0.0, 0.006) or y == 0.0
    assert np.linalg.norm([x, y, z] - inside) == pytest.approx(0.003)


def test_lips_that_lie_on_each_other_are_sewn_to_each_other() -> None:
    mesh, shape = organ()
    shape[shape[:, 0] > SIZE + 1e-6, 0] -= GAP
    place = np.array([SIZE, 0.003, 0.006])
    edit = plan_sewing(mesh, shape, Sewing(np.stack([place, place])))
    rest = mesh.rest[edit.suture_nodes[0]]
    assert sorted(rest[:, 0].tolist()) == pytest.approx([SIZE, SIZE + GAP])


def test_interrupted_stitches_are_spread_evenly_along_two_edges() -> None:
    mesh, shape = organ()
    edit = plan_sewing(mesh, shape, Sewing(EDGES, spacing=0.003))
    rest = mesh.rest[edit.suture_nodes]
    np.testing.assert_allclose(rest[:, 0, 1], [0.0, 0.003, 0.006, 0.009])
    np.testing.assert_allclose(rest[:, 1] - rest[:, 0], np.tile([GAP, 0, 0], (4, 1)), atol=1e-12)
    assert edit.suture_groups.tolist() == edit.added_sutures.tolist()
    np.testing.assert_allclose(edit.suture_lengths, GAP)


def test_a_running_thread_crosses_from_each_stitch_to_the_next() -> None:
    mesh, shape = organ()
    edit = plan_sewing(mesh, shape, Sewing(EDGES, spacing=0.003, running=True, length=0.0004))
    nodes = edit.suture_nodes
    assert len(nodes) == 7
    assert (nodes[1:, 0] == nodes[:-1, 1]).all()
    assert len(set(edit.suture_groups.tolist())) == 1
    np.testing.assert_allclose(edit.suture_lengths[::2], 0.0004)
    np.testing.assert_allclose(edit.suture_lengths[1::2], np.hypot(0.0004, 0.003))
    mesh.apply(edit)
    again = plan_tightening(mesh, shape, mesh.sutures, 0.0)
    np.testing.assert_allclose(again.changed_lengths[::2], 0.0)
    np.testing.assert_allclose(again.changed_lengths[1::2], 0.003)


def test_stitches_closer_than_nodes_are_made_once() -> None:
    mesh, shape = organ()
    edit = plan_sewing(mesh, shape, Sewing(EDGES, spacing=0.0005))
    assert len(edit.suture_nodes) == 4


def test_a_length_can_be_a_share_of_the_present_one() -> None:
    mesh, shape = organ()
    mesh.apply(plan_sewing(mesh, shape, Sewing(EDGES, spacing=0.003, length=-0.5)))
    np.testing.assert_allclose(mesh.sutures.lengths, 0.5 * GAP)
    edit = plan_tightening(mesh, shape, mesh.sutures, -0.25)
    np.testing.assert_allclose(edit.changed_lengths, 0.25 * GAP)


def test_sutures_are_chosen_by_id_by_thread_or_all() -> None:
    mesh, shape = organ()
    mesh.apply(plan_sewing(mesh, shape, Sewing(EDGES, spacing=0.003, running=True)))
    mesh.apply(plan_sewing(mesh, shape, Sewing(EDGES, spacing=0.009)))
    none = np.empty(0, dtype=np.uint32)
    assert chosen(mesh.sutures, none, 0).ids.tolist() == list(range(1, 10))
    assert chosen(mesh.sutures, none, 1).ids.tolist() == list(range(1, 8))
    some = chosen(mesh.sutures, np.array([9, 2], dtype=np.uint32), 0)
    assert some.ids.tolist() == [2, 9]
    mesh.apply(plan_removal(mesh, some))
    assert mesh.sutures.ids.tolist() == [1, 3, 4, 5, 6, 7, 8]
    for ids, group in ((np.array([2], dtype=np.uint32), 0), (none, 5)):
        with pytest.raises(SutureError, match=r"there is no .*; sutures: 1, 3, 4") as error:
            chosen(mesh.sutures, ids, group)
        assert error.value.code == SutureCode.UNKNOWN_SUTURE


@pytest.mark.parametrize(
    ("wanted", "code", "message"),
    [
        (lambda: Sewing(EDGES[:3]), SutureCode.INVALID, "3 positions; allowed: pairs"),
        (lambda: Sewing(EDGES[:0]), SutureCode.INVALID, "0 positions"),
        (lambda: Sewing(EDGES * np.nan), SutureCode.INVALID, "is not finite"),
        (lambda: Sewing(EDGES, spacing=np.inf), SutureCode.INVALID, "is not finite"),
        (lambda: Sewing(EDGES, spacing=-1.0), SutureCode.INVALID, "must not be negative"),
        (lambda: Sewing(EDGES, reach=1.0), SutureCode.INVALID, "reach must be from 0 to 0.1 m"),
        (lambda: Sewing(EDGES, spacing=1e-6), SutureCode.INVALID, "501 stitches; .* up to 500"),
        (lambda: Sewing(EDGES, length=20.0), SutureCode.INVALID, "rest length of a suture"),
        (lambda: Sewing(EDGES, stiffness=1e9), SutureCode.INVALID, "stiffness of a suture"),
        (lambda: Sewing(EDGES + 1.0), SutureCode.NOTHING_THERE, "no node of the surface within"),
        (
            lambda: Sewing(EDGES[[0, 0]], reach=0.0005),
            SutureCode.NOTHING_THERE,
            "not next to the other end",
        ),
    ],
)
def test_what_cannot_be_sewn_is_refused(
    wanted: Callable[[], Sewing], code: SutureCode, message: str
) -> None:
    mesh, shape = organ()
    with pytest.raises(SutureError, match=message) as error:
        plan_sewing(mesh, shape, wanted())
    assert error.value.code == code
    assert len(mesh.sutures) == 0


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(*3 * [st.floats(-0.002, 0.03)]), min_size=2, max_size=8),
    st.floats(0.0, 0.01), st.booleans(), st.floats(-1.5, 0.01), st.floats(0.0, 0.02),
)  # fmt: skip
def test_whatever_is_planned_can_be_applied_and_taken_out(
    points: list[tuple[float, float, float]], spacing: float, running: bool, length: float,
    reach: float,
) -> None:  # fmt: skip
    mesh, shape = organ()
    wanted = Sewing(np.array(points), spacing, running, reach, length=length)
    with suppress(SutureError):
        edit = plan_sewing(mesh, shape, wanted)
        _apply_and_take_out(mesh, shape, edit)


def _apply_and_take_out(mesh: Mesh, shape: NDArray[np.float64], edit: TopologyEdit) -> None:
    mesh.apply(edit)
    table = mesh.sutures
    assert (table.nodes[:, 0] != table.nodes[:, 1]).all()
    mesh.apply(plan_tightening(mesh, shape, table, 0.0))
    mesh.apply(plan_removal(mesh, table))
    assert len(mesh.sutures) == 0


def blade(x: float, y: float, low: float, high: float) -> Sweep:
    """A rectangle in the plane of this x, from y = 0 to y, between two heights."""
    return Sweep.between(
        np.array([[x, -0.001, low], [x, y, low]]), np.array([[x, -0.001, high], [x, y, high]])
    )


def test_a_blade_in_the_gap_cuts_threads_and_no_tissue() -> None:
    mesh, shape = organ()
    mesh.apply(plan_sewing(mesh, shape, Sewing(EDGES, spacing=0.003)))
    made = plan(mesh, shape, blade(SIZE + 0.0004, 0.004, 0.004, 0.008), request_id="cut")
    assert made.edit.removed_sutures.tolist() == [1, 2]
    assert made.report.notes == "2 stitches cut"
    assert made.report.faces_split == 0
    assert made.edit.request_id == "cut"
    mesh.apply(made.edit)
    assert mesh.sutures.ids.tolist() == [3, 4]
    with pytest.raises(CutError, match="crosses no tissue"):
        plan(mesh, shape, blade(SIZE + 0.0004, 0.004, 0.004, 0.008))


def test_a_blade_through_closed_lips_cuts_their_threads() -> None:
    mesh, shape = organ()
    mesh.apply(plan_sewing(mesh, shape, Sewing(EDGES, spacing=0.003)))
    shape[shape[:, 0] > SIZE + 1e-6, 0] -= GAP
    made = plan(mesh, shape, blade(SIZE - 0.0001, 0.0045, 0.003, 0.008))
    assert made.edit.removed_sutures.tolist() == [1, 2]


def test_a_cut_through_tissue_cuts_the_threads_it_passes_and_is_stale_if_they_change() -> None:
    mesh, shape = organ()
    mesh.apply(plan_sewing(mesh, shape, Sewing(EDGES, spacing=0.003)))
    sweep = Sweep.between(
        np.array([[0.0, 0.0045, -0.001], [0.03, 0.0045, -0.001]]),
        np.array([[0.0, 0.0045, 0.007], [0.03, 0.0045, 0.007]]),
    )
    running = plan_sewing(mesh, shape, Sewing(EDGES, spacing=0.003, running=True))
    mesh.apply(running)
    made = plan(mesh, shape, sweep)
    assert made.edit.removed_sutures.tolist() == [8]
    assert made.report.faces_split > 0
    mesh.apply(plan_removal(mesh, mesh.sutures.at(mesh.sutures.ids == 8)))
    with pytest.raises(StaleEditError):
        mesh.apply(made.edit)
