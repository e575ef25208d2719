"""Surfaces become sheets of triangles and springs, and travel through messages and files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cut_service.errors import CutCode, CutError
from cut_service.planner import plan
from cut_service.sweep import Sweep
from support.sheets import EVERYTHING, ball, connected, lattice, sheet_mesh, shell
from tissue_sim import conversions, edit_messages, snapshot
from tissue_sim.default_procedure import default_procedure
from tissue_sim.geometry.components import parts_of
from tissue_sim.geometry.connected_surfaces import opposite_side
from tissue_sim.geometry.curvature_springs import angular_springs, bending_springs, hinges
from tissue_sim.geometry.errors import MeshError
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.scene_geometry import load, suggest_interaction
from tissue_sim.geometry.sheet import CONNECTING, Sheet, SheetStiffness, edge_keys, sides
from tissue_sim.geometry.sheet_geometry import CONNECTED, SURFACE, SheetSettings, with_sheet
from tissue_sim.geometry.surface import surface_triangles, vertex_normals
from tissue_sim.live import mesh_for_keyframe
from tissue_sim.simulation_parameters import sheet_settings
from tool_input.procedure import parse_procedure
from viz_bridge.organ_surface import surface_of


def first_exit(
    corners: NDArray[np.float64], start: NDArray[np.float64], way: NDArray[np.float64]
) -> tuple[float, int]:
    """Distance to the nearest triangle that a ray leaves through, by trying all of them."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    leaving = normal @ way > 1e-15
    distance = np.einsum("ij,ij->i", normal, a - start) / np.where(leaving, normal @ way, 1.0)
    at = start + distance[:, None] * way
    inside = leaving & (distance > 1e-9)
    for one, other in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", np.cross(other - one, at - one), normal) >= -1e-18
    distance[~inside] = np.inf
    return float(distance.min()), int(distance.argmin())


def test_rays_find_the_triangle_that_trying_all_of_them_finds() -> None:
    raw = shell(subdivisions=1)
    # Turned, so that rays go through triangles and not through nodes and edges.
    inner = len(raw.points) // 2
    points = raw.points.copy()
    points[inner:] = Rotation.from_euler("xyz", [0.2, 0.3, 0.5]).apply(points[inner:])
    triangles = raw.triangles.astype(np.int32)
    found = opposite_side(points, triangles)
    normals = np.zeros_like(points)
    vertex_normals(points, triangles, normals)
    for node in range(len(points)):
        distance, triangle = first_exit(points[triangles], points[node], -normals[node])
        assert found.depth[node] == pytest.approx(distance, rel=1e-4)
        assert found.triangle[node] == triangle


def test_every_node_is_joined_to_the_opposite_triangle_once() -> None:
    sheet = connected().sheet
    assert sheet is not None
    assert sheet.count(CONNECTING) == len(sheet.springs)
    keys = edge_keys(sheet.springs)
    assert len(np.unique(keys)) == len(keys)
    assert not np.isin(keys, edge_keys(sides(sheet.triangles))).any()
    points = shell().points
    through = np.linalg.norm(points[sheet.springs[:, 0]], axis=1) > 0.018
    assert (through != (np.linalg.norm(points[sheet.springs[:, 1]], axis=1) > 0.018)).all()
    counts = np.bincount(sheet.springs.ravel(), minlength=len(points))
    assert counts.min() >= 3
    assert sheet.volumes.sum() == pytest.approx(sheet.triangle_volumes(points).sum())


def test_the_sheet_stands_for_the_tissue_that_the_surface_encloses() -> None:
    for raw in (shell(), ball()):
        mesh = sheet_mesh(raw, SheetStiffness(), CONNECTED)
        assert mesh.sheet is not None
        corners = raw.points[raw.triangles]
        volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
        assert mesh.sheet.triangle_volumes(raw.points).sum() == pytest.approx(volume)


def test_curvature_springs_of_a_grid_are_those_of_the_literature() -> None:
    raw = lattice(5, 4, edge=1.0)
    thickness = np.ones(len(raw.triangles))
    bending, volumes = bending_springs(raw.points, raw.triangles, thickness)
    lengths = np.linalg.norm(np.diff(raw.points[bending], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(lengths, 2.0)
    # Along rows, along columns, and along the diagonals.
    assert len(bending) == 3 * 4 + 5 * 2 + 3 * 2
    assert (volumes > 0).all()
    angular, _ = angular_springs(raw.points, raw.triangles, thickness)
    lengths = np.linalg.norm(np.diff(raw.points[angular], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(lengths, np.sqrt(3.0))
    closed = ball().triangles
    assert len(hinges(closed)) == 3 * len(closed) // 2


def test_hinges_run_along_their_first_triangle() -> None:
    triangles = ball(subdivisions=1).triangles
    directed = {tuple(side) for side in sides(triangles).tolist()}
    present = {tuple(sorted(triangle)) for triangle in triangles.tolist()}
    for a, b, c, d in hinges(triangles).tolist():
        assert (a, b) in directed
        assert tuple(sorted((a, b, c))) in present
        assert tuple(sorted((a, b, d))) in present


def test_any_geometry_can_be_a_surface_and_keeps_its_nodes() -> None:
    block = {"nodes_x": 5, "nodes_y": 5, "nodes_z": 5}
    volume = load("block", parameters=block)
    surface = load("block", parameters=block, sheet=SheetSettings(SURFACE))
    mesh = surface.mesh
    assert mesh.sheet is not None
    assert (mesh.tets[: mesh.element_rows, 3] == -1).all()
    assert mesh.node_rows == 5**3 - 3**3
    place = {int(i): p for i, p in zip(volume.raw.node_file_ids, volume.raw.points, strict=True)}
    for file_id, point in zip(surface.raw.node_file_ids, surface.raw.points, strict=True):
        np.testing.assert_array_equal(place[int(file_id)], point)
    assert mesh.fixed.sum() == 25
    assert parts_of(mesh) == 1
    assert "98 nodes, 192 triangles" in surface.report.lines()[0]
    wall = load("wall", sheet=SheetSettings(CONNECTED)).mesh
    assert wall.node_rows == 884


def test_a_surface_file_becomes_connected_surfaces(tmp_path: Path) -> None:
    raw = shell()
    shape = trimesh.Trimesh(1e3 * raw.points, raw.triangles, process=False)
    for suffix in ("obj", "stl", "ply"):
        shape.export(tmp_path / f"shell.{suffix}")
        geometry = load(tmp_path / f"shell.{suffix}", "mm", sheet=SheetSettings(CONNECTED))
        assert geometry.mesh.node_rows == len(raw.points)
        assert any("connecting springs join" in line for line in geometry.report.mended)
    inverted = replace(raw, triangles=raw.triangles[:, ::-1])
    said: list[str] = []
    turned = with_sheet(inverted, SheetSettings(CONNECTED), said)
    assert "all triangles pointed inwards and were turned" in said
    assert turned.sheet is not None
    np.testing.assert_allclose(turned.sheet.volumes.sum(), connected().sheet.volumes.sum())  # type: ignore[union-attr]


def test_open_surfaces_cannot_be_connected_but_are_surfaces() -> None:
    with pytest.raises(MeshError, match="does not enclose a volume"):
        with_sheet(lattice(6, 6), SheetSettings(CONNECTED), [])
    sheet = with_sheet(lattice(6, 6), SheetSettings(SURFACE), []).sheet
    assert sheet is not None
    np.testing.assert_allclose(sheet.thickness, 2e-3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"stiffness.bending": 1.0}, "stiffness.bending is for geometry_kind surface or"),
        ({"geometry_kind": "sheet"}, "geometry_kind = 'sheet'.*volume, surface, connected"),
        ({"geometry_kind": "surface", "surface_thickness": 1e-9}, "surface_thickness = 1e-09 m"),
        ({"geometry_kind": "surface", "stiffness.surface": 0.0}, "stiffness.surface"),
        ({"geometry_kind": "surface", "stiffness.torsion": -0.5}, "stiffness.torsion = -0.5 is"),
    ],
)
def test_settings_that_make_no_sense_are_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sheet_settings(values)


def test_settings_of_a_scene_file() -> None:
    assert sheet_settings({}) is None
    surface = sheet_settings({"geometry_kind": "surface"})
    assert surface == SheetSettings(SURFACE, 0.0, SheetStiffness(torsion=1.0))
    two = sheet_settings({"geometry_kind": "connected_surfaces", "stiffness.connecting": 0.3})
    assert two == SheetSettings(CONNECTED, 0.0, SheetStiffness(connecting=0.3))
    with pytest.raises(ValueError, match="cell is for tetrahedra; geometry_kind surface"):
        load("block", cell=0.01, sheet=surface)


def test_a_sheet_survives_messages_and_files(tmp_path: Path) -> None:
    mesh = sheet_mesh(shell(subdivisions=1), EVERYTHING, CONNECTED)
    message = conversions.mesh_to_topology(mesh, bytes(16), "organ", Time())
    saved = snapshot.take(mesh, np.zeros((mesh.node_capacity, 3)))
    snapshot.save(saved, tmp_path, "shell")
    again = snapshot.load(tmp_path, "shell")
    assert mesh.sheet is not None
    for other in (conversions.topology_to_mesh(message), Mesh(again.raw, again.fixed)):
        assert other.sheet is not None
        assert other.sheet.stiffness == mesh.sheet.stiffness
        for name in ("triangles", "thickness", "springs", "categories", "volumes"):
            np.testing.assert_array_equal(getattr(other.sheet, name), getattr(mesh.sheet, name))
    broken = replace(mesh.sheet, springs=mesh.sheet.springs + 10**6)
    snapshot.save(replace(saved, raw=replace(saved.raw, sheet=broken)), tmp_path, "broken")
    with pytest.raises(snapshot.SnapshotError, match="names a node that is not there"):
        snapshot.load(tmp_path, "broken")


def test_the_viewer_draws_every_triangle_of_a_sheet() -> None:
    mesh = connected()
    assert isinstance(mesh.sheet, Sheet)
    part = surface_of(mesh).outside
    np.testing.assert_array_equal(part.nodes[part.triangles], mesh.sheet.triangles)
    np.testing.assert_array_equal(surface_triangles(mesh), mesh.sheet.triangles)
    assert not len(surface_of(mesh).inside.triangles)


def test_the_default_procedure_cuts_sheets_and_only_by_splitting() -> None:
    mesh = connected()
    edge = 0.05 * np.array([[-1.0, 0, 0], [1, 0, 0], [0, 0, 2]])
    sweep = Sweep(edge, np.array([[0, 1, 2]], dtype=np.int32))
    with pytest.raises(CutError, match="made of triangles, which subdivide cannot cut") as refused:
        plan(mesh, mesh.rest[: mesh.node_rows], sweep, "subdivide")
    assert refused.value.code == CutCode.REFUSED
    mesh = load("wall", sheet=SheetSettings(CONNECTED)).mesh
    interaction = suggest_interaction(mesh)
    events = parse_procedure(yaml.safe_dump(default_procedure(interaction, 4.0))).events
    assert {event.action for event in events} == {"press", "cut", "release"}
    a, b, c, d = interaction.cut
    strip = Sweep.between(np.array([a, d]), np.array([b, c]))
    assert plan(mesh, mesh.rest[: mesh.node_rows], strip).report.faces_split > 0


def test_a_cut_sheet_survives_messages_and_files(tmp_path: Path) -> None:
    mesh = sheet_mesh(shell(subdivisions=1), EVERYTHING, CONNECTED)
    first, second = (
        Sweep.between(
            x + 0.05 * np.array([[0, -1, 1], [0, 1, 1]]),
            x + np.array([[0, -1, 0], [0, 1, 0]]) * 0.05,
        )
        for x in (np.array([0.001, 0.0, 0.0]), np.array([0.006, 0.0, 0.0]))
    )
    mesh.apply(plan(mesh, mesh.rest[: mesh.node_rows], first).edit)
    message = conversions.mesh_to_topology(mesh_for_keyframe(mesh), bytes(16), "organ", Time())
    late = conversions.topology_to_mesh(message)
    snapshot.save(snapshot.take(mesh, np.zeros((mesh.node_capacity, 3))), tmp_path, "cut")
    loaded = snapshot.load(tmp_path, "cut").mesh()
    assert mesh.sheet is not None
    for other in (late, loaded):
        assert other.sheet is not None
        for name in ("triangles", "springs", "categories", "volumes", "thickness", "walls"):
            assert len(getattr(other.sheet, name)) == len(getattr(mesh.sheet, name))
        assert other.sheet.volumes.sum() == pytest.approx(mesh.sheet.volumes.sum())
    # Who joined late has the same rows, and follows what comes then.
    edit = mesh.apply(plan(mesh, mesh.rest[: mesh.node_rows], second).edit).edit
    sent = edit_messages.edit_to_msg(edit, bytes(16), "organ", Time())
    late.apply(edit_messages.edit_from_msg(sent))
    for name in ("triangles", "springs", "categories", "volumes", "thickness", "walls"):
        np.testing.assert_array_equal(getattr(late.sheet, name), getattr(mesh.sheet, name))
    assert len(surface_of(mesh).inside.triangles) == len(mesh.sheet.walls) > 0


def test_real_segmentations_are_connected(shared_meshes: Path) -> None:
    file = shared_meshes / "toronto_chd" / "myo_2018002_tof.obj"
    geometry = load(file, "mm", sheet=SheetSettings(CONNECTED))
    assert geometry.mesh.sheet is not None
    assert geometry.mesh.sheet.count(CONNECTING) > geometry.mesh.node_rows
    assert any("11 nodes see no opposite side" in line for line in geometry.report.mended)
