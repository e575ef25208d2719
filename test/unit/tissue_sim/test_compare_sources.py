"""Motions and scripts hold what they say they hold, where they say they hold it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tissue_sim.compare.effort import Effort
from tissue_sim.compare.interaction import Interaction, InteractionError
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ, organ_of
from tissue_sim.compare.sources.axes import axes_at
from tissue_sim.compare.sources.choose import interaction_from
from tissue_sim.compare.sources.motions import MOTIONS, default_amplitude, motion
from tissue_sim.compare.sources.script import interaction_of_script
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import simulate
from tissue_sim.elastic.model import Material
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.geometry.shapes import wall

SMALL = {"columns": 9, "rows": 13}
SOFT = Material(young_modulus=2e4)


@pytest.fixture(scope="module")
def small_wall() -> Organ:
    return load_organ("wall", parameters=SMALL)


@pytest.fixture(scope="module")
def shell() -> Organ:
    return load_organ("sphere_shell", parameters={"subdivisions": 3})


def turned_wall(turn: Rotation) -> Organ:
    """The wall, placed differently in space."""
    raw = wall(**SMALL)
    moved = replace(raw, points=turn.apply(raw.points) + np.array([0.3, -0.2, 0.1]))
    fixed = np.zeros(len(raw.points), dtype=np.bool_)
    fixed[raw.node_sets["fixed"]] = True
    return organ_of("wall", Mesh(moved, fixed), moved)


# Organs


def test_a_scene_file_is_the_organ_of_its_parameters(tmp_path: Path) -> None:
    scene = tmp_path / "mine.yaml"
    body = "geometry: wall, shape.columns: 9, shape.rows: 13, young_modulus: 20000.0"
    scene.write_text(f"/**/tissue_sim: {{ros__parameters: {{{body}}}}}\n")
    organ = load_organ(str(scene))
    assert organ.digest == load_organ("wall", parameters=SMALL).digest
    assert organ.material == SOFT
    assert load_organ(str(scene), material=Material()).material == Material()


@pytest.mark.parametrize("kind", ["volume", "surface", "connected_surfaces"])
def test_the_hold_is_free_and_the_same_of_every_kind(kind: str) -> None:
    organ = load_organ("wall", parameters=SMALL, geometry_kind=kind)
    assert not organ.mesh.fixed[organ.hold].any()
    assert (organ.rest[organ.hold][:, 1] > 0.09).all()
    assert len(organ.hold) > 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"name_or_path": "liver"}, r"neither a shape \(wall"),
        ({"name_or_path": "liver.vtu", "units": "mm"}, "liver.vtu"),
        ({"name_or_path": "wall", "geometry_kind": "jelly"}, "allowed: volume, surface"),
        ({"name_or_path": "wall", "parameters": {"colums": 3}}, "no parameter 'colums'; allowed"),
        ({"name_or_path": "config/wall.yaml", "units": "mm"}, "scene file: it says units"),
    ],
)
def test_organs_that_do_not_exist_are_refused(arguments: dict[str, object], said: str) -> None:
    with pytest.raises((ValueError, OSError), match=said):
        load_organ(**arguments)  # type: ignore[arg-type]


def test_a_misspelt_parameter_of_a_scene_is_refused(tmp_path: Path) -> None:
    scene = tmp_path / "mine.yaml"
    scene.write_text("/**/tissue_sim: {ros__parameters: {geometry: wall, young_modulu: 1.0}}\n")
    with pytest.raises(ValueError, match="did you mean young_modulus"):
        load_organ(str(scene))


# Directions


def test_the_wall_is_pulled_out_of_its_plane_and_away_from_its_fixed_sides(
    small_wall: Organ,
) -> None:
    axes = axes_at(small_wall)
    np.testing.assert_allclose(axes.normal, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(axes.in_plane, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(axes.side, [-1, 0, 0], atol=1e-12)


def test_the_normal_of_a_shell_points_from_its_centre(shell: Organ) -> None:
    outward = shell.rest[shell.hold].mean(axis=0) - shell.rest.mean(axis=0)
    axes = axes_at(shell)
    assert axes.normal @ outward > 0.99 * np.linalg.norm(outward)
    frame = np.stack([axes.in_plane, axes.normal, axes.side])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(-1.0)  # side = normal x in_plane


def test_motions_in_the_plane_turn_with_the_organ() -> None:
    turn = Rotation.from_rotvec([0.4, -0.9, 0.7])
    here = motion("in_plane", turned_wall(Rotation.identity()), 0.01)
    there = motion("in_plane", turned_wall(turn), 0.01)
    moved = turn.apply(here.displacement.reshape(-1, 3)).reshape(here.displacement.shape)
    np.testing.assert_allclose(there.displacement, moved, atol=1e-9)


# The five motions


@pytest.mark.parametrize("name", MOTIONS)
def test_a_motion_stretches_and_then_holds_still(small_wall: Organ, name: str) -> None:
    made = motion(name, small_wall, amplitude=0.01).checked(small_wall)
    assert made.rate_hz == 30.0
    assert made.seconds == pytest.approx(6.0 if name == "regrab" else 4.5)
    assert made.amplitude == pytest.approx(0.01, rel=1e-3)
    still = made.displacement[-60 if name == "regrab" else -90 :]
    assert not np.ptp(still, axis=0).any()
    # From rest on it never jumps farther than its speed.
    first = np.linalg.norm(made.displacement[0], axis=-1).max()
    assert 0.0 < first < 0.0021
    assert (np.linalg.norm(np.diff(made.displacement[:45], axis=0), axis=-1) < 0.0011).all()


@pytest.mark.parametrize(
    ("name", "direction"),
    [("in_plane", [0, 1, 0]), ("normal", [0, 0, 1]), ("oblique", [0, 0.5**0.5, 0.5**0.5])],
)
def test_a_straight_pull_has_constant_speed(
    small_wall: Organ, name: str, direction: list[float]
) -> None:
    made = motion(name, small_wall, 0.012, rate_hz=20.0, pull_seconds=1.0, hold_seconds=0.5)
    expected = 0.012 * np.minimum(np.arange(1, 31) / 20, 1.0)[:, None] * np.array(direction)
    for row in range(len(made.nodes)):
        np.testing.assert_allclose(made.displacement[:, row], expected, atol=1e-12)
    np.testing.assert_array_equal(made.nodes, small_wall.hold)


def test_the_circle_is_one_through_rest_that_ends_farthest_out(small_wall: Organ) -> None:
    way = motion("circular", small_wall, 0.01).displacement[:, 0]
    centre = np.array([0.0, 0.005, 0.0])
    np.testing.assert_allclose(np.linalg.norm(way - centre, axis=1), 0.005, atol=1e-12)
    np.testing.assert_allclose(way[:, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(way[-1], [0.0, 0.01, 0.0], atol=1e-12)
    np.testing.assert_allclose(way[29], [0.0, 0.0, 0.0], atol=1e-12)  # after one whole turn


@pytest.mark.parametrize("model", ["finite_element", "quasi_static"])
def test_tissue_is_grabbed_again_where_the_reference_has_it(small_wall: Organ, model: str) -> None:
    decides = Subject(model, effort=Effort(steps=40 if model == "finite_element" else 2))
    made = motion("regrab", small_wall, 0.01, reference=decides)
    held = np.asarray(made.held.any(axis=1))
    assert held[:45].all()
    assert not held[45:75].any()
    assert held[75:].all()
    again = made.held_rows(75)
    assert len(again) == len(small_wall.hold)
    assert len(np.setdiff1d(again, small_wall.hold)) > 0
    before = Interaction(
        "before", 30.0, made.nodes, made.held[:75], made.displacement[:75], made.organ
    )
    there = simulate(decides, small_wall, before).displacement[-1, again]
    step = 0.01 / 45 * np.array([0.0, 0.5**0.5, 0.5**0.5])
    np.testing.assert_allclose(made.displacement[75][made.held[75]], there + step, atol=1e-9)
    # Linear finite elements are back at rest at once; the springs with few steps are not.
    assert (np.abs(there).max() > 1e-4) == (model == "quasi_static")


def test_the_default_amplitudes_turn_no_element_over(small_wall: Organ, shell: Organ) -> None:
    exact = Subject("finite_element", effort=Effort.parse("rest"))
    for organ in (small_wall, shell):
        tets = organ.mesh.tets[: organ.mesh.element_rows]
        for name in ("in_plane", "normal", "oblique"):
            made = motion(name, organ, pull_seconds=0.1, hold_seconds=0.1)
            assert made.amplitude == pytest.approx(default_amplitude(organ))
            shape = organ.rest + simulate(exact, organ, made).displacement[-1]
            assert (signed_volumes(shape, tets) > 0.0).all()
    assert default_amplitude(load_organ("wall")) == pytest.approx(0.015)


def test_a_sheet_can_be_grabbed_again() -> None:
    organ = load_organ("wall", parameters=SMALL, geometry_kind="connected_surfaces")
    made = motion("regrab", organ, pull_seconds=0.2, hold_seconds=0.3)
    assert made.checked(organ).held[-1].any()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sideways", r"there is no interaction 'sideways'; allowed: a motion \(in_plane, normal"),
        ("normal:far", "amplitude 'far' of normal is no number"),
        ("normal:0", r"amplitude 0 mm is out of range; allowed on wall: 0\.001 to 100 mm"),
        ("normal:-3", "amplitude -3 mm is out of range"),
        ("normal:nan", "amplitude nan mm is out of range"),
        ("normal:200", "amplitude 200 mm is out of range"),
    ],
)
def test_motions_that_make_no_sense_are_refused(small_wall: Organ, text: str, said: str) -> None:
    with pytest.raises(InteractionError, match=said):
        interaction_from(text, small_wall)


def test_what_else_cannot_be_moved_is_refused(small_wall: Organ) -> None:
    with pytest.raises(InteractionError, match="there is no motion 'pull'; allowed: in_plane"):
        motion("pull", small_wall)
    with pytest.raises(InteractionError, match="rate_hz = 0 is out of range; allowed: 1 to 1000"):
        motion("normal", small_wall, rate_hz=0.0)
    with pytest.raises(InteractionError, match=r"pull_seconds = 0\.001 s is out of range"):
        motion("normal", small_wall, pull_seconds=1e-3)
    with pytest.raises(InteractionError, match="no free node to hold"):
        motion("normal", replace(small_wall, hold=np.empty(0, dtype=np.int32)))
    with pytest.raises(InteractionError, match="says of no organ"):
        interaction_from("normal")


def test_an_amplitude_is_given_in_millimetres(small_wall: Organ) -> None:
    assert interaction_from("oblique:7.5", small_wall).interaction.amplitude == pytest.approx(
        7.5e-3
    )
    assert interaction_from("normal", small_wall, rate_hz=60.0).interaction.frames == 270


def test_a_folder_does_not_hide_a_motion_of_its_name(
    small_wall: Organ, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "normal").mkdir()
    monkeypatch.chdir(tmp_path)
    assert interaction_from("normal", small_wall).interaction.name == "normal"


def test_a_kept_interaction_is_read_back(small_wall: Organ, tmp_path: Path) -> None:
    made = motion("oblique", small_wall)
    made.save(tmp_path / "pull.npz")
    found = interaction_from(str(tmp_path / "pull.npz"), small_wall)
    np.testing.assert_array_equal(found.interaction.displacement, made.displacement)
    with pytest.raises(InteractionError, match="oblique has no measured positions: it holds an"):
        found.reference()
    with pytest.raises(InteractionError, match=r"another topology .* than block"):
        interaction_from(str(tmp_path / "pull.npz"), load_organ("block"))
    (tmp_path / "words.npz").write_text("no archive")
    with pytest.raises(InteractionError, match=r"words\.npz is no NumPy archive"):
        interaction_from(str(tmp_path / "words.npz"), small_wall)


# Scripts

SCRIPT = """\
title: lift and cut
units: mm
tools:
  grasper: {kind: grab, shape: sphere, size: [9], start: {position: [32, 120, 2]}}
  knife: {kind: cut, start: {position: [32, 50, 40]}}
timeline:
  - {at: 0.0, move: grasper, to: [32, 100, 2], for: 0.5}
  - {at: 0.6, press: grasper}
  - {at: 1.0, move: grasper, by: [0, 3, 9], for: 1.0}
  - {at: 2.5, CHANGE}
  - {at: 3.0, release: grasper}
end: 3.5
"""


def script(folder: Path, change: str = "label: still") -> Path:
    path = folder / "lift.yaml"
    path.write_text(SCRIPT.replace("CHANGE", change))
    return path


def test_a_script_moves_what_it_holds_as_it_says(small_wall: Organ, tmp_path: Path) -> None:
    """The nodes in reach follow the minimum-jerk motion; what comes before the press is gone."""
    found = interaction_of_script(script(tmp_path), small_wall)
    assert found.notes == ()
    made = found.interaction
    reach = np.linalg.norm(small_wall.rest - [0.032, 0.1, 0.002], axis=1) <= 0.009
    np.testing.assert_array_equal(made.nodes, np.flatnonzero(reach))
    held = np.asarray(made.held.all(axis=1))
    assert made.seconds == pytest.approx(2.9, abs=2 / 30)
    assert held.sum() / 30 == pytest.approx(2.4, abs=2 / 30)
    time = 0.6 + np.arange(made.frames) / 30
    u = np.clip(time - 1.0, 0.0, 1.0)
    expected = (10 * u**3 - 15 * u**4 + 6 * u**5)[:, None] * [0.0, 0.003, 0.009]
    # A frame of the session is 1/60 s; the motion is at most 1.875 times as fast as its mean.
    off = np.linalg.norm(made.displacement[held][:, 0] - expected[held], axis=1)
    assert off.max() < 1.875 * 0.0095 / 60 + 1e-6
    np.testing.assert_allclose(
        made.displacement[held][-1], [[0, 0.003, 0.009]] * reach.sum(), atol=1e-8
    )
    np.testing.assert_allclose(made.displacement[0], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            "cut: {rectangle: {center: [32, 50, 2], along: [20, 0, 0], depth: [0, 0, 20]}}",
            r"lift\.yaml:10: cut changes the mesh; the interaction ends before it",
        ),
        ("press: knife", r"lift\.yaml:10: press knife changes the mesh"),
        ("undo: true", r"lift\.yaml:10: undo changes the mesh"),
    ],
)
def test_an_interaction_ends_before_the_mesh_changes(
    small_wall: Organ, tmp_path: Path, change: str, said: str
) -> None:
    found = interaction_from(str(script(tmp_path, change)), small_wall)
    assert len(found.notes) == 1
    assert re.search(said, found.notes[0])
    assert found.interaction.seconds == pytest.approx(1.9, abs=2 / 30)
    whole = interaction_of_script(script(tmp_path), small_wall).interaction
    np.testing.assert_array_equal(
        found.interaction.displacement, whole.displacement[: found.interaction.frames]
    )


def test_a_grasper_without_a_size_gets_one_and_that_is_said(
    small_wall: Organ, tmp_path: Path
) -> None:
    path = script(tmp_path)
    path.write_text(path.read_text().replace("shape: sphere, size: [9], ", ""))
    organ = replace(small_wall, name="mine")
    found = interaction_of_script(path, organ)
    assert "grasper has no size: a radius of" in found.notes[0]
    # The wall has a scene in the project, which says how large its grasper is.
    assert interaction_of_script(path, small_wall).notes == ()


def test_scripts_that_hold_nothing_or_make_no_sense_are_refused(
    small_wall: Organ, tmp_path: Path
) -> None:
    path = script(tmp_path)
    text = path.read_text()
    path.write_text(text.replace("by: [0, 3, 9]", "by: [0, 3]"))
    with pytest.raises(ValueError, match=r"lift\.yaml:9"):
        interaction_of_script(path, small_wall)
    path.write_text(text.replace("to: [32, 100, 2]", "to: [32, 200, 2]"))
    with pytest.raises(InteractionError, match="lift: no tool holds tissue in any frame"):
        interaction_of_script(path, small_wall)
    path.write_text(
        text.replace("press: grasper", "press: knife").replace("e: grasper", "e: knife")
    )
    with pytest.raises(InteractionError, match="no tool holds tissue"):
        interaction_of_script(path, small_wall)
