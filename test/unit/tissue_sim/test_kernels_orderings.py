"""Orderings against networkx-free plain searches."""

from __future__ import annotations

from collections import deque

import numpy as np

from support.elastic_scenes import MATERIAL, NO_ROWS, block_mesh, split_edit, top_ball
from tissue_sim.elastic.ordering import NodeOrdering
from tissue_sim.elastic.spring_ordering import SpringOrdering
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.kernels import orderings
from tissue_sim.kernels.relaxation import REMOVED_LENGTH


def plain_levels(springs: SpringNetwork, sources: list[int], blocked: np.ndarray) -> dict[int, int]:
    neighbours: dict[int, list[int]] = {}
    for a, b in springs.springs.ends[: springs.rows].tolist():
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    level, queue = dict.fromkeys(sources, 0), deque(sources)
    while queue:
        node = queue.popleft()
        for other in neighbours[node]:
            if other not in level and not blocked[other]:
                level[other] = level[node] + 1
                queue.append(other)
    return level


def test_levels_are_distances_along_springs() -> None:
    mesh = block_mesh(6)
    springs = SpringNetwork(mesh, MATERIAL)
    sources = top_ball(mesh)
    prescribed = mesh.fixed.copy()
    prescribed[sources] = True
    ordering = NodeOrdering(springs)
    ordering.search(sources, prescribed)
    expected = plain_levels(springs, sources.tolist(), prescribed)
    assert {int(n): int(ordering.level[n]) for n in ordering.nodes[: ordering.used]} == expected
    levels = ordering.level[ordering.nodes[: ordering.used]]
    assert (np.diff(levels) >= 0).all()
    for level in range(ordering.levels):
        assert ordering.end_of(level) == int((levels <= level).sum())


def test_without_sources_all_free_nodes_come_by_row() -> None:
    mesh = block_mesh(4)
    ordering = NodeOrdering(SpringNetwork(mesh, MATERIAL))
    ordering.search(NO_ROWS, mesh.fixed)
    free = np.flatnonzero(mesh.node_alive & ~mesh.fixed)
    np.testing.assert_array_equal(ordering.nodes[: ordering.used], free)


def test_copies_follow_their_parents_and_springs_their_edit() -> None:
    mesh = block_mesh(7)
    springs = SpringNetwork(mesh, MATERIAL)
    nodes, order = NodeOrdering(springs), SpringOrdering(springs)
    sources = top_ball(mesh)
    nodes.search(sources, mesh.fixed)
    order.order(nodes)
    order.advance()
    change = mesh.apply(split_edit(mesh, 0.03, above=0.02))
    followed = springs.follow(change)
    nodes.follow(change)
    order.follow(followed)
    np.testing.assert_array_equal(
        nodes.rank[change.copied_nodes], nodes.rank[change.copy_parents] + 1
    )
    levels = nodes.level[nodes.nodes[: nodes.used]]
    assert (np.diff(levels) >= 0).all()
    assert nodes.end_of(2) == int((levels <= 2).sum())
    there = order.list.length[: order.used] < REMOVED_LENGTH
    first, second = order.list.first[: order.used][there], order.list.second[: order.used][there]
    listed = {tuple(sorted(pair)) for pair in zip(first.tolist(), second.tolist(), strict=True)}
    alive = springs.springs.alive[: springs.rows]
    ends = springs.springs.ends[: springs.rows][alive]
    free = ends[~mesh.fixed[ends].all(axis=1)]
    assert listed == set(map(tuple, free.tolist()))


def test_copies_are_inserted_as_numpy_inserts_them() -> None:
    rng = np.random.default_rng(7)
    used, added = 50, 12
    nodes = np.zeros(used + added, dtype=np.uint32)
    nodes[:used] = rng.permutation(used)
    copies = np.arange(used, used + added, dtype=np.int32)
    places = np.sort(rng.integers(0, used, added)).astype(np.int32)
    expected = np.insert(nodes[:used], places + 1, copies)
    orderings.insert_behind(copies, places, nodes, used)
    np.testing.assert_array_equal(nodes, expected)


def test_keys_find_places_however_often_the_order_is_changed_at_one_place() -> None:
    rng = np.random.default_rng(11)
    capacity, gone = 400, np.int64(orderings.UNREACHED)
    nodes, key = np.zeros(capacity, dtype=np.uint32), np.full(capacity, gone)
    level, level_start = np.zeros(capacity, dtype=np.int32), np.array([0, 40], dtype=np.int32)
    plain = rng.permutation(40).tolist()
    used = len(plain)
    nodes[:used] = plain
    orderings.number(nodes, used, key)
    for fresh in range(40, capacity - 2, 3):
        # Always behind the same node and behind the last one: there the keys get close first.
        copies = np.arange(fresh, fresh + 3, dtype=np.int32)
        parents = np.array([plain[5], plain[-1], plain[5]], dtype=np.int32)
        for copy, parent in zip(copies[::-1].tolist(), parents[::-1].tolist(), strict=True):
            plain.insert(plain.index(parent) + 1, copy)
        along = np.argsort(key[parents], kind="stable")
        used, _ = orderings.insert_copies(
            copies, parents, along, nodes, used, level, 1, level_start, key
        )
        lost = plain.pop(int(rng.integers(6, len(plain) - 1)))
        place = np.empty(1, dtype=np.int32)
        orderings.find_places(np.array([lost], dtype=np.int32), nodes, used, key, place)
        orderings.take_out(place, nodes, used)
        used, key[lost] = used - 1, gone
        np.testing.assert_array_equal(nodes[:used], plain)
        found = np.empty(used, dtype=np.int32)
        orderings.find_places(nodes[:used].astype(np.int32), nodes, used, key, found)
        np.testing.assert_array_equal(found, np.arange(used))
    assert level_start[1] == 40 + 3 * 120
