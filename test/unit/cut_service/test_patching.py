"""Planning patches: outlines become valid meshes that follow them, and bad ones are refused."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tissue_interfaces.srv import AddPatch

from cut_service.errors import SweepError
from cut_service.patching import (
    FARTHEST,
    THICKEST,
    THICKNESS,
    PatchCode,
    PatchError,
    Wanted,
    mean_edge,
    plan_patch,
)
from cut_service.planner import plan
from cut_service.sweep import Sweep
from cut_service.validity import look_at
from support.sewn_blocks import two_blocks
from support.sheets import connected, sheet_mesh, strip
from support.tet_topology import boundary
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.outline import (
    AREA_TOLERANCE,
    OutlineError,
    checked_outline,
    distance_from,
    signed_area,
)
from tissue_sim.geometry.patch_figures import patch_area
from tissue_sim.geometry.patch_layers import double_sheet, solid
from tissue_sim.geometry.patch_mesh import MOST_NODES, FlatMesh, mesh_outline
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.geometry.sheet import CONNECTING, SURFACE, SheetStiffness, edge_keys, sides
from tissue_sim.geometry.sheet_rows import WALL

SQUARE = np.array([[0.0, 0, 0], [0.02, 0, 0], [0.02, 0.02, 0], [0, 0.02, 0]])
ABOVE = np.array([0.0, 0.0, 0.02])
"""From there to a place above the organ of these tests."""


def disc(radius: float, corners: int = 60) -> NDArray[np.float64]:
    angle = np.arange(corners) * 2 * np.pi / corners
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@st.composite
def outlines(draw: st.DrawFn) -> NDArray[np.float64]:
    """Star-shaped polygons, most of them not convex, in either direction."""
    number = st.floats(0.0, 1.0)
    count = draw(st.integers(3, 12))
    steps = np.array(draw(st.lists(st.floats(0.1, 1.0), min_size=count, max_size=count)))
    angle = 2 * np.pi * (np.cumsum(steps) / steps.sum() + draw(number))
    radius = np.array(draw(st.lists(st.floats(0.003, 0.02), min_size=count, max_size=count)))
    corners = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return corners[:: -1 if draw(st.booleans()) else 1] + 0.1 * draw(number)


def assert_conforming(flat: FlatMesh) -> None:
    """Every side is in two triangles, but those of the rim, which are in one, all turned alike."""
    directed = sides(flat.triangles)
    assert len(np.unique(directed, axis=0)) == len(directed)
    keys, count = np.unique(edge_keys(directed), return_counts=True)
    rim = np.arange(flat.rim)
    border = edge_keys(np.stack([rim, np.roll(rim, -1)], axis=1))
    assert np.array_equal(keys[count == 1], np.sort(border))
    assert count.max() <= 2
    assert np.array_equal(np.unique(flat.triangles), np.arange(len(flat.points)))
    # One part without a hole.
    assert len(flat.points) - len(keys) + len(flat.triangles) == 1


@settings(max_examples=40, deadline=None)
@given(outlines(), st.floats(0.0015, 0.008))
def test_any_simple_polygon_becomes_a_valid_mesh(corners: NDArray[np.float64], edge: float) -> None:
    try:
        outline = checked_outline(corners)
    except OutlineError:
        assume(False)
    flat = mesh_outline(outline, edge)
    assert_conforming(flat)
    double = flat.points[flat.triangles[:, 1:]] - flat.points[flat.triangles[:, :1]]
    assert (double[:, 0, 0] * double[:, 1, 1] > double[:, 0, 1] * double[:, 1, 0]).all()
    assert distance_from(flat.points[: flat.rim], outline).max() < 1e-9
    area = signed_area(outline)
    assert flat.area == pytest.approx(area, rel=AREA_TOLERANCE)
    thick = solid(flat, 0.001)
    volumes = signed_volumes(thick.points, thick.elements)
    assert (volumes > 0.0).all()
    assert volumes.sum() == pytest.approx(flat.area * 0.001, rel=1e-9)
    # Conforming: on the outside are both layers and two triangles for each side of the rim.
    assert len(boundary(thick.elements)) == 2 * len(flat.triangles) + 2 * flat.rim


@settings(max_examples=15, deadline=None)
@given(st.integers(3, 9), st.floats(0.008, 0.02), st.floats(0.0, 1.0), st.floats(0.001, 0.003))
@example(count=3, radius=0.008, turn=0.0, edge=0.0029816841296255625)
@example(count=3, radius=0.008, turn=0.2541, edge=0.0029)
def test_outlines_without_sharp_corners_get_good_elements(
    count: int, radius: float, turn: float, edge: float
) -> None:
    angle = 2 * np.pi * (np.arange(count) + turn) / count
    corners = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    flat = mesh_outline(checked_outline(corners), edge)
    assert flat.qualities.min() > 0.4
    assert flat.qualities.mean() > 0.85
    ends = flat.points[sides(flat.triangles)]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert 0.35 * edge < lengths.min()
    assert lengths.max() < 1.8 * edge


def test_points_are_spread_evenly_along_a_curved_outline() -> None:
    flat = mesh_outline(checked_outline(disc(0.012, 200)), 0.003)
    rim = flat.points[: flat.rim]
    lengths = np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1)
    assert flat.rim == round(2 * np.pi * 0.012 / 0.003)
    np.testing.assert_allclose(lengths, lengths.mean(), rtol=0.01)
    assert flat.qualities.min() > 0.6


def test_corners_stay_corners() -> None:
    shape = np.array([[0, 0], [0.03, 0], [0.03, 0.01], [0.011, 0.01], [0.011, 0.03], [0, 0.03]])
    flat = mesh_outline(checked_outline(shape), 0.0031)
    gaps = np.linalg.norm(flat.points[None, : flat.rim] - shape[:, None], axis=2)
    assert gaps.min(axis=1).max() < 1e-12
    assert flat.area == pytest.approx(signed_area(shape), rel=1e-12)


def test_a_narrow_gap_is_kept_open() -> None:
    comb = np.array(
        [[0, 0], [30, 0], [30, 20], [20.1, 20], [20.1, 2], [20, 2], [20, 20], [0, 20]]
    ) * 1e-3  # fmt: skip
    flat = mesh_outline(checked_outline(comb), 0.003)
    assert_conforming(flat)
    assert flat.area == pytest.approx(signed_area(comb), rel=1e-9)


def test_sheets_share_out_all_of_the_tissue_and_face_outward() -> None:
    flat = mesh_outline(checked_outline(disc(0.01)), 0.003)
    made = double_sheet(flat, 0.002, SheetStiffness())
    volume = flat.area * 0.002
    assert made.tissue[made.kinds == CONNECTING].sum() == pytest.approx(volume, rel=1e-12)
    solids = made.elements[made.kinds == SURFACE][:, :3]
    walls = made.elements[made.kinds == WALL][:, :3]
    skin = np.concatenate([solids, walls])
    a, b, c = (made.points[skin[:, k]] for k in range(3))
    # The sheets and the walls enclose the patch: its volume by the divergence theorem.
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(volume, rel=1e-9)
    springs = made.elements[made.kinds == CONNECTING][:, :2]
    assert len(np.unique(np.sort(springs, axis=1), axis=0)) == len(springs)


def organ() -> tuple[Mesh, NDArray[np.float64]]:
    mesh, _, _ = two_blocks()
    return mesh, mesh.rest[: mesh.node_rows].copy()


def planned(corners: NDArray[np.float64] = SQUARE + ABOVE, **more: Any) -> TopologyEdit:
    mesh, shape = organ()
    return plan_patch(mesh, shape, Wanted(corners, **more)).edit


def test_a_patch_joins_the_organ_as_a_part_of_its_own_and_goes_with_undo() -> None:
    mesh, shape = organ()
    before = (mesh.node_rows, mesh.element_rows, int(mesh.element_alive.sum()))
    plan = plan_patch(mesh, shape, Wanted(SQUARE + ABOVE, name="pericardium", thickness=0.002))
    change = mesh.apply(plan.edit)
    rows = change.born_nodes
    assert len(rows) == plan.nodes
    assert int(mesh.element_alive.sum()) == before[2] + plan.elements
    (patch,) = mesh.patches
    assert (patch.name, patch.thickness) == ("pericardium", 0.002)
    own = np.flatnonzero(mesh.element_alive & (mesh.regions == patch.label))
    assert len(own) == plan.elements
    assert signed_volumes(mesh.rest, mesh.tets[own]).sum() == pytest.approx(4e-4 * 0.002)
    assert patch_area(change.edit) == pytest.approx(4e-4)
    np.testing.assert_allclose(np.abs(mesh.rest[rows, 2] - 0.02), 0.001)
    history = EditHistory()
    history.record(change)
    mesh.apply(history.undo(mesh))
    assert len(mesh.patches) == 0
    assert int(mesh.element_alive.sum()) == before[2]


def test_the_normal_that_is_wanted_decides_which_side_is_up() -> None:
    for corners in (SQUARE, SQUARE[::-1]):
        for up in (1.0, -1.0):
            edit = planned(corners + ABOVE, normal=np.array([0.0, 0.0, up]))
            np.testing.assert_allclose(edit.added_patches[0].normal, [0, 0, up], atol=1e-12)
            half = len(edit.born_nodes) // 2
            heights = up * (edit.born_rest[:, 2] - 0.02)
            np.testing.assert_allclose(heights[half:], THICKNESS / 2)
    assert planned(SQUARE[::-1] + ABOVE).added_patches[0].normal[2] == pytest.approx(-1.0)


def test_edges_are_as_long_as_the_organs_unless_asked_otherwise() -> None:
    mesh, shape = organ()
    plan = plan_patch(mesh, shape, Wanted(SQUARE + ABOVE))
    assert plan.edge == pytest.approx(mean_edge(mesh))
    assert plan_patch(mesh, shape, Wanted(SQUARE + ABOVE, edge=0.001)).nodes > 4 * plan.nodes
    assert mean_edge(sheet_mesh(strip(6, 5, 0.002))) == pytest.approx(0.002)


def test_a_surface_gets_one_sheet_and_connected_surfaces_two() -> None:
    for mesh, layers in ((sheet_mesh(strip(6, 5)), 1), (connected(), 2)):
        shape = mesh.rest[: mesh.node_rows].copy()
        plan = plan_patch(mesh, shape, Wanted(SQUARE + 0.1, edge=0.004))
        change = mesh.apply(plan.edit)
        heights = np.unique(np.round(mesh.rest[change.born_nodes, 2], 9))
        assert len(heights) == layers
        assert len(mesh.patches) == 1
        assert patch_area(change.edit) == pytest.approx(4e-4)


def test_a_cut_through_a_wall_and_a_patch_in_it_joins_no_two_of_them() -> None:
    mesh = connected()
    inside = np.array([[-2, 16.5, 0], [2, 16.5, 0], [2, 19.5, 0], [-2, 19.5, 0]]) * 1e-3
    wanted = Wanted(inside, thickness=0.001, edge=0.001)
    mesh.apply(plan_patch(mesh, mesh.rest[: mesh.node_rows].copy(), wanted).edit)
    square = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) * 0.03
    across = Sweep.from_arrays(square + np.array([3e-4, 0, 0]), [[0, 1, 2], [0, 2, 3]])
    mesh.apply(plan(mesh, mesh.rest[: mesh.node_rows], across).edit)
    seen = look_at(mesh)
    assert seen.faults == ()
    assert seen.parts == 4


def test_overlap_with_tissue_is_told_and_allowed() -> None:
    mesh, shape = organ()
    assert plan_patch(mesh, shape, Wanted(SQUARE + ABOVE)).overlap == 0
    inside = plan_patch(mesh, shape, Wanted(SQUARE + 0.2 * ABOVE))
    assert inside.overlap > 0
    assert "overlaps tissue" in inside.in_words("patch 1", "")
    # A sheet as large as the lips, in the gap between them, touches none of them; moved over they
    # are in its way.
    gap = np.array([[0.0125, 0, 0], [0.0125, 0.009, 0], [0.0125, 0.009, 0.006], [0.0125, 0, 0.006]])
    assert plan_patch(mesh, shape, Wanted(gap, thickness=0.0005)).overlap == 0
    shape[shape[:, 0] > 0.0125, 0] -= 0.0006
    assert plan_patch(mesh, shape, Wanted(gap, thickness=0.0005)).overlap > 0


BAD: list[tuple[str, PatchCode, dict[str, Any]]] = [
    ("crosses itself", PatchCode.CROSSES, {"corners": SQUARE[[0, 2, 1, 3]]}),
    (
        "crosses itself", PatchCode.CROSSES,
        {"corners": np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [1, -1, 0], [0, 4, 0.0]]) * 1e-2},
    ),
    (
        "touches itself", PatchCode.CROSSES,
        {"corners": np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [2, 0, 0], [0, 4, 0.0]]) * 1e-2},
    ),
    (
        "folds back", PatchCode.CROSSES,
        {"corners": np.array([[0, 0, 0], [4, 0, 0], [6, 0, 0], [4, 0, 0.0], [4, 4, 0]]) * 1e-2},
    ),
    ("not flat", PatchCode.NOT_FLAT, {"corners": SQUARE + np.outer([0, 0, 0, 1], 0.2 * ABOVE)}),
    ("not finite", PatchCode.INVALID, {"corners": np.where(SQUARE > 0.01, np.nan, SQUARE)}),
    ("infinite", PatchCode.INVALID, {"corners": np.where(SQUARE > 0.01, np.inf, SQUARE)}),
    ("two corners", PatchCode.INVALID, {"corners": SQUARE[:2]}),
    ("no corner", PatchCode.INVALID, {"corners": SQUARE[:0]}),
    ("too many", PatchCode.INVALID, {"corners": np.zeros((2000, 3))}),
    ("repeated", PatchCode.INVALID, {"corners": SQUARE[[0, 1, 1, 2, 3]]}),
    ("closed", PatchCode.INVALID, {"corners": SQUARE[[0, 1, 2, 3, 0]]}),
    ("a line", PatchCode.INVALID, {"corners": SQUARE[:3] * [1, 0, 0]}),
    ("tiny", PatchCode.INVALID, {"corners": 1e-3 * SQUARE}),
    ("wide", PatchCode.INVALID, {"corners": 100 * SQUARE}),
    ("enormous", PatchCode.TOO_LARGE, {"edge": 2e-4}),
    ("enormous", PatchCode.TOO_LARGE, {"edge": 1e-12}),
    ("edge", PatchCode.INVALID, {"edge": -0.001}),
    ("edge", PatchCode.INVALID, {"edge": np.nan}),
    ("thickness", PatchCode.INVALID, {"thickness": -1.0}),
    ("thickness", PatchCode.INVALID, {"thickness": np.inf}),
    ("thickness", PatchCode.INVALID, {"thickness": 5.0}),
    ("a rod", PatchCode.INVALID, {"thickness": 0.0114}),
    ("far", PatchCode.INVALID, {"corners": SQUARE + 15.0 * ABOVE}),
    ("far", PatchCode.INVALID, {"corners": SQUARE - 1e3}),
    ("far", PatchCode.INVALID, {"corners": SQUARE + 1e200}),
    ("modulus", PatchCode.INVALID, {"young_modulus": -1.0}),
    ("modulus", PatchCode.INVALID, {"young_modulus": 1e20}),
    ("density", PatchCode.INVALID, {"density": 1e9}),
    ("name", PatchCode.INVALID, {"name": "x" * 1000}),
]  # fmt: skip


@pytest.mark.parametrize(("what", "code", "wrong"), BAD)
def test_bad_input_is_refused_with_a_code_and_a_reason(
    what: str, code: PatchCode, wrong: dict[str, Any]
) -> None:
    with pytest.raises(PatchError) as caught:
        planned(**wrong)
    assert caught.value.code == code, f"{what}: {caught.value}"
    assert str(caught.value)


def test_how_far_and_how_thick_a_patch_may_be() -> None:
    mesh, shape = organ()
    size = float(np.linalg.norm(np.ptp(shape, axis=0)))
    top = float(shape[:, 2].max())
    at = np.array([0.0, 0.0, top + 0.999 * FARTHEST * size])
    assert plan_patch(mesh, shape, Wanted(SQUARE + at)).nodes
    widest = 2.0 * float(np.sqrt(0.02**2 / np.pi))
    edit = planned(thickness=0.999 * THICKEST * widest)
    assert edit.added_patches[0].thickness == pytest.approx(THICKEST * widest, rel=2e-3)


def test_a_patch_makes_the_organ_no_larger_for_sweeps() -> None:
    corners = [[0.01, -1, -1], [0.01, 1, -1], [0.01, 1, 1], [0.01, -1, 1]]
    for mesh in (organ()[0], sheet_mesh(strip(6, 5))):
        shape = mesh.rest[: mesh.node_rows].copy()
        change = mesh.apply(plan_patch(mesh, shape, Wanted(SQUARE)).edit)
        places = mesh.rest[: mesh.node_rows].astype(np.float64)
        large = Sweep.from_arrays(100.0 * np.array(corners), [[0, 1, 2], [0, 2, 3]])
        # Carried a kilometre away by its tool.
        places[mesh.node_rows_of(change.edit.born_nodes)] += 1e3
        with pytest.raises(SweepError, match="100 times the organ"):
            plan(mesh, places, large)


def test_a_name_that_is_taken_is_refused() -> None:
    mesh, shape = organ()
    wanted = Wanted(SQUARE + ABOVE, name="patch")
    mesh.apply(plan_patch(mesh, shape, wanted).edit)
    shape = mesh.rest[: mesh.node_rows].copy()
    with pytest.raises(PatchError, match="already") as caught:
        plan_patch(mesh, shape, wanted)
    assert caught.value.code == PatchCode.INVALID
    mesh.apply(plan_patch(mesh, shape, dataclasses.replace(wanted, name="other")).edit)
    assert mesh.patches.ids.tolist() == [1, 2]


def test_the_largest_patch_is_within_what_is_allowed() -> None:
    flat = mesh_outline(checked_outline(0.06 * SQUARE[:, :2] / 0.02), 0.0014)
    assert 0.8 * MOST_NODES < 2 * len(flat.points) <= MOST_NODES


def test_the_codes_are_those_of_the_service() -> None:
    for code in PatchCode:
        assert getattr(AddPatch.Response, code.name) == code
