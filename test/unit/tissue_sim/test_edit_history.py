"""Undo and redo restore a mesh bit for bit, to any depth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cut_service.errors import CutError
from cut_service.planner import METHODS, plan
from support import cut_scenes
from support.elastic_scenes import MATERIAL
from support.sheets import connected
from support.valid_mesh import check_valid
from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.stiffness import Stiffness
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.edit_history import EditHistory, NoEditError
from tissue_sim.geometry.mesh import Mesh


class Picture(NamedTuple):
    """All of a mesh that an undo has to bring back."""

    rest: NDArray[np.float64]
    nodes: NDArray[np.bool_]
    fixed: NDArray[np.bool_]
    tets: NDArray[np.int32]
    elements: NDArray[np.bool_]
    met: NDArray[np.int32]
    incident: NDArray[np.int32]


def picture(mesh: Mesh) -> Picture:
    nodes, elements, lists = mesh.node_rows, mesh.element_rows, mesh.incident
    count = lists.count[:nodes].copy()
    places = np.repeat(lists.start[:nodes] - np.cumsum(count) + count, count)
    return Picture(
        mesh.rest[:nodes].copy(), mesh.node_alive[:nodes].copy(), mesh.fixed[:nodes].copy(),
        mesh.tets[:elements].copy(), mesh.element_alive[:elements].copy(),
        count, lists.data[places + np.arange(len(places))],
    )  # fmt: skip


def check_same(mesh: Mesh, before: Picture) -> None:
    """The mesh is as it was; rows that it did not have are not alive."""
    now, nodes, elements = picture(mesh), len(before.nodes), len(before.elements)
    np.testing.assert_array_equal(now.nodes[:nodes], before.nodes)
    assert not now.nodes[nodes:].any()
    np.testing.assert_array_equal(now.elements[:elements], before.elements)
    assert not now.elements[elements:].any()
    np.testing.assert_array_equal(now.rest[:nodes][before.nodes], before.rest[before.nodes])
    np.testing.assert_array_equal(now.fixed[:nodes], before.fixed)
    alive = before.elements
    np.testing.assert_array_equal(now.tets[:elements][alive], before.tets[alive])
    np.testing.assert_array_equal(now.met[:nodes], before.met)
    assert not now.met[nodes:].any()
    np.testing.assert_array_equal(now.incident, before.incident)


def organ(name: str) -> Mesh:
    if name == "connected surfaces":
        return connected(fixed=True)
    mesh = cut_scenes.new(name)
    mesh.fixed[: mesh.node_rows] = mesh.rest[: mesh.node_rows, 2] < mesh.rest[0, 2] + 1e-9
    return mesh


def random_cut(mesh: Mesh, positions: NDArray[np.float64], seed: int) -> TopologyEdit | None:
    random = np.random.default_rng(seed)
    method = METHODS[seed % len(METHODS)] if mesh.sheet_rows is None else METHODS[0]
    places = positions[mesh.node_alive[: mesh.node_rows]]
    centre = places[random.integers(len(places))]
    half = np.ptp(places, axis=0).max() * random.uniform(0.1, 0.5)
    sweep = cut_scenes.square(centre, random.normal(size=3), half)
    try:
        return plan(mesh, positions, sweep, method).edit
    except CutError:
        return None


def random_removal(mesh: Mesh, seed: int) -> TopologyEdit:
    """Remove all elements at a node and some others, so that nodes vanish too."""
    random = np.random.default_rng(seed)
    node = random.choice(np.flatnonzero(mesh.node_alive[: mesh.node_rows]))
    gone = mesh.incident.of(int(node))
    living = np.flatnonzero(mesh.element_alive[: mesh.element_rows])
    gone = np.union1d(gone, random.choice(living, 3))
    return TopologyEdit(mesh.version, kind="remove", removed_elements=gone.astype(np.uint32))


CUT, REMOVE, BACK, AGAIN = "cut", "remove", "undo", "redo"


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(["wall", "shell", "block", "shaken", "connected surfaces"]),
    st.lists(
        st.tuples(
            st.sampled_from([CUT, CUT, CUT, REMOVE, BACK, BACK, BACK, AGAIN]),
            st.integers(0, 10**6),
        ),
        min_size=3,
        max_size=14,
    ),
)
def test_undo_and_redo_to_any_depth_are_exact(name: str, deeds: list[tuple[str, int]]) -> None:
    mesh, history = organ(name), EditHistory()
    state = State(mesh)
    random = np.random.default_rng(1)
    state.displacement[: mesh.node_rows] = random.normal(0, 1e-5, (mesh.node_rows, 3))
    springs = SpringNetwork(mesh, MATERIAL)
    pictures, place = [picture(mesh)], 0
    # Removing elements can leave nodes that hinge two parts: nothing a cut may do.
    only_cuts = True

    def apply(edit: TopologyEdit) -> None:
        change = mesh.apply(edit)
        history.record(change)
        state.follow(mesh, change)
        springs.follow(change)

    for deed, seed in [*deeds, *[(BACK, 0)] * len(deeds)]:
        if deed == BACK and place:
            apply(history.undo(mesh))
            place -= 1
        elif deed == AGAIN and place + 1 < len(pictures):
            apply(history.redo(mesh))
            place += 1
        elif deed in (CUT, REMOVE):
            positions = state.positions(mesh).astype(np.float64)
            edit = random_cut(mesh, positions, seed) if deed == CUT else random_removal(mesh, seed)
            if edit is None:
                continue
            only_cuts &= deed == CUT
            apply(edit)
            place += 1
            del pictures[place:]
            pictures.append(picture(mesh))
        check_same(mesh, pictures[place])
        assert np.isfinite(state.displacement).all()
        if only_cuts and mesh.sheet_rows is None:
            check_valid(mesh)
        assert (len(history.done), len(history.undone)) == (place, len(pictures) - 1 - place)
    assert place == 0
    with pytest.raises(NoEditError, match="no edit to undo"):
        history.undo(mesh)
    # Springs have the rows, and the order at each node, of a mesh that was never cut.
    fresh = SpringNetwork(organ(name), MATERIAL)
    rows = fresh.rows
    np.testing.assert_array_equal(springs.springs.alive[:rows], True)
    assert not springs.springs.alive[rows : springs.rows].any()
    for field in ("ends", "stiffness", "length"):
        now, then = getattr(springs.springs, field), getattr(fresh.springs, field)
        np.testing.assert_array_equal(now[:rows], then[:rows])
    for node in range(len(pictures[0].nodes)):
        for field in ("neighbour", "spring", "stiffness", "length"):
            np.testing.assert_array_equal(
                part_of(springs, field, node), part_of(fresh, field, node)
            )
    np.testing.assert_array_equal(
        springs.masses[: len(pictures[0].nodes)], fresh.masses[: len(pictures[0].nodes)]
    )


def part_of(springs: SpringNetwork, field: str, node: int) -> NDArray:
    lists = springs._lists
    begin = int(lists.start[node])
    return getattr(lists, field)[begin : begin + int(lists.degree[node])]


def test_rows_of_the_stiffness_matrix_are_as_before_bit_for_bit() -> None:
    mesh, history = organ("shaken"), EditHistory()
    springs = SpringNetwork(mesh, MATERIAL)
    stiffness, fresh = Stiffness(springs), Stiffness(SpringNetwork(organ("shaken"), MATERIAL))
    nodes, cuts = mesh.node_rows, 0

    def apply(edit: TopologyEdit) -> None:
        change = mesh.apply(edit)
        history.record(change)
        springs.follow(change)
        stiffness.follow(change)

    for seed in range(12):
        edit = random_cut(mesh, cut_scenes.rest(mesh), seed)
        if edit is not None:
            apply(edit)
            cuts += 1
    assert cuts > 3
    assert not np.array_equal(stiffness.inverse[:nodes], fresh.inverse[:nodes])
    for step in (history.undo, history.redo, history.undo):
        for _ in range(cuts):
            apply(step(mesh))
    np.testing.assert_array_equal(stiffness.inverse[:nodes], fresh.inverse[:nodes])
    for node in range(nodes):
        np.testing.assert_array_equal(blocks_of(stiffness, node), blocks_of(fresh, node))


def blocks_of(stiffness: Stiffness, node: int) -> NDArray:
    rows = stiffness.rows
    begin = int(rows.start[node])
    return rows.blocks[begin : begin + int(rows.degree[node])]


@pytest.mark.parametrize("name", ["shaken", "connected surfaces"])
def test_in_tissue_deformed_evenly_nodes_go_back_to_where_they_were(name: str) -> None:
    mesh, history = organ(name), EditHistory()
    state = State(mesh, np.float64)
    stretch = np.array([[0.1, 0.05, 0.0], [0.0, -0.1, 0.02], [0.03, 0.0, 0.2]])
    state.displacement[: mesh.node_rows] = mesh.rest[: mesh.node_rows] @ stretch
    before = state.positions(mesh)
    for seed in (2, 11, 14, 17):
        edit = random_cut(mesh, state.positions(mesh).astype(np.float64), 3 * seed)
        if edit is None:
            continue
        assert len(edit.moved_nodes)
        for step in (edit, None):
            change = mesh.apply(step or history.undo(mesh))
            history.record(change)
            state.follow(mesh, change)
        # A triangle knows nothing of places off its plane.
        near = 1e-12 if mesh.sheet_rows is None else 2e-3
        np.testing.assert_allclose(state.positions(mesh)[: len(before)], before, atol=near)
