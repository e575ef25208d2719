"""Names, files and the `fixed` language become meshes; every mesh gets a place to work at."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest
import trimesh

from tissue_sim.geometry.fixed_nodes import fixed_nodes
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.scene_geometry import SHAPES, load, suggest_interaction
from tissue_sim.geometry.shapes import block, wall

BLOCK = block(5, 5, 5, 0.04, 0.04, 0.04)


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_is_ready_to_simulate(name: str) -> None:
    geometry = load(name)
    mesh = geometry.mesh
    assert mesh.node_rows == geometry.report.node_count == len(geometry.raw.points)
    assert 0 < mesh.fixed.sum() < mesh.node_rows / 2
    assert np.array_equal(mesh.fixed[: mesh.node_rows], fixed_nodes(geometry.raw, "auto"))
    assert not geometry.report.warnings


def test_parameters_of_shapes_are_checked() -> None:
    assert load("block", parameters={"nodes_x": 4, "size_x": 0.03}).mesh.node_rows == 4 * 13 * 13
    with pytest.raises(ValueError, match=r"wall has no parameter 'color'; allowed: columns"):
        load("wall", parameters={"color": 1})
    with pytest.raises(ValueError, match=r"columns = 4\.5 must be a whole number"):
        load("wall", parameters={"columns": 4.5})
    with pytest.raises(ValueError, match=r"neither a shape \(wall, block"):
        load("wal")


def test_files_are_found_in_the_scenes_folder_and_surfaces_are_filled(tmp_path: Path) -> None:
    meshio.write(tmp_path / "b.vtu", meshio.Mesh(1e3 * BLOCK.points, {"tetra": BLOCK.tetrahedra}))
    geometry = load("b.vtu", "mm", "low:x:0.1", folder=tmp_path)
    assert geometry.mesh.node_rows == 125
    assert geometry.mesh.fixed.sum() == 25
    trimesh.creation.icosphere(3, 30.0).export(tmp_path / "ball.stl")
    geometry = load(tmp_path / "ball.stl", "mm", cell=0.006)
    assert geometry.report.volume == pytest.approx(4 / 3 * np.pi * 0.03**3, rel=0.03)
    assert any("filled with" in text for text in geometry.report.mended)
    with pytest.raises(ValueError, match="units"):
        load(tmp_path / "ball.stl")
    with pytest.raises(ValueError, match="is a file; only shapes have parameters"):
        load(tmp_path / "ball.stl", "mm", parameters={"columns": 3})


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("auto", 25),
        ("none", 0),
        ("set:top", 25),
        ("low:z:0.1", 25),
        ("low:y", 25),
        ("high:x:0.3", 50),
        ("low:z:0.1+high:z:0.1", 50),
        ("set:top + box:-1,1,-1,1,-1,0", 50),
        ("box:0,0.011,0,0.011,0,0.011", 8),
    ],
)
def test_the_language_of_fixed_nodes(text: str, count: int) -> None:
    assert fixed_nodes(BLOCK, text).sum() == count


def test_auto_takes_the_lowest_tenth_along_the_longest_axis_without_a_set() -> None:
    raw = wall()
    bare = RawMesh(raw.points, raw.tetrahedra)
    assert np.array_equal(fixed_nodes(bare, "auto"), raw.points[:, 1] <= 0.01 + 1e-12)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("everything", "not understood; allowed: auto, none"),
        ("set:apex", "no node set 'apex'; its node sets: fixed, top"),
        ("low:w:0.1", "allowed: x, y or z"),
        ("low:z:1.5", "between 0 and 1"),
        ("low:z:much", "'much' in 'low:z:much' is not a number"),
        ("box:0,1,0,1", "box:x0,x1"),
        ("box:1,0,0,1,0,1", "x0 <= x1"),
        ("box:5,6,5,6,5,6", "takes no node; block lies from"),
        ("", "not understood"),
        ("box:-1,1,-1,1,-1,1", "fixes all nodes"),
    ],
)
def test_what_cannot_be_fixed_is_said(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        fixed_nodes(BLOCK, text)


@pytest.mark.parametrize("name", SHAPES)
def test_the_suggested_place_can_be_grabbed_pulled_and_cut(name: str) -> None:
    mesh = load(name).mesh
    points = mesh.rest[: mesh.node_rows]
    place = suggest_interaction(mesh)
    size = np.ptp(points, axis=0).max()
    distance = np.linalg.norm(points - place.grab_point, axis=1)
    assert distance.min() < 1e-12
    held = (distance <= place.radius) & ~mesh.fixed[: mesh.node_rows]
    assert 10 <= held.sum() <= 200
    assert np.linalg.norm(place.pull) == pytest.approx(0.15 * size)
    assert place.pull @ place.outward > 0
    # The tool starts in free space: nearer to the grab point than to any other part of the organ.
    start = np.linalg.norm(points - place.tool_start, axis=1).min()
    assert start > 0.03 * size
    # The cut passes through elements: corners of some lie on both sides, within the rectangle.
    a, b, _, d = place.cut
    u, v = b - a, d - a
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    corners = points[mesh.tets[: mesh.element_rows]]
    side = (corners - a) @ normal
    crossed = (side.min(axis=1) < 0) & (side.max(axis=1) > 0)
    middle = corners.mean(axis=1) - a
    along_u, along_v = middle @ u, middle @ v
    inside = (along_u > 0) & (along_u < u @ u) & (along_v > 0) & (along_v < v @ v)
    assert (crossed & inside).sum() >= 20
