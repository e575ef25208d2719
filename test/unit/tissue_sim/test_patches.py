"""Patches in edits: refused, undone, made again, replayed, saved, followed, cut and sewn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from numpy.typing import NDArray

from cut_service.organ import Organ, organ_of
from cut_service.planner import plan
from cut_service.suturing import Sewing, plan_sewing
from support.cut_sheets import plane_x
from support.elastic_scenes import MATERIAL, block_mesh
from support.patches import SOFT, patch_edit
from support.sheets import connected
from support.small_block import pose_of, tool_at
from support.split_edit import split_at
from support.valid_mesh import check_valid
from tissue_sim import conversions, edit_messages, snapshot
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.frame import Answer, Budget, Command, Frame, FrameInputs, JournalEntry, ToolSample
from tissue_sim.geometry.edit import NO_PARENT, PROVISIONAL, EditError, TopologyEdit
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.patches import Patch, Patches, checked_patches
from tissue_sim.geometry.sheet import CONNECTING, SURFACE
from tissue_sim.journal import replay
from tissue_sim.replica import Replica
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

ABOVE = (0.01, 0.01, 0.07)
"""Where the patches of these tests lie: above the organs [m]."""

ORGANS: dict[str, Callable[[], Mesh]] = {
    "tetrahedra": lambda: block_mesh(4),
    "connected surfaces": lambda: connected(fixed=True),
}


def ids(*values: int) -> NDArray[np.uint32]:
    return np.array(values, dtype=np.uint32)


def picture(mesh: Mesh) -> dict[str, Any]:
    """All of a mesh that lives, in the order of rows."""
    nodes = np.flatnonzero(mesh.node_alive[: mesh.node_rows])
    elements = np.flatnonzero(mesh.element_alive[: mesh.element_rows])
    found: dict[str, Any] = {
        "nodes": nodes,
        "elements": elements,
        "rest": mesh.rest[nodes],
        "fixed": mesh.fixed[nodes],
        "parents": mesh.node_parents[nodes],
        "tets": mesh.tets[elements],
        "regions": mesh.regions[elements],
        "fibres": mesh.fibres[elements],
        "incident": np.concatenate([mesh.incident.of(int(node)) for node in nodes]),
        "names": dict(mesh.region_names),
        "patches": mesh.patches.items,
        "sutures": mesh.sutures.nodes,
    }
    if mesh.sheet_rows is not None:
        rows = mesh.sheet_rows
        found |= {"kinds": rows.kinds[elements], "tissue": rows.tissue[elements]}
    return found


def assert_same(one: dict[str, Any], other: dict[str, Any]) -> None:
    for name, value in one.items():
        np.testing.assert_array_equal(value, other[name], err_msg=name)


@pytest.mark.parametrize("organ", ORGANS)
def test_a_patch_is_a_part_of_its_own_with_an_id_and_a_region(organ: str) -> None:
    mesh = ORGANS[organ]()
    nodes = int(mesh.node_alive.sum())
    change = mesh.apply(patch_edit(mesh, ABOVE))
    (patch,) = mesh.patches
    assert patch == replace(SOFT, id=1, label=patch.label, name="patch 1")
    assert mesh.region_names[patch.label] == "patch 1"
    assert change.edit.added_patches == (patch,)
    born = change.born_nodes
    assert len(born) == 40
    assert mesh.node_alive.sum() == nodes + 40
    np.testing.assert_array_equal(mesh.rest[born], change.edit.born_rest)
    np.testing.assert_array_equal(mesh.node_parents[born], born)
    assert not mesh.fixed[born].any()
    made = mesh.element_rows_of(change.edit.added_elements)
    assert (mesh.regions[made] == patch.label).all()
    assert (mesh.regions == patch.label).sum() == len(made)
    assert np.isin(mesh.tets[made], [-1, *born]).all()
    if mesh.sheet_rows is None:
        assert check_valid(mesh).components == 2
    else:
        kinds = mesh.sheet_rows.kinds[made]
        assert (kinds == SURFACE).sum() == 48
        assert (kinds == CONNECTING).sum() == 20


def test_ids_and_labels_of_patches_are_never_used_again() -> None:
    mesh, history = block_mesh(3), EditHistory()
    history.record(mesh.apply(patch_edit(mesh, ABOVE)))
    first = mesh.patches.items[0]
    history.record(mesh.apply(history.undo(mesh)))
    assert not mesh.patches
    assert first.label not in mesh.region_names
    history.record(mesh.apply(patch_edit(mesh, ABOVE, patch=replace(SOFT, name="pericardium"))))
    (second,) = mesh.patches
    assert (second.id, second.name) == (2, "pericardium")
    assert second.label != first.label
    assert mesh.patches.get(2) is mesh.patches.of_label(second.label) is second


def changed(plan: TopologyEdit, name: str, *values: Any) -> TopologyEdit:
    """A plan one of whose arrays has other values at its beginning."""
    array = getattr(plan, name).copy()
    array[: len(values)] = values
    return replace(plan, **{name: array})


def without(plan: TopologyEdit, *names: str, last: int = 1) -> TopologyEdit:
    return replace(plan, **{name: getattr(plan, name)[:-last] for name in names})


BAD: dict[str, Callable[[TopologyEdit], TopologyEdit]] = {
    "names a parent element that is not there": lambda e: changed(e, "added_parents", 60_000),
    "born_rest has shape": lambda e: without(e, "born_rest"),
    "place of a node without parent is not finite": lambda e: changed(
        e, "born_rest", [np.nan, 0.0, 0.0]
    ),
    "no positive rest volume": lambda e: changed(e, "born_rest", [0.0, 0.0, 1.0]),
    "would belong to no element": lambda e: replace(
        e,
        born_nodes=np.append(e.born_nodes, ids(PROVISIONAL + len(e.born_nodes))),
        born_rest=np.append(e.born_rest, [[0.0, 0.0, 0.0]], axis=0),
    ),
    "its elements have its own nodes": lambda e: changed(
        e, "added_nodes", [0, *e.added_nodes[0][1:]]
    ),
    "names a node that is not there": lambda e: changed(
        e, "added_nodes", [PROVISIONAL + 900, *e.added_nodes[0][1:]]
    ),
    "new node ids must count up": lambda e: changed(e, "born_nodes", PROVISIONAL + 1),
    "moved by the edit that makes it": lambda e: replace(
        e, moved_nodes=e.born_nodes[:1], moved_rest=e.born_rest[:1] + 1e-4,
        moved_anchors=np.zeros((1, 4), np.uint32), moved_weights=np.array([[1.0, 0, 0, 0]]),
    ),
    "need a patch that they are of": lambda e: replace(e, added_patches=()),
    "one at most": lambda e: replace(e, added_patches=(SOFT, SOFT)),
    "needs nodes and elements without parent": lambda e: TopologyEdit(1, added_patches=(SOFT,)),
    "born_kinds has 1 items": lambda e: replace(
        e, born_kinds=np.zeros(1, np.uint8), born_tissue=np.ones(1)
    ),
    "born_kinds is for sheets": lambda e: replace(
        e, born_kinds=np.zeros(len(e.added_elements), np.uint8),
        born_tissue=np.ones(len(e.added_elements)),
    ),
    "the new patch's id is 7": lambda e: replace(e, added_patches=(replace(SOFT, id=7),)),
    "removes a patch that is not there": lambda e: replace(e, removed_patches=ids(3)),
}  # fmt: skip

NUMBERS: dict[str, tuple[str, Any]] = {
    "young_modulus = nan": ("young_modulus", np.nan),
    "young_modulus = 0 ": ("young_modulus", 0.0),
    "density = -1 ": ("density", -1.0),
    "thickness = 0 ": ("thickness", 0.0),
    "normal": ("normal", (0.0, 0.0, 2.0)),
    "normal .*nan": ("normal", (0.0, np.nan, 1.0)),
    "name is not allowed": ("name", "x" * 101),
    "printable": ("name", "a\nb"),
}


@pytest.mark.parametrize("message", [*BAD, *NUMBERS])
def test_what_makes_no_sense_is_refused_and_nothing_changes(message: str) -> None:
    mesh = block_mesh(3)
    before = picture(mesh)
    if message in BAD:
        bad = BAD[message](patch_edit(mesh, ABOVE))
    else:
        name, value = NUMBERS[message]
        bad = replace(patch_edit(mesh, ABOVE), added_patches=(replace(SOFT, **{name: value}),))
    with pytest.raises(EditError, match=message):
        mesh.apply(bad)
    assert_same(picture(mesh), before)
    assert mesh.version == 1


def test_a_name_that_a_region_has_is_refused() -> None:
    mesh = block_mesh(3)
    mesh.region_names[5] = "septum"
    with pytest.raises(EditError, match="has a region named 'septum'"):
        mesh.apply(patch_edit(mesh, ABOVE, patch=replace(SOFT, name="septum")))


@pytest.mark.parametrize(
    ("message", "change"),
    [
        ("born_kinds has 0 items", {"born_kinds": [], "born_tissue": []}),
        ("a triangle's kind is 0", {"born_kinds": CONNECTING}),
        ("no thickness", {"born_tissue": np.nan}),
        ("no thickness", {"born_tissue": 0.0}),
    ],
)
def test_what_makes_no_sense_in_a_sheet_is_refused(message: str, change: dict[str, Any]) -> None:
    mesh = connected(fixed=True)
    edit = patch_edit(mesh, ABOVE)
    for name, value in change.items():
        array = getattr(edit, name).copy()
        other: Any = array[:0] if np.ndim(value) else _first(array, value)
        edit = replace(edit, **{name: other})
    with pytest.raises(EditError, match=message):
        mesh.apply(edit)
    assert mesh.version == 1


def _first(array: NDArray[Any], value: float) -> NDArray[Any]:
    array[0] = value
    return array


@pytest.mark.parametrize("organ", ORGANS)
def test_undo_and_redo_bring_back_everything_bit_for_bit(organ: str) -> None:
    mesh, history = ORGANS[organ](), EditHistory()
    network = SpringNetwork(mesh, MATERIAL, np.float64)
    pictures, springs = [picture(mesh)], [weights(network)]

    def apply(edit: TopologyEdit) -> None:
        change = mesh.apply(edit)
        network.follow(change)
        history.record(change)

    def cut() -> TopologyEdit:
        return plan(mesh, mesh.rest[: mesh.node_rows], plane_x(0.0162)).edit

    makers: list[Callable[[], TopologyEdit]] = [
        lambda: patch_edit(mesh, ABOVE),
        cut,
        lambda: patch_edit(mesh, (0.0, 0.0, 0.1), (3, 3), patch=replace(SOFT, young_modulus=1e4)),
        lambda: TopologyEdit(mesh.version, removed_elements=mesh.element_ids[_of(mesh, 2)]),
    ]
    for make in makers:
        apply(make())
        pictures.append(picture(mesh))
        springs.append(weights(network))
    assert len(mesh.patches) == 2, "a patch whose elements are all gone is still known"
    for back, others in zip(pictures[-2::-1], springs[-2::-1], strict=True):
        apply(history.undo(mesh))
        assert_same(picture(mesh), back)
        assert_same(weights(network), others)
    for again, others in zip(pictures[1:], springs[1:], strict=True):
        apply(history.redo(mesh))
        assert_same(picture(mesh), again)
        assert_same(weights(network), others)


def _of(mesh: Mesh, patch: int) -> NDArray[np.int64]:
    """Rows of the elements of a patch."""
    found = mesh.patches.get(patch)
    assert found is not None
    mine = mesh.regions[: mesh.element_rows] == found.label
    return np.flatnonzero(mine & mesh.element_alive[: mesh.element_rows])


def weights(network: SpringNetwork) -> dict[str, Any]:
    """Springs and masses, in the order of rows."""
    rows = np.flatnonzero(network.springs.alive[: network.rows])
    nodes = np.flatnonzero(network.mesh.node_alive[: network.mesh.node_rows])
    return {
        "rows": rows,
        "ends": network.springs.ends[rows],
        "stiffness": network.springs.stiffness[rows],
        "length": network.springs.length[rows],
        "mass": network.masses[nodes],
    }


@pytest.mark.parametrize("organ", ORGANS)
def test_a_network_that_followed_is_as_built_afresh(organ: str) -> None:
    mesh = ORGANS[organ]()
    network = SpringNetwork(mesh, MATERIAL, np.float64)
    network.follow(mesh.apply(patch_edit(mesh, ABOVE)))
    fresh = SpringNetwork(mesh, MATERIAL, np.float64)

    def by_ends(of: SpringNetwork) -> dict[tuple[int, int], tuple[float, float]]:
        found = weights(of)
        columns = zip(found["ends"].tolist(), found["stiffness"], found["length"], strict=True)
        return {(a, b): (k, l0) for (a, b), k, l0 in columns}

    assert by_ends(network) == by_ends(fresh)
    rows = slice(mesh.node_rows)
    np.testing.assert_array_equal(network.masses[rows], fresh.masses[rows])
    volume = 0.012 * 0.009 * SOFT.thickness
    born = np.arange(mesh.node_rows - 40, mesh.node_rows)
    assert network.masses[born].sum() == pytest.approx(volume * SOFT.density)
    rows_of_patch = born.astype(np.int32)
    np.testing.assert_allclose(
        network.node_stiffness(rows_of_patch), fresh.node_stiffness(rows_of_patch), rtol=1e-14
    )


@pytest.mark.parametrize("organ", ORGANS)
def test_messages_carry_patches_to_those_who_follow_and_to_those_who_come_late(organ: str) -> None:
    mesh, epoch, history = ORGANS[organ](), bytes(range(16)), EditHistory()
    follower, late = Replica(), Replica()

    def keyframe() -> Mesh:
        message = conversions.mesh_to_topology(mesh, epoch, "organ", Time())
        return conversions.topology_to_mesh(message)

    def apply(edit: TopologyEdit) -> TopologyEdit:
        change = mesh.apply(edit)
        history.record(change)
        sent = edit_messages.edit_to_msg(change.edit, epoch, "organ", Time())
        got = edit_messages.edit_from_msg(sent)
        assert got.added_patches == change.edit.added_patches
        follower.take_edit(epoch, got)
        late.take_edit(epoch, got)
        return got

    follower.take_keyframe(epoch, keyframe())
    shape = (mesh.rest[: mesh.node_rows] + np.array([0.0, 0.0, 1e-3])).astype(np.float32)
    follower.take_state(epoch, 1, 1, shape)
    apply(patch_edit(mesh, ABOVE))
    carried = follower.shape_at()
    assert carried is not None
    np.testing.assert_array_equal(carried.positions[: len(shape)], shape)
    born = mesh.rest[len(shape) : mesh.node_rows].astype(np.float32)
    np.testing.assert_array_equal(carried.positions[len(shape) :], born)
    late.take_keyframe(epoch, keyframe())
    apply(patch_edit(mesh, (0.0, 0.0, 0.1), (3, 3)))
    apply(history.undo(mesh))
    apply(history.redo(mesh))
    assert follower.gaps == late.gaps == 0
    for replica in (follower, late):
        assert replica.mesh is not None
        assert replica.mesh.patches == mesh.patches
        assert_same(picture(replica.mesh), picture(mesh))


@pytest.mark.parametrize("organ", ORGANS)
def test_a_snapshot_keeps_patches_and_their_elements(organ: str, tmp_path: Path) -> None:
    mesh, history = ORGANS[organ](), EditHistory()
    for edit in (patch_edit(mesh, (0.0, 0.0, 0.1), (3, 3)), None, None):
        # The first one is undone, so that rows are missing.
        made = edit or (history.undo(mesh) if len(mesh.patches) else patch_edit(mesh, ABOVE))
        history.record(mesh.apply(made))
    mesh.apply(patch_edit(mesh, (0.0, 0.0, 0.1), (3, 3), patch=replace(SOFT, name="ein Flicken")))
    displacement = np.zeros((mesh.node_capacity, 3))
    snapshot.save(snapshot.take(mesh, displacement), tmp_path, "patched")
    back = snapshot.load(tmp_path, "patched").mesh()
    assert back.node_rows < mesh.node_rows
    assert back.patches == mesh.patches
    assert [patch.name for patch in back.patches] == ["patch 2", "ein Flicken"]
    for patch in mesh.patches:
        alive = mesh.element_alive
        assert (back.regions == patch.label).sum() == ((mesh.regions == patch.label) & alive).sum()
    ours, theirs = (SpringNetwork(each, MATERIAL, np.float64) for each in (mesh, back))
    assert theirs.masses.sum() == pytest.approx(ours.masses.sum(), rel=1e-12)
    stiff = [net.springs.stiffness[: net.rows].sum() for net in (ours, theirs)]
    assert stiff[0] == pytest.approx(stiff[1], rel=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"id": 0}, "not ascending"),
        ({"id": 4}, "not ascending"),
        ({"label": 9}, "region has no name"),
        ({"thickness": -1.0}, "thickness"),
    ],
)
def test_a_damaged_table_is_refused(change: dict[str, Any], message: str) -> None:
    labels = np.array([1, 2], dtype=np.int32)
    sound = Patches((replace(SOFT, id=2, label=1), replace(SOFT, id=3, label=2)), 4)
    assert checked_patches(sound, labels) is sound
    bad = replace(sound, items=(sound.items[0], replace(sound.items[1], **change)))
    with pytest.raises(ValueError, match=message):
        checked_patches(bad, labels)


def advance(
    simulation: Simulation,
    *edits: TopologyEdit,
    ask: str = "",
    tools: tuple[ToolSample, ...] = (),
    **arguments: Any,
) -> Frame:
    commands = (Command(ask, arguments, f"{ask}-{simulation.frame}"),) if ask else ()
    return simulation.advance(FrameInputs(commands, edits, tools), Budget(steps=8))


def grasping(pose: NDArray[np.float64], k: int) -> ToolSample:
    """The grasper, used from the sample with k = 0 on."""
    return ToolSample("grasper", pose, k, True, 1 if k == 0 else 0)


MODELS: list[tuple[str, dict[str, float]]] = [
    ("lr", {}),
    ("finite_element", {}),
    ("finite_element", {"corotated": 1.0}),
    ("vertex_block_descent", {}),
    ("relaxation", {}),
    ("voxel_chain_mail", {"spacing": 0.01}),
]


@pytest.mark.parametrize(("model", "parameters"), MODELS)
def test_a_session_with_a_patch_replays_bit_for_bit(
    model: str, parameters: dict[str, float]
) -> None:
    corner = (0.022, 0.01, 0.0705)
    scene = Scene(
        model=model, parameters={model: parameters}, tools=(tool_at(corner, size=(0.004,)),)
    )
    mesh = block_mesh(4)
    simulation = Simulation(mesh, scene)
    entries: list[JournalEntry] = []
    answers: list[Answer] = []

    def frame(*edits: TopologyEdit, **asked: Any) -> Frame:
        made = advance(simulation, *edits, **asked)
        entries.append(made.journal)
        answers.extend(made.answers)
        return made

    frame(patch_edit(mesh, ABOVE, request_id="patch"))
    at = np.array(corner)
    for k in range(4):
        at = at + np.array([0.001, 0.0, 0.0])
        frame(tools=(grasping(pose_of(at), k),))
    assert simulation.holds.rows.min() >= 64, "nodes of the patch are held"
    positions = mesh.rest[: mesh.node_rows] + simulation.state.displacement[: mesh.node_rows]
    frame(replace(plan(mesh, positions, plane_x(0.0162)).edit, request_id="cut"))
    for ask in ("undo", "", "undo", "redo", "", "redo", ""):
        frame(ask=ask)
    assert all(answer.success for answer in answers), answers
    assert len(mesh.patches) == 1
    last = simulation.state.displacement[: mesh.node_rows].copy()
    again = replay(entries, block_mesh(4))
    assert again.mismatches == ()
    assert again.simulation.mesh.patches == mesh.patches
    np.testing.assert_array_equal(again.simulation.state.displacement[: mesh.node_rows], last)


def test_a_patch_that_is_made_again_lies_where_it_was_born() -> None:
    mesh = block_mesh(4)
    tool = tool_at(ABOVE, size=(0.004,))
    simulation = Simulation(mesh, Scene(model="vertex_block_descent", tools=(tool,)))
    advance(simulation, patch_edit(mesh, ABOVE))
    for k in range(4):
        pose = pose_of((ABOVE[0], ABOVE[1], ABOVE[2] + 0.002 * k))
        advance(simulation, tools=(grasping(pose, k),))
    assert np.abs(simulation.state.displacement[64:]).max() > 0.005
    frame = advance(simulation, ask="undo")
    assert any("is released: its nodes vanished" in event for event in frame.events)
    advance(simulation, ask="redo")
    assert np.abs(simulation.state.displacement[64 : mesh.node_rows]).max() < 1e-6
    assert not simulation.state.prescribed[64 : mesh.node_rows].any()


def test_a_region_of_interest_refuses_a_patch_and_direct_factors_end_with_it() -> None:
    mesh = block_mesh(4)
    values = {"interest_radius": 0.05, "interest_z": 0.06}
    scene = Scene(model="finite_element", parameters={"finite_element": values})
    answer = advance(Simulation(mesh, scene), patch_edit(mesh, ABOVE)).answers[0]
    assert "refuses patches: interest_radius knows no patches" in answer.message
    assert mesh.version == 1
    direct = Scene(model="finite_element", parameters={"finite_element": {"direct": 1.0}})
    frame = advance(Simulation(mesh, direct), patch_edit(mesh, ABOVE))
    assert frame.answers[0].success
    assert any("before the patch; conjugate gradients go on" in event for event in frame.events)
    with pytest.raises(ValueError, match="direct = 1"):
        Simulation(mesh, direct)


def test_only_an_undo_takes_a_patch_out() -> None:
    mesh = block_mesh(3)
    simulation = Simulation(mesh, Scene())
    advance(simulation, patch_edit(mesh, ABOVE))
    gone = TopologyEdit(mesh.version, removed_patches=ids(1), request_id="x")
    answer = advance(simulation, gone).answers[0]
    assert "by undo and redo only" in answer.message
    assert len(mesh.patches) == 1


def test_a_patch_is_cut_and_sewn_and_all_of_it_undone() -> None:
    mesh, history = block_mesh(4), EditHistory()
    organ_of(mesh)
    before = picture(mesh)

    def apply(edit: TopologyEdit) -> None:
        history.record(mesh.apply(edit))
        fresh, followed = Organ(mesh), organ_of(mesh)
        assert followed.parts == fresh.parts
        assert followed.volume == pytest.approx(fresh.volume, rel=1e-12)

    apply(patch_edit(mesh, (0.01, 0.01, 0.0605), (9, 7), (0.03, 0.02)))
    assert organ_of(mesh).parts == 2
    patch = mesh.patches.items[0]
    sweep = plane_x(0.0262)
    above = replace(sweep, vertices=sweep.vertices + np.array([0.0, 0.0, 0.1601]))
    made = plan(mesh, mesh.rest[: mesh.node_rows], above)
    apply(made.edit)
    assert organ_of(mesh).parts == 3
    check_valid(mesh)
    halves = mesh.regions[_of(mesh, 1)]
    assert (halves == patch.label).all()
    rim = np.array([[x, 0.01, 0.0605] for x in (0.012, 0.016, 0.020)])
    pairs = np.stack([rim, rim * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.06]], axis=1).reshape(-1, 3)
    apply(plan_sewing(mesh, mesh.rest[: mesh.node_rows], Sewing(pairs, reach=0.02)))
    assert len(mesh.sutures)
    for _ in range(3):
        apply(history.undo(mesh))
    assert_same(picture(mesh), before)


def test_a_copy_and_a_patch_go_together_in_one_edit() -> None:
    mesh = block_mesh(4)
    split, patch = split_at(mesh, 0.02), patch_edit(mesh, ABOVE)
    copies = len(split.copied_nodes)
    both = replace(
        patch, copied_nodes=split.copied_nodes, copy_parents=split.copy_parents,
        rewritten_elements=split.rewritten_elements, rewritten_nodes=split.rewritten_nodes,
        born_nodes=patch.born_nodes + np.uint32(copies),
        added_nodes=patch.added_nodes + np.uint32(copies),
    )  # fmt: skip
    change = mesh.apply(both)
    assert change.born_nodes.min() == change.copied_nodes.max() + 1
    check_valid(mesh)
    assert (np.asarray(change.edit.added_parents) == NO_PARENT).all()


def test_a_patch_as_planned_has_a_provisional_id() -> None:
    assert Patch(1e5, 1000.0, 0.001).id == PROVISIONAL
