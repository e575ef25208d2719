"""Regions and fibres: from files and scene files to each element, through saves and journals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
from typer.testing import CliRunner

from support.split_edit import split_at
from tissue_sim import snapshot
from tissue_sim.cli.mesh import app
from tissue_sim.elastic.model import Material, RegionMaterial
from tissue_sim.frame import Budget, FrameInputs
from tissue_sim.geometry.fibres import FibreError, fibres_of
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.regions import RegionError, paint, region_key
from tissue_sim.geometry.scene_geometry import load
from tissue_sim.geometry.shapes import block
from tissue_sim.journal import replay
from tissue_sim.parameters import ParameterError, refuse_unknown
from tissue_sim.scene import Scene
from tissue_sim.scene_file import read_scene
from tissue_sim.simulation import Simulation
from tissue_sim.simulation_parameters import Settings, specs

SIZE = 0.06


def grid(nodes: int = 4) -> RawMesh:
    return block(nodes, nodes, nodes, SIZE, SIZE, SIZE)


def settings(given: dict[str, object]) -> Settings:
    table = specs(given)
    refuse_unknown(given, [spec.name for spec in table])
    return Settings.of({s.name: s.checked(given.get(s.name, s.default)) for s in table})


def test_vectors_and_regions_of_a_vtu_file_reach_their_elements(tmp_path: Path) -> None:
    raw = grid()
    centroids = raw.points[raw.tetrahedra].mean(axis=1)
    fibres = np.cross([0.0, 0.0, 1.0], centroids - SIZE / 2)
    labels = (centroids[:, 2] > SIZE / 2).astype(np.int32) + 7
    cells = meshio.Mesh(
        raw.points, [("tetra", raw.tetrahedra)], cell_data={"region": [labels], "f": [fibres]}
    )
    file = tmp_path / "organ.vtu"
    cells.write(file)
    mesh = load(file, "m", fixed="low:z:0.1", fibres="cell:f").mesh
    assert_circles_in_halves(mesh)
    with pytest.raises(FibreError, match="organ has no cell vectors 'g'; its vectors: f"):
        load(file, "m", fibres="cell:g")
    told = CliRunner().invoke(app, ["info", str(file), "--units", "m"])
    assert "vectors of cells: f" in told.output
    again = tmp_path / "again.vtu"
    told = CliRunner().invoke(app, ["convert", str(file), str(again), "--units", "m"])
    assert told.exit_code == 0, told.output
    other = load(again, "mm", fixed="low:z:0.1", fibres="cell:f").mesh
    assert_circles_in_halves(other)


def assert_circles_in_halves(mesh: Mesh) -> None:
    """Fibres go round the middle, and the upper half is region 8, the lower one 7."""
    rows = mesh.element_rows
    centres = mesh.rest[mesh.tets[:rows]].mean(axis=1)
    wanted = np.cross([0.0, 0.0, 1.0], centres - SIZE / 2)
    wanted /= np.linalg.norm(wanted, axis=1)[:, None]
    np.testing.assert_allclose(mesh.fibres[:rows], wanted, atol=1e-6)
    np.testing.assert_array_equal(mesh.regions[:rows], 7 + (centres[:, 2] > SIZE / 2))


def test_scene_shapes_paint_regions_and_later_ones_win() -> None:
    raw = paint(grid(), {"core": "sphere:0.03,0.03,0.03,0.02", "top": "box:0,1,0,1,0.03,1"})
    centroids = raw.points[raw.tetrahedra].mean(axis=1)
    names = {name: label for label, name in raw.region_names.items()}
    top = centroids[:, 2] >= 0.03
    core = (np.linalg.norm(centroids - 0.03, axis=1) <= 0.02) & ~top
    assert ((raw.regions == names["top"]) == top).all()
    assert ((raw.regions == names["core"]) == core).all()
    assert core.any()


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("sphere:1,1,1,0.01", "takes no element; block lies from"),
        ("sphere:0,0,0", "is not understood; allowed: nothing"),
        ("box:0,0,0,1,0,1", "is not understood"),
        ("cone:1,2", "is not understood"),
        ("label:two", "names no whole number"),
        ("label:9", "no region '9'; its regions: 0"),
        ("", "no region 'scar'; its regions: 0"),
        ("name:left wall", "no region 'left wall'"),
    ],
)
def test_regions_that_are_not_there_are_refused(where: str, message: str) -> None:
    with pytest.raises(RegionError, match=message):
        paint(grid(), {"scar": where})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("along:1,2", "is not understood; allowed: none, cell:NAME"),
        ("along:0,0,0", "has no direction"),
        ("around:0,0,1:nan,0,0", "is not understood"),
        ("helix", "is not understood"),
    ],
)
def test_fibres_that_make_no_sense_are_refused(text: str, message: str) -> None:
    with pytest.raises(FibreError, match=message):
        fibres_of(grid(), text)


def test_vectors_that_do_not_fit_are_refused() -> None:
    raw = grid()
    wrong = np.zeros((3, 3))
    with pytest.raises(FibreError, match=r"shape \(3, 3\); allowed"):
        fibres_of(replace(raw, element_vectors={"f": wrong}), "cell:f")
    nan = np.full((len(raw.tetrahedra), 3), np.nan)
    with pytest.raises(FibreError, match="not finite"):
        fibres_of(replace(raw, element_vectors={"f": nan}), "cell:f")


def test_fibres_along_and_around_an_axis_are_unit_vectors() -> None:
    raw = grid()
    along = fibres_of(raw, "along:0,3,4")
    np.testing.assert_allclose(along, np.tile([0.0, 0.6, 0.8], (len(along), 1)), atol=1e-7)
    around = fibres_of(raw, "around:0,0,2")
    arms = raw.points[raw.tetrahedra].mean(axis=1) - SIZE / 2
    np.testing.assert_allclose(np.linalg.norm(around, axis=1), 1.0, atol=1e-6)
    assert np.abs((around * arms).sum(axis=1)).max() < 1e-8
    assert not fibres_of(raw, "none").any()


def test_a_scene_file_names_regions_and_their_materials() -> None:
    read = settings(
        {
            "young_modulus": 3e4, "fibre_stiffness": 1e4, "fibres": "along:1,0,0",
            "regions": ["scar", "valve"],
            "region.scar.where": "sphere:0.03,0.03,0.06,0.02",
            "region.scar.young_modulus": 2e5, "region.scar.fibre_stiffness": 0.0,
            "region.valve.where": "name:left valve", "region.valve.poisson_ratio": 0.3,
        }
    )  # fmt: skip
    assert read.regions == {"scar": "sphere:0.03,0.03,0.06,0.02", "valve": "name:left valve"}
    assert read.scene.material == Material(
        3e4, 0.45, 1060.0, 1e4,
        (
            RegionMaterial("scar", 2e5, 0.45, 1060.0, 0.0),
            RegionMaterial("left valve", 3e4, 0.3, 1060.0, 1e4),
        ),
    )  # fmt: skip
    assert region_key("old", "label:12") == "12"


def test_the_scene_of_the_documentation_is_one(tmp_path: Path) -> None:
    page = Path(__file__).resolve().parents[3] / "docs" / "materials.md"
    file = tmp_path / "scene.yaml"
    file.write_text(page.read_text(encoding="utf-8").split("```yaml\n")[1].split("```")[0])
    read = settings(dict(read_scene(file).simulation))
    assert [part.region for part in read.scene.material.regions] == ["aorta", "left atrium", "scar"]
    assert [part.fibre_stiffness for part in read.scene.material.regions] == [0.0, 2e4, 2e4]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"regions": ["a", "a"]}, "regions names a twice"),
        ({"region.a.young_modulus": 1e4}, "unknown parameter region.a.young_modulus"),
        ({"regions": ["a"], "region.a.density": -0.5}, "region.a.density = -0.5 is not allowed"),
        ({"regions": ["a"], "region.a.poisson_ratio": 0.7}, "region.a.poisson_ratio = 0.7"),
        ({"fibre_stiffness": -1.0}, "fibre_stiffness = -1.0 is not allowed"),
    ],
)
def test_scene_files_that_make_no_sense_are_refused(given: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        settings(given)


def fibrous() -> tuple[Mesh, Scene]:
    raw = paint(grid(), {"scar": "box:-1,1,-1,1,0.03,1"})
    raw = replace(raw, fibres=fibres_of(raw, "around:0,0,1"))
    fixed = np.zeros(len(raw.points), dtype=np.bool_)
    fixed[raw.node_sets["fixed"]] = True
    scar = RegionMaterial("scar", 2e5, 0.2, 1060.0, 1e5)
    scene = Scene("vertex_block_descent", material=Material(regions=(scar,)))
    return Mesh(raw, fixed), scene


def test_a_journal_replays_regions_and_fibres_on_a_keyframe_without_fibres() -> None:
    mesh, scene = fibrous()
    keyframe = Mesh(
        RawMesh(
            mesh.rest[: mesh.node_rows].copy(), mesh.tets[: mesh.element_rows].astype(np.int64),
            regions=mesh.regions[: mesh.element_rows].copy(), region_names=mesh.region_names,
        ),
        mesh.fixed[: mesh.node_rows].copy(),
    )  # fmt: skip
    shaken = np.random.default_rng(2).normal(scale=1e-3, size=(mesh.node_rows, 3))
    shaken[mesh.fixed[: mesh.node_rows]] = 0.0
    simulation = Simulation(mesh, replace(scene, displacement=shaken.astype(np.float32)))
    entries = [simulation.advance(FrameInputs(), Budget(steps=2)).journal]
    edits = FrameInputs(edits=(split_at(mesh, 0.02),))
    entries.append(simulation.advance(edits, Budget(steps=2)).journal)
    arguments = json.loads(json.dumps(entries[0].inputs.commands[0].arguments))
    assert Scene.from_arguments(arguments).material == scene.material
    again = replay(entries, keyframe)
    assert again.mismatches == ()
    rows = mesh.element_rows
    np.testing.assert_array_equal(keyframe.fibres[:rows], mesh.fibres[:rows])
    assert again.simulation.scene.material == scene.material


def test_a_saved_organ_keeps_its_fibres(tmp_path: Path) -> None:
    mesh, _ = fibrous()
    taken = snapshot.take(mesh, np.zeros((mesh.node_capacity, 3), dtype=np.float32))
    snapshot.save(taken, tmp_path, "organ")
    loaded = snapshot.load(tmp_path, "organ").mesh()
    rows = loaded.element_rows
    np.testing.assert_array_equal(loaded.fibres[:rows], mesh.fibres[:rows])
    assert loaded.fibres.any()
    assert loaded.region_names == mesh.region_names
    with np.load(tmp_path / "organ.npz") as file:
        older = {key: file[key] for key in file.files if key != "fibres"}
    np.savez(tmp_path / "older.npz", **older)
    assert not snapshot.load(tmp_path, "older").mesh().fibres.any()
