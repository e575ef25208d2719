"""Cuts of surfaces and connected surfaces: valid, undone exactly, nothing joins the two sides."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cut_service import session_study
from cut_service.errors import CutCode, CutError
from cut_service.patching import Wanted, plan_patch
from cut_service.planner import Plan, Settings, plan
from cut_service.sweep import Sweep
from cut_service.validity import look_at
from support.cut_sheets import (
    any_square,
    assert_as_built_afresh,
    assert_valid,
    plane_x,
    square,
    through,
)
from support.sheets import EVERYTHING, ball, connected, lattice, sheet_mesh
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.components import connected_components, parts_of
from tissue_sim.geometry.edit import PROVISIONAL, EditError, TopologyEdit
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.scene_geometry import load
from tissue_sim.geometry.sheet import CONNECTING, edge_keys, sides, triangle_areas
from tissue_sim.geometry.sheet_edit import NO_NODE
from tissue_sim.geometry.sheet_geometry import CONNECTED, SheetSettings


def slab() -> Mesh:
    settings = SheetSettings(CONNECTED)
    return load("wall", parameters={"columns": 9, "rows": 11}, sheet=settings).mesh


ORGANS: dict[str, Callable[[], Mesh]] = {
    "shell": lambda: connected(EVERYTHING),
    "slab": slab,
    "ball": lambda: sheet_mesh(ball(), EVERYTHING),
    "lattice": lambda: sheet_mesh(lattice(9, 9)),
}


def cut(mesh: Mesh, sweep: Sweep, **options: Any) -> Plan:
    return plan(mesh, mesh.rest[: mesh.node_rows], sweep, settings=Settings(**options))


def cut_or_none(mesh: Mesh, sweep: Sweep) -> Plan | None:
    """The cut; None if there is too little to cut."""
    try:
        return cut(mesh, sweep)
    except CutError as error:
        if not error.code.nothing_to_cut:
            raise
        return None


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(seeds=st.lists(st.integers(0, 10**6), min_size=1, max_size=4))
@pytest.mark.parametrize("name", list(ORGANS))
def test_any_cuts_leave_a_valid_sheet_that_springs_have_followed_and_that_undo_restores(
    name: str, seeds: list[int]
) -> None:
    mesh = ORGANS[name]()
    network, history = SpringNetwork(mesh, Material()), EditHistory()
    tissue, triangles = through(mesh), len(mesh.sheet.triangles)  # type: ignore[union-attr]
    before = _rows(mesh)
    for seed in seeds:
        planned = cut_or_none(mesh, any_square(seed, mesh))
        if planned is None:
            continue
        change = mesh.apply(planned.edit)
        history.record(change)
        network.follow(change)
        assert_valid(mesh)
        assert_as_built_afresh(network)
        assert len(mesh.sheet.triangles) == triangles  # type: ignore[union-attr]
        assert parts_of(mesh) == planned.report.components
        if "put back" not in planned.report.notes:
            assert through(mesh) == pytest.approx(tissue, rel=1e-9)
        tissue = through(mesh)
    while history.done:
        change = mesh.apply(history.undo(mesh))
        history.record(change)
        network.follow(change)
    for one, other in zip(_rows(mesh), before, strict=True):
        np.testing.assert_array_equal(one, other)
    assert_as_built_afresh(network)


def _rows(mesh: Mesh) -> tuple[np.ndarray, ...]:
    sheet = mesh.sheet
    assert sheet is not None
    living = mesh.node_alive[: mesh.node_rows]
    return (
        sheet.triangles, sheet.springs, sheet.categories, sheet.volumes, sheet.thickness,
        sheet.walls, mesh.rest[: mesh.node_rows][living],
    )  # fmt: skip


def test_a_plane_through_a_shell_parts_it_and_nothing_joins_the_halves() -> None:
    mesh = connected(EVERYTHING)
    stiffness = SpringNetwork(mesh, Material(), np.float64).springs.stiffness.sum()
    # As coarse as this ball is, all nodes on the plane take 0.3 % of the tissue away.
    planned = cut(mesh, plane_x(0.0013), volume_budget=0.01)
    assert planned.report.components == 2
    assert planned.report.distance_after[1] < 1e-12
    assert planned.report.notes == ""
    mesh.apply(planned.edit)
    sheet = mesh.sheet
    assert sheet is not None
    every = np.ones(len(sheet.triangles), dtype=np.bool_)
    _, part = connected_components(sheet.triangles, every, mesh.node_rows)
    assert part.max() == 3, "two halves of two sheets"
    middle = np.zeros(4)
    np.add.at(middle, part[sheet.triangles[:, 0]], mesh.rest[sheet.triangles].mean(axis=1)[:, 0])
    side = np.sign(middle)[part]
    assert (side[sheet.springs[:, 0]] == side[sheet.springs[:, 1]]).all()
    assert (side[sheet.walls] == side[sheet.walls[:, :1]]).all()
    count = np.bincount(sheet.springs[sheet.categories == CONNECTING].ravel())
    assert count.min() >= 3, "no node is left under-constrained"
    # As many springs as before hold the tissue through its wall, a little longer or shorter.
    after = SpringNetwork(mesh, Material(), np.float64).springs.stiffness.sum()
    assert after == pytest.approx(stiffness, rel=0.15)


@pytest.mark.parametrize(
    ("name", "plane", "why"),
    [
        ("shell, connected surfaces", 28, "all nodes of a fan are of the cut, one far from it"),
        ("shell, connected surfaces", 84, "the same on the other sheet"),
        ("wall, connected surfaces", 44, "nothing is snapped"),
        ("wall, connected surfaces", 76, "beside a node that snapping holds back at a corner"),
        ("wall, connected surfaces", 99, "beside a node that lies at a corner itself"),
    ],
)
def test_no_spring_joins_what_a_plane_right_through_has_parted(
    name: str, plane: int, why: str
) -> None:
    mesh = Mesh(session_study.geometry(name).raw)
    sweep = session_study.plane_through(mesh, 20, plane)
    planned = cut(mesh, sweep, snap=why != "nothing is snapped")
    mesh.apply(planned.edit)
    assert look_at(mesh).parts == planned.report.components == 2, why
    assert planned.report.notes == ""


@pytest.mark.parametrize("sweep", ["through", "window"])
def test_the_wall_closes_the_cut_and_faces_out_of_the_tissue(sweep: str) -> None:
    mesh = connected()
    whole = plane_x(0.0013)
    window = square(np.array([0.0013, 0.0, 0.02]), 0.008 * np.eye(3)[1], 0.008 * np.eye(3)[2])
    planned = cut(mesh, whole if sweep == "through" else window)
    assert planned.report.notes == ""
    mesh.apply(planned.edit)
    sheet = mesh.sheet
    assert sheet is not None
    # Closed and of one orientation: every directed side once, and its opposite once.
    directed = sides(np.concatenate([sheet.triangles, sheet.walls]))
    forward = directed[:, 0].astype(np.int64) << 32 | directed[:, 1]
    backward = directed[:, 1].astype(np.int64) << 32 | directed[:, 0]
    assert len(np.unique(forward)) == len(forward)
    missing = np.setdiff1d(backward, forward)
    # The line across the tissue at each end of a window is the same for both sides.
    assert len(missing) == 0, f"{len(missing)} sides have no neighbour"
    section = np.pi * (0.02**2 - 0.016**2)
    if sweep == "through":
        assert triangle_areas(mesh.rest, sheet.walls).sum() == pytest.approx(2 * section, rel=0.1)


@pytest.mark.parametrize("budget", [0.0, 2e-4, 5e-4])
def test_snapping_takes_no_more_tissue_than_it_may(budget: float) -> None:
    mesh = connected()
    before = look_at(mesh).volume
    planned = cut(mesh, plane_x(0.0013), volume_budget=budget)
    mesh.apply(planned.edit)
    after = look_at(mesh)
    assert after.faults == ()
    assert abs(after.volume / before - 1.0) <= budget * (1.0 + 1e-6) + 1e-12
    assert after.volume - before == pytest.approx(planned.report.volume_change, abs=1e-9 * before)
    if budget:
        assert planned.report.distance_after[0] < planned.report.distance_before[0]


def test_the_wall_of_a_cut_through_a_patch_is_of_the_patch() -> None:
    mesh = connected()
    corners = np.array([[-0.01, -0.01, 0.03], [0.01, -0.01, 0.03], [0.01, 0.01, 0.03],
                        [-0.01, 0.01, 0.03]])  # fmt: skip
    mesh.apply(plan_patch(mesh, mesh.rest[: mesh.node_rows], Wanted(corners, edge=0.003)).edit)
    label = mesh.patches.labels[0]
    sweep = square(np.array([0.001, 0.0, 0.03]), 0.005 * np.eye(3)[1], 0.005 * np.eye(3)[2])
    planned = cut(mesh, sweep)
    edit = mesh.apply(planned.edit).edit
    walls = edit.added_elements[edit.added_nodes[:, 2] != NO_NODE]
    assert len(walls)
    assert (mesh.regions[walls] == label).all()
    assert look_at(mesh).faults == ()


def test_without_snapping_nothing_moves_and_areas_are_kept() -> None:
    mesh = connected()
    rest = mesh.rest[: mesh.node_rows].copy()
    weight = SpringNetwork(mesh, Material()).masses.sum()
    planned = cut(mesh, plane_x(0.0013), snap=False)
    mesh.apply(planned.edit)
    np.testing.assert_array_equal(mesh.rest[: len(rest)], rest)
    assert SpringNetwork(mesh, Material()).masses.sum() == pytest.approx(weight, rel=1e-12)
    assert planned.report.components == 2


def test_a_sweep_beside_the_tissue_or_a_scratch_misses() -> None:
    mesh = connected()
    with pytest.raises(CutError) as beside:
        cut(mesh, plane_x(0.03, half=0.01))
    assert beside.value.code == CutCode.MISSED
    scratch = square(np.array([0.0, 0.0, 0.02]), 1e-4 * np.eye(3)[1], 1e-3 * np.eye(3)[2])
    with pytest.raises(CutError, match="too short"):
        cut(mesh, scratch)


def test_a_corner_of_a_few_triangles_is_not_cut_off() -> None:
    mesh = sheet_mesh(lattice(9, 9))
    corner = mesh.rest[0] + np.array([0.003, 0.0, 0.0])
    sweep = square(corner, 0.01 * np.array([1.0, -1.0, 0.0]), 0.01 * np.eye(3)[2])
    with pytest.raises(CutError):
        cut(mesh, sweep, smallest_piece=30)
    planned = cut(mesh, sweep, smallest_piece=1)
    assert planned.report.components == 2


def test_bad_edits_of_a_sheet_are_refused_and_change_nothing() -> None:
    mesh = connected()
    before = _rows(mesh)
    sheet = mesh.sheet
    assert sheet is not None
    triangle, spring = np.uint32(0), np.uint32(len(sheet.triangles))
    a, b, c = (np.uint32(node) for node in sheet.triangles[0])
    none, copy = np.uint32(NO_NODE), np.uint32(PROVISIONAL)

    def edit(element: np.uint32, nodes: list[np.uint32], **more: Any) -> TopologyEdit:
        return TopologyEdit(
            mesh.version, rewritten_elements=np.array([element]),
            rewritten_nodes=np.array([nodes], dtype=np.uint32), **more,
        )  # fmt: skip

    copied = {"copied_nodes": np.array([copy]), "copy_parents": np.array([a])}
    added: dict[str, Any] = {
        "added_elements": np.array([copy]),
        "added_nodes": np.array([[a, b, none, none]], dtype=np.uint32),
        "added_parents": np.array([spring]),
    }
    for bad, why in (
        (edit(triangle, [a, b, none, none]), "triangle would become a spring"),
        (edit(spring, [a, b, c, none]), "spring a triangle"),
        (edit(triangle, [a, none, c, none]), "two nodes or three"),
        (edit(triangle, [a, b, c, c]), "two nodes or three"),
        (edit(triangle, [a, b, b, none]), "a node twice"),
        (edit(spring, [copy, b, none, none], **copied), "belong to no triangle"),
        (TopologyEdit(mesh.version, **added), "takes the place of a spring"),
    ):
        with pytest.raises(EditError, match=why):
            mesh.apply(bad)
    for one, other in zip(_rows(mesh), before, strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(edge_keys(sheet.springs)) == len(sheet.springs)
