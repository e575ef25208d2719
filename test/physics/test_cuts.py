"""What a cut does to springs, masses and forces."""

from __future__ import annotations

import numpy as np
import pytest

from support.elastic_scenes import (
    MATERIAL,
    VARIANTS,
    apply,
    block_mesh,
    build,
    hold,
    release,
    split_edit,
    steps,
    top_ball,
)
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh

ALL = registry.names()
SHORT_STEPS = {"explicit Euler", "Runge-Kutta 2"}
"""Variants of many steps a frame; test_model_switch.py cuts a part of a smaller block free."""


def fresh(mesh: Mesh, dtype: type[np.floating]) -> dict[tuple[int, int], tuple[float, float]]:
    return by_ends(SpringNetwork(mesh, MATERIAL, dtype))


def by_ends(springs: SpringNetwork) -> dict[tuple[int, int], tuple[float, float]]:
    table = springs.springs
    return {
        (int(table.ends[row, 0]), int(table.ends[row, 1])): (
            float(table.stiffness[row]),
            float(table.length[row]),
        )
        for row in np.flatnonzero(table.alive[: springs.rows])
    }


def check_lists(springs: SpringNetwork) -> None:
    """The lists by node say the same as the rows."""
    arrays, table, found = springs.arrays, by_ends(springs), {}
    for node in range(springs.mesh.node_rows):
        begin = int(arrays.start[node])
        for place in range(begin, begin + int(arrays.degree[node])):
            other = int(arrays.neighbour[place])
            found[node, other] = (float(arrays.stiffness[place]), float(arrays.length[place]))
    assert len(found) == 2 * len(table)
    for (a, b), (k, l0) in table.items():
        expected = (float(springs.dtype(k)), float(springs.dtype(l0)))
        assert found[a, b] == found[b, a] == expected


@pytest.mark.parametrize("above", [-np.inf, 0.02])
def test_a_split_shares_out_stiffness_and_mass(above: float) -> None:
    mesh = block_mesh(7)
    springs = SpringNetwork(mesh, MATERIAL)
    k, m, count = springs.springs.stiffness.sum(), springs.masses.sum(), springs.rows
    springs.follow(mesh.apply(split_edit(mesh, 0.03, above)))
    alive = springs.springs.alive[: springs.rows]
    assert alive.sum() > count
    assert springs.springs.stiffness[: springs.rows][alive].sum() == pytest.approx(k, rel=1e-13)
    assert springs.masses.sum() == pytest.approx(m, rel=1e-13)


def test_a_network_that_followed_edits_equals_one_built_afresh_bit_for_bit() -> None:
    mesh = block_mesh(8)
    springs = SpringNetwork(mesh, MATERIAL)
    spacing = 0.06 / 7
    edits = [split_edit(mesh, 3 * spacing, 0.02)]
    springs.follow(mesh.apply(edits[0]))
    springs.follow(mesh.apply(split_edit(mesh, 5 * spacing)))
    springs.follow(mesh.apply(shifted(mesh)))
    springs.follow(mesh.apply(removed(mesh)))
    assert by_ends(springs) == fresh(mesh, np.float32)
    np.testing.assert_array_equal(springs.masses, SpringNetwork(mesh, MATERIAL).masses)
    check_lists(springs)


def test_a_network_without_room_makes_some_and_comes_out_the_same() -> None:
    mesh, twin = block_mesh(8), block_mesh(8)
    springs, roomy = SpringNetwork(mesh, MATERIAL), SpringNetwork(twin, MATERIAL)
    table, lists, rows, used = springs.springs, springs._lists, springs.rows, springs._used
    springs.springs = table._replace(
        ends=table.ends[:rows], stiffness=table.stiffness[:rows],
        length=table.length[:rows], alive=table.alive[:rows],
    )  # fmt: skip
    springs._lists = lists._replace(
        neighbour=lists.neighbour[:used], spring=lists.spring[:used],
        stiffness=lists.stiffness[:used], length=lists.length[:used],
    )  # fmt: skip
    springs._expose()
    edit = split_edit(mesh, 3 * 0.06 / 7, 0.02)
    change = springs.follow(mesh.apply(edit))
    expected = roomy.follow(twin.apply(edit))
    np.testing.assert_array_equal(change.rows, expected.rows)
    np.testing.assert_array_equal(change.kinds, expected.kinds)
    assert by_ends(springs) == by_ends(roomy) == fresh(mesh, np.float32)
    check_lists(springs)


def shifted(mesh: Mesh) -> TopologyEdit:
    """Move the rest position of a few inner nodes, as snapping does."""
    nodes = np.flatnonzero(~mesh.fixed[: mesh.node_rows])[100:110]
    elements = [int(mesh.incident.of(int(node))[0]) for node in nodes]
    anchors = mesh.tets[elements]
    weights = np.where(anchors == nodes[:, None], 0.85, 0.05)
    rest = np.einsum("ij,ijk->ik", weights, mesh.rest[anchors])
    return TopologyEdit(
        mesh.version,
        moved_nodes=nodes.astype(np.uint32),
        moved_rest=rest,
        moved_anchors=anchors.astype(np.uint32),
        moved_weights=weights,
    )


def removed(mesh: Mesh) -> TopologyEdit:
    return TopologyEdit(mesh.version, removed_elements=np.arange(40, 60, dtype=np.uint32))


def test_following_twice_changes_nothing_and_a_gap_is_refused() -> None:
    mesh = block_mesh(5)
    springs = SpringNetwork(mesh, MATERIAL)
    change = mesh.apply(split_edit(mesh, 0.03))
    first = springs.follow(change)
    assert springs.follow(change) is first
    mesh.apply(removed_few(mesh))
    with pytest.raises(
        ValueError, match=r"at version 2 and cannot follow .* version 4; allowed: 3"
    ):
        springs.follow(mesh.apply(removed_few(mesh)))


def removed_few(mesh: Mesh) -> TopologyEdit:
    alive = np.flatnonzero(mesh.element_alive[: mesh.element_rows])[:2]
    return TopologyEdit(mesh.version, removed_elements=alive.astype(np.uint32))


@pytest.mark.parametrize("name", ALL)
def test_the_first_frame_after_a_split_without_motion_across_it_shows_no_force_jump(
    name: str,
) -> None:
    mesh = block_mesh(7)
    model, state = build(name, mesh)
    # Nothing moves at the plane x = 0.03; tissue to its right is displaced.
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    right = mesh.rest[rows, 0] > 0.035
    random = np.random.default_rng(4)
    free = right & ~mesh.fixed[rows]
    state.displacement[rows[free]] = random.normal(0, 5e-4, (int(free.sum()), 3))
    state.previous[:] = state.displacement
    before = model.forces(state, rows)
    edit = split_edit(mesh, 0.03)
    apply(mesh, model, state, edit)
    after = model.forces(state, np.arange(mesh.node_rows, dtype=np.int32))
    parents = edit.copy_parents.astype(int)
    copies = np.arange(len(rows), mesh.node_rows)
    together = after[: len(rows)].copy()
    together[parents] += after[copies]
    np.testing.assert_allclose(together, before, atol=1e-5 * max(np.abs(before).max(), 1e-9))
    assert not state.displacement[copies].any()


@pytest.mark.parametrize("name", ALL)
def test_rest_stays_rest_through_a_cut(name: str) -> None:
    mesh = block_mesh(7)
    model, state = build(name, mesh)
    hold(model, state, top_ball(mesh), mesh)
    steps(model, state, 3)
    apply(mesh, model, state, split_edit(mesh, 0.03, above=0.03))
    steps(model, state, 20)
    assert not state.displacement.any()


@pytest.mark.parametrize("name", ALL)
def test_a_cut_opens_under_tension_and_the_tissue_returns(name: str) -> None:
    mesh = block_mesh(9)
    model, state = build(name, mesh)
    x, spacing = mesh.rest[: mesh.node_rows, 0], 0.06 / 8
    top = mesh.rest[: mesh.node_rows, 2] > 0.059
    left, right = np.flatnonzero(top & (x < 0.2 * spacing)), np.flatnonzero(top & (x > 0.0599))
    hold(model, state, [*left, *right], mesh)
    per_frame = 4 if model.time_step is None else 100
    for frame in range(1, 31):
        state.displacement[left] = [-0.0002 * frame, 0, 0]
        state.displacement[right] = [0.0002 * frame, 0, 0]
        steps(model, state, per_frame)
    edit = split_edit(mesh, 4 * spacing, above=0.03)
    apply(mesh, model, state, edit)
    parents, copies = (
        edit.copy_parents.astype(int),
        np.arange(mesh.node_rows)[-len(edit.copied_nodes) :],
    )
    np.testing.assert_array_equal(state.displacement[copies], state.displacement[parents])
    steps(model, state, 60 * per_frame)
    assert np.isfinite(state.displacement).all()
    opening = np.linalg.norm(state.displacement[copies] - state.displacement[parents], axis=1)
    assert opening.max() > 0.003
    release(model, state, mesh)
    steps(model, state, 120 * per_frame)
    largest = np.abs(state.displacement).max()
    # Relaxation alone stops at its limits.
    assert largest < (0.0012 if name != "relaxation" else 0.006)


@pytest.mark.parametrize("variant", [v for v in VARIANTS if v not in SHORT_STEPS])
def test_a_part_cut_free_neither_drifts_nor_blows_up(variant: str) -> None:
    mesh = block_mesh(7)
    name, parameters = VARIANTS[variant]
    model, state = build(name, mesh, None, None, **parameters)
    held = hold(model, state, top_ball(mesh), mesh)
    per_frame = 4 if model.time_step is None else round(1 / 60 / model.time_step)
    for frame in range(1, 21):
        state.displacement[held] = [0, 0, 0.0002 * frame]
        steps(model, state, per_frame)
    # Cut off everything above the plane z = 0.03 by removing the layer of elements under it.
    points = mesh.rest[mesh.tets[: mesh.element_rows]][:, :, 2]
    layer = (points.min(axis=1) > 0.019) & (points.max(axis=1) < 0.031)
    edit = TopologyEdit(mesh.version, removed_elements=np.flatnonzero(layer).astype(np.uint32))
    apply(mesh, model, state, edit)
    release(model, state, mesh)
    steps(model, state, 300 * per_frame)
    first = state.displacement.copy()
    steps(model, state, 60 * per_frame)
    assert np.isfinite(state.displacement).all()
    assert np.abs(state.displacement).max() < 0.05
    assert np.abs(state.displacement - first).max() < 2e-5
    below = mesh.rest[: mesh.node_rows, 2] < 0.025
    left = np.abs(state.displacement[: mesh.node_rows][below]).max()
    assert left < (5e-5 if name != "relaxation" else 3e-4)


def test_an_edit_grows_every_array_that_is_too_small() -> None:
    mesh = block_mesh(8)
    model, state = build("lr", mesh)
    dynamic, _ = build("spring_mass", mesh, model.springs)  # type: ignore[attr-defined]
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0, 0, 0.002]
    nodes, places = mesh.node_capacity, len(model.springs.arrays.neighbour)  # type: ignore[attr-defined]
    for _ in range(12):
        change = mesh.apply(own_nodes(mesh))
        state.follow(mesh, change)
        model.topology_changed(change, state)
        dynamic.topology_changed(change, state)
        steps(model, state, 2)
        steps(dynamic, state, 2)
    assert mesh.node_capacity > nodes
    assert len(model.springs.arrays.neighbour) > places  # type: ignore[attr-defined]
    check_lists(model.springs)  # type: ignore[attr-defined]
    assert by_ends(model.springs) == fresh(mesh, np.float32)  # type: ignore[attr-defined]
    assert np.isfinite(state.displacement).all()


def own_nodes(mesh: Mesh) -> TopologyEdit:
    """Give elements that share all of their nodes nodes of their own."""
    tets = mesh.tets[: mesh.element_rows]
    shared = (mesh.incident.count[tets] > 1).all(axis=1)
    chosen: list[int] = []
    seen: set[int] = set()
    for element in np.flatnonzero(mesh.element_alive[: mesh.element_rows] & shared).tolist():
        if not seen & set(tets[element].tolist()):
            chosen.append(element)
            seen |= set(tets[element].tolist())
    parents = tets[chosen].ravel()
    new = PROVISIONAL + np.arange(len(parents))
    return TopologyEdit(
        mesh.version,
        copied_nodes=new.astype(np.uint32),
        copy_parents=parents.astype(np.uint32),
        rewritten_elements=np.array(chosen, dtype=np.uint32),
        rewritten_nodes=new.reshape(-1, 4).astype(np.uint32),
    )


def test_state_follows_in_double_precision_too() -> None:
    mesh = block_mesh(5)
    springs = SpringNetwork(mesh, MATERIAL, np.float64)
    state = State(mesh, np.float64)
    model, _ = build("lr", mesh, springs, state)
    apply(mesh, model, state, split_edit(mesh, 0.03))
    steps(model, state, 3)
    assert by_ends(springs) == fresh(mesh, np.float64)
