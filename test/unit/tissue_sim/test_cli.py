"""The command says what a person did wrong in one line, and starts nothing then."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from support.tissue_command import tissue
from tissue_sim.cli.main import BAD_INPUT
from tissue_sim.geometry.formats import load
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block


@pytest.fixture(autouse=True)
def _own_arguments(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "argv", ["tissue"])
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def mesh_file(tmp_path: Path) -> Path:
    """A block in mm."""
    import meshio

    raw = block(4, 4, 4)
    file = tmp_path / "block.vtu"
    meshio.Mesh(raw.points * 1e3, [("tetra", raw.tetrahedra)]).write(file)
    return file


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["run", "nowhere"], "there are block, heart, sphere_shell, wall"),
        (["run", "nowhere.yaml"], "cannot be read"),
        (["run", "nowhere.vtu", "--units", "mm"], "no such file"),
        (["run", "block.vtu"], "--units mm or --units m"),
        (["run", "block.vtu", "--units", "inch"], "allowed: mm, m"),
        (["run", "block.vtu", "--units", "mm", "--fixed", "low:w:0.1"], "allowed: x, y or z"),
        (["run", "wall", "--model", "jelly"], "lr, quasi_static, relaxation, spring_mass"),
        (["run", "wall", "--procedure", "none.yaml"], "none.yaml: cannot be read"),
        (["run", "wall", "--procedure", "bad.yaml"], "bad.yaml:1: procedure: unknown key"),
        (["run", "scan.nii.gz", "--units", "mm"], "voxel labels"),
        (["run", "organ.glb", "--units", "m"], "not read yet"),
        (["replay", "none"], "none"),
        (["replay", "wall", "--model", "jelly"], "lr, quasi_static"),
        (["mesh", "info", "block.vtu"], "--units mm or --units m"),
        (["mesh", "check", "none.stl", "--units", "m"], "no such file"),
        (["mesh", "convert", "block.vtu", "b.docx", "--units", "mm"], "can write .vtu"),
    ],
)
def test_mistake_is_one_line_and_exit_code_2(
    capsys: pytest.CaptureFixture[str],
    mesh_file: Path,
    tmp_path: Path,
    arguments: list[str],
    says: str,
) -> None:
    (tmp_path / "bad.yaml").write_text("colour: red\n")
    for name in ("scan.nii.gz", "organ.glb"):
        (tmp_path / name).write_bytes(b"x")
    code, _, errors = tissue(capsys, *arguments)
    assert code == BAD_INPUT
    assert says in errors
    assert "Traceback" not in errors
    assert len(errors.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").rglob("*.log"))


def test_scene_file_with_a_mistake_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for text, says in (
        ("- 1", "must map node names"),
        ("a: [", "no valid YAML"),
        ("tissue_sim: {geometry: wall}", "must hold ros__parameters"),
        ("/**/other: {ros__parameters: {a: 1}}", "has no /**/tissue_sim"),
    ):
        (tmp_path / "scene.yaml").write_text(text)
        code, _, errors = tissue(capsys, "run", "scene.yaml")
        assert code == BAD_INPUT
        assert says in errors


def test_mesh_info_and_check_say_what_a_file_holds(
    capsys: pytest.CaptureFixture[str], mesh_file: Path
) -> None:
    code, out, _ = tissue(capsys, "mesh", "info", str(mesh_file), "--units", "mm")
    assert code == 0
    assert "64 nodes, 162 tetrahedra, 60 x 60 x 60 mm" in out
    assert "from (0.0, 0.0, 0.0) to (60.0, 60.0, 60.0) mm" in out
    code, out, _ = tissue(capsys, "mesh", "check", str(mesh_file), "--units", "mm")
    assert code == 0
    assert "can be simulated" in out


def test_mesh_that_is_refused_is_exit_code_1(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    open_surface = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"
    (tmp_path / "open.obj").write_text(open_surface)
    code, out, _ = tissue(capsys, "mesh", "check", "open.obj", "--units", "mm")
    assert code == 1
    assert "refused" in out


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".msh"])
def test_converted_mesh_is_the_same_tissue(
    capsys: pytest.CaptureFixture[str], mesh_file: Path, tmp_path: Path, suffix: str
) -> None:
    target = tmp_path / f"converted{suffix}"
    arguments = ("mesh", "convert", str(mesh_file), str(target), "--units", "mm", "--to-units", "m")
    code, _, errors = tissue(capsys, *arguments)
    assert code == 0, errors
    before, after = load(mesh_file, "mm"), load(target, "m")
    assert volume(after) == pytest.approx(volume(before))
    assert len(after.tetrahedra) == len(before.tetrahedra)


def test_surface_of_a_mesh_is_written_as_stl(
    capsys: pytest.CaptureFixture[str], mesh_file: Path, tmp_path: Path
) -> None:
    target = tmp_path / "surface.stl"
    assert tissue(capsys, "mesh", "convert", str(mesh_file), str(target), "--units", "mm")[0] == 0
    raw = load(target, "mm")
    corners = raw.points[raw.triangles]
    enclosed = (
        np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    )
    assert enclosed == pytest.approx(0.06**3)


def volume(raw: RawMesh) -> float:
    a, b, c, d = (raw.points[raw.tetrahedra[:, corner]] for corner in range(4))
    return float(np.abs(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a))).sum() / 6)


def test_help_names_every_command() -> None:
    """In a process of its own, as a person runs it."""
    script = "from tissue_sim.cli import main; main()"
    result = subprocess.run(
        [sys.executable, "-c", script, "--help"], capture_output=True, text=True, timeout=60
    )
    assert result.returncode == 0
    for command in ("run", "demo", "replay", "bench", "mesh", "bag"):
        assert command in result.stdout
