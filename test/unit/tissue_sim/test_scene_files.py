"""The scenes that come with the project are what the simulation takes."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from tissue_sim.default_procedure import default_procedure, tool_parameters
from tissue_sim.geometry.scene_geometry import load, suggest_interaction
from tissue_sim.scene_file import SIMULATION, config_folder, find_scene, read_scene, scene_names
from tissue_sim.simulation_parameters import Settings, specs
from tool_input.procedure import load_procedure, parse_procedure

GENERATED = ("wall", "block", "sphere_shell", "heart")


def test_there_is_a_scene_for_every_generated_shape() -> None:
    assert set(scene_names()) >= set(GENERATED)


@pytest.mark.parametrize("name", GENERATED)
def test_every_key_of_a_scene_is_a_parameter_with_an_allowed_value(name: str) -> None:
    scene = find_scene(name)
    assert set(scene.parameters) == {SIMULATION}
    table = {spec.name: spec for spec in specs(scene.simulation)}
    assert set(scene.simulation) <= set(table)
    values = {
        spec.name: spec.checked(scene.simulation.get(spec.name, spec.default))
        for spec in table.values()
    }
    settings = Settings.of(values)
    assert [tool.id for tool in settings.scene.tools] == scene.simulation["tools"]


@pytest.mark.parametrize("name", GENERATED)
def test_every_key_of_a_scene_is_explained(name: str) -> None:
    for line in (config_folder() / f"{name}.yaml").read_text().splitlines():
        if line.startswith("    ") and not line.strip().startswith("#"):
            assert "  # " in line, line


def test_scene_survives_being_written(tmp_path: Path) -> None:
    scene = find_scene("wall").with_simulation({"frames": 7, "tool.grasper.size": [0.01]})
    scene.write(tmp_path / "scene.yaml")
    again = read_scene(tmp_path / "scene.yaml")
    assert again.simulation == scene.simulation


@pytest.mark.parametrize("name", ["wall", "block", "sphere_shell"])
@pytest.mark.parametrize("seconds", [2.0, 5.0, 60.0])
def test_default_procedure_fits_its_run_and_can_be_played(name: str, seconds: float) -> None:
    interaction = suggest_interaction(load(name).mesh)
    procedure = parse_procedure(yaml.safe_dump(default_procedure(interaction, seconds)))
    assert procedure.end <= seconds
    assert {event.action for event in procedure.events} == {"press", "cut", "release"}
    parameters = tool_parameters(interaction, ["scalpel"])
    assert parameters["tools"] == ["scalpel", *procedure.tools]


@pytest.mark.parametrize("file", sorted((config_folder() / "procedures").glob("*.yaml")), ids=str)
def test_procedure_that_comes_with_the_project_can_be_played(file: Path) -> None:
    assert load_procedure(file).end > 0
