"""Edits of the versioned mesh: invariants, replicas, staleness, nothing changed on error."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.elastic_scenes import block_mesh, split_edit
from tissue_sim.geometry.edit import PROVISIONAL, EditError, StaleEditError, TopologyEdit
from tissue_sim.geometry.incidence import Incidence
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.geometry.shapes import block

RAW = block(4, 4, 4, 0.03, 0.03, 0.03)
ARRAYS = (
    "rest", "fixed", "node_ids", "node_file_ids", "node_parents", "node_alive", "node_versions",
    "tets", "element_ids", "element_file_ids", "element_alive", "element_versions", "regions",
)  # fmt: skip


def fresh(spare: float = 0.25) -> Mesh:
    return Mesh(RAW, RAW.points[:, 2] == 0, spare)


def same(a: Mesh, b: Mesh) -> bool:
    rows = {"node": (a.node_rows, b.node_rows), "element": (a.element_rows, b.element_rows)}
    if a.version != b.version or any(x != y for x, y in rows.values()):
        return False
    for name in ARRAYS:
        one, other = getattr(a, name), getattr(b, name)
        is_element = name.startswith("element") or name in ("tets", "regions")
        count = a.element_rows if is_element else a.node_rows
        if not np.array_equal(one[:count], other[:count]):
            return False
    lists = range(a.node_rows)
    return all(np.array_equal(a.incident.of(n), b.incident.of(n)) for n in lists)


def volume(mesh: Mesh) -> float:
    alive = mesh.element_alive[: mesh.element_rows]
    return float(signed_volumes(mesh.rest, mesh.tets[: mesh.element_rows][alive]).sum())


def check_invariants(mesh: Mesh) -> None:
    alive = mesh.element_alive[: mesh.element_rows]
    tets = mesh.tets[: mesh.element_rows]
    lists = Incidence.build(tets, alive, mesh.node_capacity)
    for node in range(mesh.node_rows):
        assert np.array_equal(mesh.incident.of(node), lists.of(node))
    used = np.zeros(mesh.node_rows, dtype=bool)
    used[tets[alive]] = True
    assert np.array_equal(used, mesh.node_alive[: mesh.node_rows])
    assert (signed_volumes(mesh.rest, tets[alive]) > 0).all()
    assert not mesh.node_alive[mesh.node_rows :].any()
    assert not mesh.element_alive[mesh.element_rows :].any()
    assert mesh.node_versions[: mesh.node_rows].max() <= mesh.version
    assert mesh.element_versions[: mesh.element_rows].max() <= mesh.version
    copies = np.flatnonzero(mesh.node_file_ids[: mesh.node_rows] == -1)
    assert np.array_equal(mesh.fixed[copies], mesh.fixed[mesh.node_parents[copies]])


def random_edit(mesh: Mesh, random: np.random.Generator) -> TopologyEdit:
    """Copies nodes for one side of a plane, removes some elements and moves a node."""
    elements = np.flatnonzero(mesh.element_alive[: mesh.element_rows])
    removed = random.permutation(elements)[: random.integers(0, 3)]
    nodes = np.flatnonzero(mesh.node_alive[: mesh.node_rows])
    middle = mesh.rest[random.choice(nodes)]
    normal = random.standard_normal(3)
    parents = random.permutation(nodes)[: random.integers(1, 12)]
    side = (mesh.rest[mesh.tets[elements]].mean(axis=1) - middle) @ normal > 0
    at_parents = np.isin(mesh.tets[elements], parents).any(axis=1)
    rewritten = elements[side & at_parents & ~np.isin(elements, removed)]
    parents = parents[np.isin(parents, mesh.tets[rewritten])]
    copy_of = {int(p): PROVISIONAL + k for k, p in enumerate(parents)}
    renamed = [[copy_of.get(n, n) for n in tet] for tet in mesh.tets[rewritten].tolist()]
    loose = np.flatnonzero(~mesh.fixed[: mesh.node_rows] & mesh.node_alive[: mesh.node_rows])
    moved = random.choice(loose, 1)
    anchors = mesh.tets[mesh.incident.of(int(moved[0]))[:1]]
    return TopologyEdit(
        base_version=mesh.version,
        read_nodes=parents.astype(np.uint32),
        read_elements=rewritten.astype(np.uint32),
        moved_nodes=moved.astype(np.uint32),
        moved_rest=mesh.rest[moved] + 2e-5 * random.standard_normal((1, 3)),
        moved_anchors=anchors.astype(np.uint32),
        moved_weights=(anchors == moved[0]).astype(float),
        copied_nodes=np.arange(len(parents), dtype=np.uint32) + np.uint32(PROVISIONAL),
        copy_parents=parents.astype(np.uint32),
        rewritten_elements=rewritten.astype(np.uint32),
        rewritten_nodes=np.array(renamed, dtype=np.uint32).reshape(-1, 4),
        removed_elements=removed.astype(np.uint32),
    )


def split(mesh: Mesh) -> TopologyEdit:
    """Cuts the block in two halves at x = 0.01: nothing but copies and rewritten elements."""
    rows = mesh.tets[: mesh.element_rows]
    right = np.flatnonzero(mesh.rest[rows].mean(axis=1)[:, 0] > 0.01)
    left = np.setdiff1d(np.arange(mesh.element_rows), right)
    parents = np.intersect1d(rows[right], rows[left])
    copies = {int(p): PROVISIONAL + k for k, p in enumerate(parents)}
    renamed = [[copies.get(n, n) for n in tet] for tet in rows[right].tolist()]
    return TopologyEdit(
        base_version=mesh.version,
        read_nodes=parents.astype(np.uint32),
        read_elements=right.astype(np.uint32),
        copied_nodes=np.array(list(copies.values()), dtype=np.uint32),
        copy_parents=parents.astype(np.uint32),
        rewritten_elements=right.astype(np.uint32),
        rewritten_nodes=np.array(renamed, dtype=np.uint32),
    )


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.25]))
def test_edits_keep_the_invariants_and_replicas_equal(seed: int, spare: float) -> None:
    random = np.random.default_rng(seed)
    mesh = fresh(spare)
    assert mesh.apply(random_edit(mesh, random)).edit.version == 2
    replica = copy.deepcopy(mesh)
    for _ in range(6):
        before = copy.deepcopy(mesh)
        edit = random_edit(mesh, random)
        try:
            change = mesh.apply(edit)
        except EditError:
            assert same(mesh, before)
            continue
        assert mesh.version == before.version + 1 == change.edit.version
        check_invariants(mesh)
        check_change_lists_what_changed(before, mesh, change.nodes, change.elements)
        replica.apply(change.edit)
        assert same(mesh, replica)


def check_change_lists_what_changed(
    before: Mesh, after: Mesh, nodes: np.ndarray, elements: np.ndarray
) -> None:
    for node in range(after.node_rows):
        is_new = node >= before.node_rows
        changed = is_new or not np.array_equal(after.incident.of(node), before.incident.of(node))
        changed = changed or not np.array_equal(after.rest[node], before.rest[node])
        assert not changed or node in nodes
        assert (after.node_versions[node] == after.version) == (node in nodes)
    count = before.element_rows
    changed_rows = np.flatnonzero(
        (after.tets[:count] != before.tets[:count]).any(axis=1)
        | (after.element_alive[:count] != before.element_alive[:count])
    )
    assert np.isin(changed_rows, elements).all()


def test_copying_nodes_changes_no_volume_and_keeps_ids() -> None:
    mesh = fresh()
    before = volume(mesh)
    change = mesh.apply(split(mesh))
    assert volume(mesh) == before
    copies = change.copied_nodes
    assert len(copies) == 16
    assert np.array_equal(mesh.rest[copies], mesh.rest[change.copy_parents])
    assert np.array_equal(mesh.node_parents[copies], mesh.node_ids[change.copy_parents])
    assert (mesh.node_file_ids[copies] == -1).all()
    assert mesh.node_rows_of(mesh.node_ids[copies]).tolist() == copies.tolist()
    assert mesh.fixed[copies].sum() == 4
    check_invariants(mesh)


def test_capacity_grows_and_keeps_everything() -> None:
    mesh, roomy = fresh(), fresh(spare=50.0)
    random = np.random.default_rng(0)
    start = mesh.element_capacity
    while mesh.element_capacity == start:
        element = random.choice(np.flatnonzero(mesh.element_alive[: mesh.element_rows]))
        corners = mesh.tets[element]
        edit = TopologyEdit(
            base_version=mesh.version,
            copied_nodes=np.uint32(PROVISIONAL) + np.arange(40, dtype=np.uint32),
            copy_parents=np.tile(corners, 10).astype(np.uint32),
            removed_elements=np.array([element], dtype=np.uint32),
            added_elements=np.uint32(PROVISIONAL) + np.arange(10, dtype=np.uint32),
            added_nodes=np.uint32(PROVISIONAL) + np.arange(40, dtype=np.uint32).reshape(10, 4),
            added_parents=np.full(10, element, dtype=np.uint32),
        )
        mesh.apply(edit)
        roomy.apply(edit)
    assert mesh.node_capacity > fresh().node_capacity
    assert same(mesh, roomy)
    check_invariants(mesh)


def test_a_plan_is_stale_only_if_something_it_has_read_has_changed() -> None:
    mesh = fresh()
    plan = split(mesh)
    far = int(np.argmax(mesh.rest[: mesh.node_rows] @ [1.0, 1.0, 1.0]))
    element = int(mesh.incident.of(far)[0])
    touches = bool(np.isin(element, plan.read_elements.astype(int)))
    mesh.apply(TopologyEdit(mesh.version, removed_elements=np.array([element], dtype=np.uint32)))
    assert touches
    with pytest.raises(StaleEditError, match="that the plan has read"):
        mesh.apply(plan)

    mesh = fresh()
    plan = split(mesh)
    untouched = np.setdiff1d(np.arange(mesh.element_rows), plan.read_elements)
    reads = set(plan.read_nodes.tolist())
    away = [e for e in untouched.tolist() if not reads & set(mesh.tets[e].tolist())]
    mesh.apply(TopologyEdit(1, removed_elements=np.array(away[:1], dtype=np.uint32)))
    assert mesh.apply(plan).edit.version == 3
    with pytest.raises(StaleEditError, match="planned on version 9; the tissue is at 3"):
        mesh.apply(replace(plan, base_version=9))


BAD: dict[str, tuple[str, Callable[[TopologyEdit], TopologyEdit]]] = {
    "unknown element": (
        "rewritten element that is not there: id .99999.",
        lambda e: replace(e, rewritten_elements=with_first(e.rewritten_elements, 99999)),
    ),
    "unknown node": (
        "node that is not there",
        lambda e: replace(e, rewritten_nodes=with_first(e.rewritten_nodes, 88888)),
    ),
    "copy that is not in the list": (
        "node that is not there",
        lambda e: replace(e, rewritten_nodes=with_first(e.rewritten_nodes, PROVISIONAL + 400)),
    ),
    "twice": (
        "rewritten or removed twice",
        lambda e: replace(e, removed_elements=e.rewritten_elements[:1]),
    ),
    "wrong ids": (
        "ids must count up",
        lambda e: replace(e, copied_nodes=e.copied_nodes + np.uint32(1)),
    ),
    "inverted element": (
        "no positive rest volume",
        lambda e: replace(e, rewritten_nodes=e.rewritten_nodes[:, [1, 0, 2, 3]]),
    ),
    "loose copy": (
        "belong to no element|not there",
        lambda e: replace(e, rewritten_elements=e.rewritten_elements[:1],
                          rewritten_nodes=e.rewritten_nodes[:1]),
    ),
    "shapes": (
        "copy_parents has shape",
        lambda e: replace(e, copy_parents=e.copy_parents[1:]),
    ),
    "fixed node": (
        "fixed nodes cannot be moved: id .0.",
        lambda e: moving(e, 0, np.zeros(3)),
    ),
    "not finite": (
        "not finite",
        lambda e: moving(e, 63, np.full(3, np.nan)),
    ),
    "inverting move": (
        "no positive rest volume",
        lambda e: moving(e, 63, np.array([-0.03, -0.03, -0.03])),
    ),
}  # fmt: skip


def with_first(array: np.ndarray, value: int) -> np.ndarray:
    array = array.copy()
    array.flat[0] = value
    return array


def moving(edit: TopologyEdit, node: int, place: np.ndarray) -> TopologyEdit:
    return replace(
        edit,
        moved_nodes=np.array([node], dtype=np.uint32),
        moved_rest=place[None],
        moved_anchors=np.full((1, 4), node, dtype=np.uint32),
        moved_weights=np.array([[1.0, 0, 0, 0]]),
    )


@pytest.mark.parametrize("name", BAD)
def test_a_bad_edit_is_refused_and_changes_nothing(name: str) -> None:
    message, spoil = BAD[name]
    mesh = fresh()
    before = copy.deepcopy(mesh)
    with pytest.raises(EditError, match=message):
        mesh.apply(spoil(split(mesh)))
    assert same(mesh, before)
    assert not mesh.rest[mesh.node_rows :].any()
    mesh.apply(split(mesh))


def test_removed_nodes_and_elements_are_unknown_afterwards() -> None:
    mesh = fresh()
    node = int(np.argmin(mesh.incident.count[: mesh.node_rows]))
    ids = mesh.incident.of(node).astype(np.uint32)
    mesh.apply(TopologyEdit(1, removed_elements=ids))
    assert mesh.node_rows_of(np.array([node], dtype=np.uint32)).tolist() == [-1]
    assert (mesh.element_rows_of(ids) == -1).all()
    check_invariants(mesh)
    with pytest.raises(EditError, match="removed element that is not there"):
        mesh.apply(TopologyEdit(2, removed_elements=ids[:1]))


def test_incident_lists_do_not_depend_on_history() -> None:
    lists = Incidence.build(np.array([[0, 1], [1, 2], [0, 2]], np.int32), np.ones(3, bool), 4)
    lists.remove(0, 0)
    for item in (9, 0, 5, 7, 3, 8, 1):
        lists.add(0, item)
    assert lists.of(0).tolist() == [0, 1, 2, 3, 5, 7, 8, 9]
    with pytest.raises(KeyError, match="item 6 does not meet node row 0"):
        lists.remove(0, 6)


def test_what_was_checked_before_is_applied_alike_and_checked_again_after_another_edit() -> None:
    mesh, twin = block_mesh(6), block_mesh(6)
    first, second = split_edit(mesh, 0.024), split_edit(mesh, 0.048)
    checked = mesh.check(first)
    assert mesh.version == 1
    change, other = mesh.apply(first, checked), twin.apply(first)
    for name in ("nodes", "elements", "new_elements", "copied_nodes", "neighbours"):
        np.testing.assert_array_equal(getattr(change, name), getattr(other, name))
    np.testing.assert_array_equal(mesh.tets, twin.tets)
    np.testing.assert_array_equal(mesh.rest, twin.rest)
    # Checked on version 1, where its copies would have had other rows.
    outdated = twin.check(split_edit(twin, 0.012))
    twin.apply(second)
    mesh.apply(second)
    twin.apply(outdated.edit, outdated)
    mesh.apply(outdated.edit)
    np.testing.assert_array_equal(mesh.tets, twin.tets)
    np.testing.assert_array_equal(mesh.rest, twin.rest)
