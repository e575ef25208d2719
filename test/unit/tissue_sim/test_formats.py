"""Every format gives the same mesh, and damage gives one clear error."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tissue_sim.geometry.errors import MeshFileError
from tissue_sim.geometry.faces import face_nodes, pair_faces
from tissue_sim.geometry.formats import READERS, load
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block

BLOCK = block(4, 3, 3, 0.03, 0.02, 0.02)
MILLIMETRES = 1e3 * BLOCK.points
SURFACE = face_nodes(BLOCK.tetrahedra, pair_faces(BLOCK.tetrahedra).border)


def write_tetgen(path: Path, first: int = 1, step: int = 1) -> Path:
    ids = first + step * np.arange(len(MILLIMETRES))
    node = [f"# made by a test\n{len(ids)} 3 0 1"]
    node += [f"{i}  {x!r} {y!r} {z!r}  {int(x == 0)}"
             for i, (x, y, z) in zip(ids.tolist(), MILLIMETRES.tolist(), strict=True)]  # fmt: skip
    path.with_suffix(".node").write_text("\n".join(node) + "\n# end\n")
    ele = [f"{len(BLOCK.tetrahedra)} 4 1"]
    ele += [f"{first + k} {' '.join(map(str, ids[t]))} {k % 2 + 1}"
            for k, t in enumerate(BLOCK.tetrahedra)]  # fmt: skip
    path.with_suffix(".ele").write_text("\n\n".join(ele))
    return path.with_suffix(".ele")


def write_smesh(path: Path) -> Path:
    lines = [f"{len(MILLIMETRES)} 3 0 0"]
    lines += [f"{i} {x!r} {y!r} {z!r}" for i, (x, y, z) in enumerate(MILLIMETRES.tolist())]
    lines += [f"{len(SURFACE)} 0", *(f"3 {a} {b} {c}" for a, b, c in SURFACE.tolist()), "0", "0"]
    path.write_text("\n".join(lines))
    return path


def write_3ds(path: Path) -> Path:
    def chunk(kind: int, payload: bytes) -> bytes:
        return struct.pack("<HI", kind, 6 + len(payload)) + payload

    vertices = struct.pack("<H", len(MILLIMETRES)) + MILLIMETRES.astype("<f4").tobytes()
    flags = np.zeros((len(SURFACE), 1))
    faces = struct.pack("<H", len(SURFACE)) + np.hstack([SURFACE, flags]).astype("<u2").tobytes()
    mesh = chunk(0x4100, chunk(0x4110, vertices) + chunk(0x4120, faces + chunk(0x4150, b"")))
    editor = chunk(0x3D3E, b"\3\0\0\0") + chunk(0x4000, b"heart\0" + mesh)
    path.write_bytes(chunk(0x4D4D, chunk(0x0002, b"\3\0\0\0") + chunk(0x3D3D, editor)))
    return path


def write_meshio(path: Path, form: str, **options: object) -> Path:
    mesh = meshio.Mesh(
        MILLIMETRES,
        [("tetra", BLOCK.tetrahedra)],
        cell_data={"region": [np.arange(len(BLOCK.tetrahedra)) % 2 + 1]},
        point_data={"fixed": (MILLIMETRES[:, 2] == 0).astype(np.int32)},
    )
    meshio.write(path, mesh, file_format=form, **options)
    return path


VOLUMES: dict[str, Callable[[Path], Path]] = {
    "tetgen from 1": lambda d: write_tetgen(d / "a.node"),
    "tetgen from 0": lambda d: write_tetgen(d / "a.node", first=0),
    "tetgen with gaps": lambda d: write_tetgen(d / "a.node", first=7, step=3),
    "gmsh 2.2 text": lambda d: write_meshio(d / "a.msh", "gmsh22", binary=False),
    "gmsh 2.2 binary": lambda d: write_meshio(d / "a.msh", "gmsh22", binary=True),
    "gmsh 4.1 text": lambda d: write_meshio(d / "a.msh", "gmsh", binary=False),
    "gmsh 4.1 binary": lambda d: write_meshio(d / "a.msh", "gmsh", binary=True),
    "vtk text": lambda d: write_meshio(d / "a.vtk", "vtk", binary=False),
    "vtk binary": lambda d: write_meshio(d / "a.vtk", "vtk", binary=True),
    "vtu text": lambda d: write_meshio(d / "a.vtu", "vtu", binary=False),
    "vtu compressed": lambda d: write_meshio(d / "a.vtu", "vtu", compression="zlib"),
}


@pytest.mark.parametrize("name", VOLUMES)
def test_volume_formats_give_the_mesh_that_was_written(name: str, tmp_path: Path) -> None:
    raw = load(VOLUMES[name](tmp_path), "mm")
    np.testing.assert_allclose(raw.points, BLOCK.points, rtol=1e-12, atol=1e-15)
    assert np.array_equal(raw.tetrahedra, BLOCK.tetrahedra)


def test_file_ids_regions_and_markers_of_tetgen_are_kept(tmp_path: Path) -> None:
    raw = load(write_tetgen(tmp_path / "a.node", first=7, step=3), "mm")
    assert raw.node_file_ids.tolist() == (7 + 3 * np.arange(len(raw.points))).tolist()
    assert raw.element_file_ids[:3].tolist() == [7, 8, 9]
    assert raw.regions[:4].tolist() == [1, 2, 1, 2]
    assert np.array_equal(raw.node_sets["marker_1"], np.flatnonzero(raw.points[:, 0] == 0))


def test_regions_and_the_fixed_nodes_of_a_vtu_are_kept(tmp_path: Path) -> None:
    raw = load(write_meshio(tmp_path / "a.vtu", "vtu"), "mm")
    assert raw.regions[:4].tolist() == [1, 2, 1, 2]
    assert np.array_equal(raw.node_sets["fixed"], np.flatnonzero(raw.points[:, 2] == 0))


def test_named_groups_of_gmsh_become_regions_and_node_sets(tmp_path: Path) -> None:
    path = tmp_path / "a.msh"
    path.write_text(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
        '$PhysicalNames\n2\n2 5 "fixed"\n3 9 "muscle"\n$EndPhysicalNames\n'
        "$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$EndNodes\n"
        "$Elements\n2\n1 2 2 5 1 1 2 3\n2 4 2 9 1 1 2 3 4\n$EndElements\n"
    )
    raw = load(path, "m")
    assert raw.region_names == {9: "muscle"}
    assert raw.regions.tolist() == [9]
    assert raw.node_sets["fixed"].tolist() == [0, 1, 2]


def written_by_trimesh(path: Path, **options: object) -> Path:
    trimesh.Trimesh(MILLIMETRES, SURFACE, process=False).export(path, **options)
    return path


SURFACES: dict[str, Callable[[Path], Path]] = {
    "obj": lambda d: written_by_trimesh(d / "a.obj"),
    "stl binary": lambda d: written_by_trimesh(d / "a.stl"),
    "stl text": lambda d: written_by_trimesh(d / "a.stl", file_type="stl_ascii"),
    "ply binary": lambda d: written_by_trimesh(d / "a.ply"),
    "ply text": lambda d: written_by_trimesh(d / "a.ply", encoding="ascii"),
    "smesh": lambda d: write_smesh(d / "a.smesh"),
    "3ds": lambda d: write_3ds(d / "a.3ds"),
}


@pytest.mark.parametrize("name", SURFACES)
def test_surface_formats_enclose_the_volume_that_was_written(name: str, tmp_path: Path) -> None:
    raw = load(SURFACES[name](tmp_path), "mm")
    assert len(raw.triangles) == len(SURFACE)
    assert not len(raw.tetrahedra)
    volume = trimesh.Trimesh(raw.points, raw.triangles).volume
    assert volume == pytest.approx(0.03 * 0.02 * 0.02, rel=1e-5)


def test_obj_faces_of_all_notations_are_understood(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text(
        "mtllib no.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0 # corner\nv 0 1 0\nvt 0 0\nvn 0 0 1\n"
        "usemtl skin\nf 1/1 2/1 3/1 4/1\nf 1//1 2//1 3//1\nf 1/1/1 2/1/1 3/1/1\nf -4 -3 -2\n"
    )
    assert load(path, "m").triangles.tolist() == [[0, 1, 2], [0, 2, 3]] + 3 * [[0, 1, 2]]


@pytest.mark.parametrize("units", [None, "", "cm", "MM"])
def test_units_are_never_guessed(units: str | None, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="mm"):
        load(write_tetgen(tmp_path / "a.node"), units)


def test_units_scale_the_coordinates(tmp_path: Path) -> None:
    path = write_tetgen(tmp_path / "a.node")
    np.testing.assert_allclose(load(path, "m").points, 1e3 * load(path, "mm").points)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("a.glb", "surface scene format.*convert.*supported are"),
        ("a.gltf", "surface scene format"),
        ("a.nii", "voxel labels.*meshing.*not offered yet"),
        ("a.nii.gz", "voxel labels"),
        ("a.docx", "unknown mesh format '.docx'.*supported are"),
        ("a", "no suffix"),
        ("missing.vtu", "no such file"),
    ],
)
def test_what_is_not_offered_is_refused_with_the_reason(
    name: str, reason: str, tmp_path: Path
) -> None:
    if "missing" not in name:
        (tmp_path / name).write_bytes(b"glTF")
    with pytest.raises(MeshFileError, match=reason):
        load(tmp_path / name, "mm")


@pytest.mark.parametrize("suffix", sorted(READERS))
@pytest.mark.parametrize(
    "content", [b"", b"\0" * 64, b"hello\n", b"9999999999999 3 0 0\n1 0 0 0\n"]
)
def test_files_that_are_no_mesh_are_refused(suffix: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    path.with_suffix(".node").write_bytes(content)
    with pytest.raises(MeshFileError, match=r"a\."):
        load(path, "mm")


@pytest.mark.parametrize("name", [*VOLUMES, *SURFACES])
def test_cut_off_files_are_refused_or_complete(name: str, tmp_path: Path) -> None:
    path = {**VOLUMES, **SURFACES}[name](tmp_path)
    whole = load(path, "mm")
    content = path.read_bytes()
    for share in (0.02, 0.2, 0.5, 0.8, 0.95):
        path.write_bytes(content[: int(share * len(content))])
        try:
            raw = load(path, "mm")
        except MeshFileError:
            continue
        # A text format without counts (OBJ), or a cut behind the last cell.
        assert name == "obj" or same_cells(raw, whole)


def same_cells(a: RawMesh, b: RawMesh) -> bool:
    return np.array_equal(a.tetrahedra, b.tetrahedra) and np.array_equal(a.triangles, b.triangles)


@pytest.mark.parametrize(
    ("suffix", "line", "text", "reason"),
    [
        (".node", 2, "1 nan 0 0 0", "not finite.*node 1"),
        (".node", 2, "1 1e300 0 0 0", "not finite or beyond.*node 1"),
        (".node", 2, "1 0 0", "line 3: 2 numbers, 3"),
        (".node", 3, "1 0 0 0 0", "line 4: node 1 is given twice"),
        (".node", 1, "-5 3 0 0", "line 2: a count of -5"),
        (".node", 1, "36 2 0 1", "line 2: nodes have dimension 2"),
        (".node", 1, "99999999999 3 0 1", "the file ends where node 37"),
        (".ele", 2, "1 -1 2 3 4 1", "line 3: element 1 names node -1"),
        (".ele", 2, "1 1 2 3 400 1", "line 3: element 1 names node 400"),
        (".ele", 2, "1 1 2 3 x 1", "line 3: whole numbers are wanted"),
        (".ele", 0, "12 10 0", "line 1: elements of 10 nodes"),
        (".ele", 0, "0 4 0", "no tetrahedra and no triangles"),
    ],
)
def test_damage_in_tetgen_files_is_named_with_its_line(
    suffix: str, line: int, text: str, reason: str, tmp_path: Path
) -> None:
    path = write_tetgen(tmp_path / "a.node").with_suffix(suffix)
    lines = path.read_text().split("\n")
    lines[line] = text
    path.write_text("\n".join(lines))
    with pytest.raises(MeshFileError, match=reason):
        load(path, "mm")


def test_cells_that_cannot_be_simulated_are_refused_not_skipped(tmp_path: Path) -> None:
    path = tmp_path / "a.vtu"
    cube = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
    cells = [("hexahedron", [[0, 1, 3, 2, 4, 5, 7, 6]]), ("tetra", [[0, 1, 2, 4]])]
    meshio.write(path, meshio.Mesh(cube, cells))
    with pytest.raises(MeshFileError, match=r"1 hexahedron.*linear tetrahedra"):
        load(path, "mm")


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    name=st.sampled_from(["3ds", "stl binary", "ply binary", "gmsh 4.1 binary", "vtu compressed"]),
    place=st.floats(0, 1, exclude_max=True),
    value=st.integers(0, 255),
)
def test_a_flipped_byte_never_gives_anything_but_a_mesh_or_a_mesh_file_error(
    name: str, place: float, value: int, tmp_path: Path
) -> None:
    path = {**VOLUMES, **SURFACES}[name](tmp_path)
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] = value
    path.write_bytes(bytes(content))
    try:
        raw = load(path, "mm")
    except MeshFileError:
        return
    assert np.isfinite(raw.points).all()
    for items in (raw.tetrahedra, raw.triangles):
        assert not len(items) or 0 <= items.min() <= items.max() < len(raw.points)


def test_real_meshes_are_read_as_meshio_and_trimesh_read_them(shared_meshes: Path) -> None:
    path = shared_meshes / "rodero_adult_heart" / "rodero_01_fullheart_2.0mm.vtu"
    raw, mesh = load(path, "mm"), meshio.read(path)
    assert np.array_equal(raw.tetrahedra, mesh.cells_dict["tetra"])
    np.testing.assert_allclose(raw.points, 1e-3 * mesh.points)
    assert set(raw.regions.tolist()) == set(range(1, 8))
    obj = load(shared_meshes / "toronto_chd" / "myo_2018002_tof.obj", "mm")
    assert (len(obj.points), len(obj.triangles)) == (7387, 15958)
    oracle = trimesh.load_mesh(shared_meshes / "toronto_chd" / "myo_2018002_tof.obj")
    assert trimesh.Trimesh(obj.points, obj.triangles).area == pytest.approx(1e-6 * oracle.area)
    for name in ("hra_organs/VH_M_Spleen.glb", "labels/example_seg.nii.gz"):
        with pytest.raises(MeshFileError, match="supported are"):
            load(shared_meshes / name, "mm")
