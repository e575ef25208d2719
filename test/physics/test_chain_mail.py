"""ChainMail on mesh edges keeps its limits, moves nothing that need not move, and relaxes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from support.elastic_scenes import (
    MATERIAL,
    apply,
    ball,
    block_mesh,
    build,
    double,
    hold,
    release,
    split_edit,
    steps,
    top_ball,
    wall_mesh,
)
from tissue_sim.elastic.chain_mail import ChainMail
from tissue_sim.elastic.model import Model, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh


def chain_mail(mesh: Mesh, **values: float) -> tuple[ChainMail, State]:
    springs, state = double(mesh)
    model, _ = build("chain_mail", mesh, springs, state, **values)
    assert isinstance(model, ChainMail)
    return model, state


def edges(model: Model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends of the edges, and how far w may be below zero and above it [m]."""
    assert isinstance(model, ChainMail)
    springs = model.springs
    ends = springs.springs.ends[: springs.rows][springs.springs.alive[: springs.rows]]
    D = model.mesh.rest[ends[:, 1]] - model.mesh.rest[ends[:, 0]]
    along = np.abs(D)
    across = model.values["shear"] * (along.sum(axis=1, keepdims=True) - along)
    stretch, compression = (
        model.values["stretch"] * along + across,
        model.values["compression"] * along + across,
    )
    return (
        ends, np.where(D >= 0, compression, stretch), np.where(D >= 0, stretch, compression),
    )  # fmt: skip


def beyond(model: Model, state: State) -> tuple[float, float]:
    """How far the worst edge between free nodes, and the worst of all, is beyond its limits [m]."""
    ends, below, above = edges(model)
    w = state.displacement[ends[:, 1]] - state.displacement[ends[:, 0]]
    excess = np.maximum(w - above, -w - below).max(axis=1)
    free = ~state.prescribed[ends].any(axis=1)
    return float(excess[free].max()), float(excess.max())


def bounds(model: Model, state: State, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """L and U of every node by an independent shortest-path search, shape (rows, 3) each."""
    ends, below, above = edges(model)
    rows, fixed = model.mesh.node_rows, np.flatnonzero(model.mesh.fixed)  # type: ignore[attr-defined]
    sources = np.concatenate([held, fixed])
    L, U = np.empty((rows, 3)), np.empty((rows, 3))
    first, second = ends.T
    ways = np.concatenate([first, second]), np.concatenate([second, first])
    # Nothing gets past a node that does not move.
    enters = ~state.prescribed[ways[1]]
    for axis in range(3):
        for out, fall, rise in ((L, below, above), (U, above, below)):
            # From i to j the bound from below falls by `below`, from j to i by `above`.
            lengths = np.concatenate([fall[:, axis], rise[:, axis]])
            graph = coo_array(
                (lengths[enters], (ways[0][enters], ways[1][enters])), shape=(rows, rows)
            )
            way = dijkstra(graph.tocsr(), indices=sources)
            at = state.displacement[sources, axis][:, None]
            out[:, axis] = (at - way).max(axis=0) if out is L else (at + way).min(axis=0)
    return L, U


def row_of_tetrahedra(links: int) -> Mesh:
    """A row of nodes along x, each link with a tetrahedron of two nodes of its own."""
    row = np.stack([np.arange(links + 1), np.zeros(links + 1), np.zeros(links + 1)], axis=1)
    side = row[:-1] + np.array([0.5, 0.4, 0.0])
    up = row[:-1] + np.array([0.5, 0.0, 0.4])
    k = np.arange(links)
    tets = np.stack([k, k + 1, links + 1 + k, 2 * links + 1 + k], axis=1)
    points = np.concatenate([row, side, up]) * 0.01
    return Mesh(RawMesh(points, tets.astype(np.int64)), np.zeros(len(points), dtype=np.bool_))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_pulled_chain_gives_its_slack_link_by_link(sign: int) -> None:
    mesh = row_of_tetrahedra(10)
    share = {"stretch": 0.2, "compression": 0.1, "shear": 0.5}
    model, state = chain_mail(mesh, relaxations=0, **share)
    hold(model, state, [10], mesh)
    state.displacement[10, 0] = sign * 0.0075
    model.step(state)
    slack = 0.01 * (share["stretch"] if sign > 0 else share["compression"])
    expected = sign * np.maximum(0.0075 - slack * np.arange(11)[::-1], 0)
    np.testing.assert_allclose(state.displacement[:11, 0], expected, atol=1e-15)
    assert not state.displacement[:, 1:].any()


@pytest.mark.parametrize(
    ("mesh", "small"), [(block_mesh(6), 100), (wall_mesh(), 400)], ids=["block", "wall"]
)
def test_every_node_goes_as_far_as_an_independent_search_says_and_no_farther(
    mesh: Mesh, small: float
) -> None:
    model, state = chain_mail(mesh, shear=0.2, relaxations=0)
    random = np.random.default_rng(3)
    points = mesh.rest[: mesh.node_rows]
    size = np.ptp(points, axis=0).max()
    free = np.flatnonzero(~mesh.fixed[: mesh.node_rows])
    feasible: list[bool] = []
    for turn in range(6):
        held = hold(model, state, ball(mesh, points[random.choice(free)], size / 8), mesh)
        model.step(state)
        state.displacement[held] += random.normal(0, size / (small, 15)[turn % 2], 3)
        before = state.displacement.copy()
        L, U = bounds(model, state, held)
        middle = (L + U) / 2
        rows = mesh.node_rows
        expected = np.clip(before[:rows], np.minimum(L, middle), np.maximum(U, middle))
        still = state.prescribed[:rows]
        expected[still] = before[:rows][still]
        model.step(state)
        np.testing.assert_allclose(state.displacement[:rows], expected, atol=1e-12)
        needless = ((before[:rows] >= L) & (before[:rows] <= U)).all(axis=1)
        np.testing.assert_array_equal(state.displacement[:rows][needless], before[:rows][needless])
        assert beyond(model, state)[0] < 1e-12
        feasible.append(bool((L <= U + 1e-12).all()))
        if feasible[-1]:
            assert beyond(model, state)[1] < 1e-12
    assert {*feasible} == {False, True}


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 124), st.floats(0.01, 0.03),
            st.tuples(*[st.floats(-0.03, 0.03)] * 3), st.booleans(),
        ),
        min_size=1, max_size=6,
    ),
    st.sampled_from([np.float32, np.float64]),
)  # fmt: skip
def test_limits_hold_after_any_pulls_with_relaxation(
    pulls: list[tuple[int, float, tuple[float, float, float], bool]], dtype: type[np.floating]
) -> None:
    mesh = block_mesh(5)
    springs, state = SpringNetwork(mesh, MATERIAL, dtype), State(mesh, dtype)
    model, _ = build("chain_mail", mesh, springs, state, relaxations=2)
    tolerance = 2e-8 if dtype is np.float32 else 1e-14
    for node, radius, pull, let_go in pulls:
        held = hold(model, state, ball(mesh, mesh.rest[node], radius), mesh)
        state.displacement[held] = pull
        for _ in range(3):
            model.step(state)
            assert beyond(model, state)[0] < tolerance
        if let_go:
            release(model, state, mesh)
            for _ in range(3):
                model.step(state)
                assert max(beyond(model, state)) < tolerance


def test_the_result_does_not_depend_on_the_order_of_nodes_or_sources() -> None:
    mesh = block_mesh(6)
    order = np.random.default_rng(1).permutation(mesh.node_rows)
    back = np.argsort(order)
    mixed = Mesh(
        RawMesh(mesh.rest[order], back[mesh.tets[: mesh.element_rows]].astype(np.int64)),
        mesh.fixed[order],
    )
    results = []
    for each, rows in ((mesh, np.arange(mesh.node_rows)), (mixed, back)):
        springs = SpringNetwork(each, MATERIAL, np.float32)
        model, state = build("chain_mail", each, springs, relaxations=0)
        held = np.sort(rows[top_ball(mesh)])
        hold(model, state, held, each)
        for way in ([0.004, 0, 0.01], [-0.003, 0.002, 0.02], [0, 0, -0.004]):
            state.displacement[held] = way
            model.step(state)
        results.append(state.displacement[rows])
    assert (results[0] != 0).any(axis=1).sum() > 100
    np.testing.assert_array_equal(results[0], results[1])


def test_a_small_pull_visits_only_what_moves_each_once() -> None:
    mesh = block_mesh(12)
    model, state = chain_mail(mesh, relaxations=0)
    held = hold(model, state, top_ball(mesh), mesh)
    model.step(state)
    before = state.displacement.copy()
    state.displacement[held] = [0, 0, 0.006]
    model.step(state)
    moved = (state.displacement != before).any(axis=1)
    moved[held] = False
    assert 20 < moved.sum() < 0.2 * mesh.node_rows
    # Held nodes bound from below and from above along each axis; the others one way, along z.
    assert model.visits == moved.sum() + 6 * len(held)
    assert not state.displacement[~moved & ~state.prescribed].any()


def test_what_is_pulled_beyond_all_limits_shows_half_of_it_at_either_end() -> None:
    mesh = row_of_tetrahedra(10)
    mesh.fixed[0] = True
    model, state = chain_mail(mesh, stretch=0.2, relaxations=0)
    hold(model, state, [10], mesh)
    state.displacement[10, 0] = 0.06
    model.step(state)
    links = np.diff(state.displacement[:11, 0])
    np.testing.assert_allclose(links[1:-1], 0.002, atol=1e-15)
    np.testing.assert_allclose(links[[0, -1]], 0.002 + (0.06 - 0.02) / 2, atol=1e-15)
    state.displacement[10, 0] = 0.015
    model.step(state)
    assert beyond(model, state)[1] < 1e-15


def test_nothing_crosses_a_cut() -> None:
    mesh = block_mesh(7)
    model, state = chain_mail(mesh, relaxations=0)
    points = mesh.rest[: mesh.node_rows].copy()
    layer = np.abs(mesh.rest[mesh.tets[: mesh.element_rows]][:, :, 0].mean(axis=1) - 0.035) < 0.005
    edit = TopologyEdit(mesh.version, removed_elements=np.flatnonzero(layer).astype(np.uint32))
    apply(mesh, model, state, edit)
    held = hold(model, state, ball(mesh, np.array([0.06, 0.03, 0.06]), 0.012), mesh)
    state.displacement[held] = [0.05, 0.02, 0.03]
    model.step(state)
    assert not state.displacement[: len(points)][points[:, 0] < 0.035].any()
    assert (state.displacement[: len(points)][points[:, 0] > 0.041] != 0).mean() > 0.5


def test_limits_hold_at_once_on_both_sides_of_a_split_under_tension() -> None:
    mesh = block_mesh(7)
    model, state = chain_mail(mesh)
    held = hold(model, state, top_ball(mesh), mesh)
    for frame in range(1, 11):
        state.displacement[held] = [0.001 * frame, 0, 0.001 * frame]
        steps(model, state, 2)
    apply(mesh, model, state, split_edit(mesh, 0.03, above=0.02))
    for _ in range(10):
        model.step(state)
        assert max(beyond(model, state)) < 1e-14
    copies = slice(7**3, mesh.node_rows)
    assert not model.idle
    assert np.isfinite(state.displacement[copies]).all()


def test_it_follows_a_mesh_that_outgrows_its_arrays() -> None:
    mesh = block_mesh(7)
    model, state = chain_mail(mesh)
    held = hold(model, state, top_ball(mesh), mesh)
    capacity, layer = mesh.node_capacity, 0
    while mesh.node_capacity == capacity:
        layer += 1
        apply(mesh, model, state, pieces(mesh))
        state.displacement[held] = [0, 0, 0.002 * layer]
        steps(model, state, 3)
        assert max(beyond(model, state)) < 1e-14
    release(model, state, mesh)
    steps(model, state, 3)
    assert beyond(model, state)[0] < 1e-14


def pieces(mesh: Mesh) -> TopologyEdit:
    """Give every fifth element nodes of its own."""
    chosen = np.flatnonzero(mesh.element_alive[: mesh.element_rows])[::5]
    parents = mesh.tets[chosen].ravel()
    new = PROVISIONAL + np.arange(len(parents))
    return TopologyEdit(
        mesh.version,
        copied_nodes=new.astype(np.uint32),
        copy_parents=parents.astype(np.uint32),
        rewritten_elements=chosen.astype(np.uint32),
        rewritten_nodes=new.reshape(-1, 4).astype(np.uint32),
    )


@pytest.mark.parametrize("mesh", [block_mesh(9), wall_mesh()], ids=["block", "wall"])
def test_released_tissue_is_within_5_percent_of_rest_after_120_steps(mesh: Mesh) -> None:
    model, state = build("chain_mail", mesh)
    size = np.ptp(mesh.rest[: mesh.node_rows], axis=0).max()
    held = hold(model, state, top_ball(mesh, size / 6), mesh)
    for frame in range(1, 31):
        state.displacement[held] = [0.002 * size * frame, 0, 0.005 * size * frame]
        model.step(state)
    peak = np.abs(state.displacement).max()
    release(model, state, mesh)
    steps(model, state, 120)
    assert np.abs(state.displacement).max() < 0.05 * peak
    steps(model, state, 1500)
    assert model.idle
    assert np.abs(state.displacement).max() < 1e-6


def test_a_hold_dragged_through_the_organ_and_out_leaves_finite_tissue_that_returns() -> None:
    mesh = block_mesh(8)
    model, state = build("chain_mail", mesh)
    held = hold(model, state, top_ball(mesh), mesh)
    down = np.concatenate([np.linspace(0, -0.12, 30), np.linspace(-0.12, 0.06, 30)])
    for frame, z in enumerate(down):
        # 60 frames a second, 1 m/s sideways at the end.
        state.displacement[held] = [max(0, frame - 30) / 60, 0, z]
        steps(model, state, 4)
        assert np.isfinite(state.displacement).all()
        assert beyond(model, state)[0] < 1e-6
    peak = np.abs(state.displacement).max()
    release(model, state, mesh)
    steps(model, state, 300)
    assert np.abs(state.displacement).max() < 0.005 * peak


def test_without_relaxation_it_stays_as_it_was_left_and_is_idle() -> None:
    mesh = block_mesh(6)
    model, state = build("chain_mail", mesh, relaxations=0)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0, 0, 0.01]
    model.step(state)
    release(model, state, mesh)
    before = state.displacement.copy()
    steps(model, state, 5)
    np.testing.assert_array_equal(state.displacement, before)
    assert before.any()
    assert model.idle


@pytest.mark.parametrize("rate", [0.5, 1.9])
def test_no_sweep_takes_neighbours_farther_from_each_other_in_the_sum(rate: float) -> None:
    mesh = block_mesh(6)
    model, state = chain_mail(mesh, rate=rate)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0.004, 0, 0.012]
    ends, _, _ = edges(model)
    sums = []
    for _ in range(40):
        model.step(state)
        w = state.displacement[ends[:, 1]] - state.displacement[ends[:, 0]]
        sums.append(float((w**2).sum()))
    assert (np.diff(sums) <= 1e-12 * sums[0]).all()


def test_a_held_pull_ends_where_every_node_is_at_its_neighbours_mean_or_a_limit() -> None:
    mesh = block_mesh(6)
    model, state = chain_mail(mesh, rest_tolerance=1e-10)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0.001, 0, 0.004]
    while not model.idle or not state.displacement[: mesh.node_rows].any():
        model.step(state)
    ends, below, above = edges(model)
    rows = mesh.node_rows
    w = state.displacement[ends[:, 1]] - state.displacement[ends[:, 0]]
    total, at_limit = np.zeros((rows, 3)), np.zeros((rows, 3), dtype=np.bool_)
    np.add.at(total, ends[:, 0], w)
    np.add.at(total, ends[:, 1], -w)
    tight = (w > above - 1e-9) | (-w > below - 1e-9)
    for end in range(2):
        np.logical_or.at(at_limit, ends[:, end], tight)
    free = ~state.prescribed[:rows, None] & ~at_limit
    assert free.mean() > 0.5
    assert np.abs(total[free]).max() < 1e-8


def test_a_turned_organ_turns_back_which_is_a_limit_of_the_model() -> None:
    mesh = block_mesh(5, fixed=False)
    model, state = chain_mail(mesh)
    rows = np.arange(mesh.node_rows)
    c, s = np.cos(1.0), np.sin(1.0)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    state.displacement[rows] = mesh.rest[rows] @ turn.T - mesh.rest[rows]
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    steps(model, state, 500)
    spread = np.ptp(state.displacement[rows], axis=0)
    assert spread.max() < 1e-6
