"""What a fit is asked for is read alike from a file and from the command line."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from tissue_sim.compare.fit.settings import KEYS, MEASURED, FitSettings, Grid, read_settings
from tissue_sim.compare.subject import parse_subject

FILE = """\
organ: wall
interactions: [oblique, "circular:10"]
reference: finite_element@rest
target: quasi_static:levels=1000@1.9
ranges:
  step: 0.1..1.9
  springs.stiffness: 0.1..100:log
strategy: cma
population: 12
generations: 20
seed: 7
processes: 2
pareto: [4, 1, 2]
tolerance: 0.3
landscape: step,springs.stiffness:9
out: out/fit/wall
"""

OPTIONS = {
    "organ": "wall",
    "interactions": ["oblique", "circular:10"],
    "reference": "finite_element@rest",
    "target": "quasi_static:levels=1000@1.9",
    "ranges": ["step=0.1..1.9", "springs.stiffness=0.1..100:log"],
    "strategy": "cma",
    "population": 12,
    "generations": 20,
    "seed": 7,
    "processes": 2,
    "pareto": "4,1,2",
    "tolerance": 0.3,
    "landscape": "step,springs.stiffness:9",
    "out": "out/fit/wall",
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "fit.yaml"
    path.write_text(FILE)
    return path


def test_a_file_and_the_command_line_say_the_same(file: Path) -> None:
    assert read_settings(file, {}) == read_settings(None, OPTIONS)


def test_settings_are_what_the_file_says(file: Path) -> None:
    settings = read_settings(file, {})
    assert settings.target == parse_subject("quasi_static:levels=1000@1.9")
    assert settings.reference == parse_subject("finite_element@rest")
    assert settings.pareto == (1.0, 2.0, 4.0)
    assert settings.landscape == Grid(("step", "springs.stiffness"), 9)
    assert settings.space.names == ("step", "springs.stiffness")
    assert [parameter.log for parameter in settings.ranges] == [False, True]


def test_what_the_command_line_says_counts(file: Path) -> None:
    settings = read_settings(file, {"seed": 3, "interactions": ["normal"], "population": None})
    assert (settings.seed, settings.interactions, settings.population) == (3, ("normal",), 12)


def test_what_is_not_said_has_a_default() -> None:
    short = {key: OPTIONS[key] for key in ("interactions", "reference", "target", "ranges")}
    settings = read_settings(None, short)
    expected = FitSettings(
        None, settings.interactions, settings.reference, settings.target, settings.ranges
    )
    assert settings == expected


def test_a_reference_is_a_model_or_a_file_or_what_was_measured(file: Path) -> None:
    assert read_settings(file, {"reference": "lr@1"}).reference == parse_subject("lr@1")
    assert read_settings(file, {"reference": "markers.npz"}).reference == Path("markers.npz")
    assert read_settings(file, {"reference": "measured"}).reference == MEASURED


def test_a_cluster_on_the_command_line_replaces_the_processes_of_the_file(file: Path) -> None:
    settings = read_settings(file, {"scheduler": "tcp://localhost:8786"})
    assert (settings.processes, settings.scheduler) == (None, "tcp://localhost:8786")


def test_files_lie_beside_the_settings(tmp_path: Path) -> None:
    folder = tmp_path / "patient"
    folder.mkdir()
    (folder / "liver.vtu").touch()
    (folder / "session").mkdir()
    content = yaml.safe_load(FILE) | {
        "organ": "liver.vtu", "units": "mm", "interactions": ["session", "oblique"],
    }  # fmt: skip
    (folder / "fit.yaml").write_text(yaml.safe_dump(content))
    settings = read_settings(folder / "fit.yaml", {})
    assert settings.organ == str(folder / "liver.vtu")
    assert settings.interactions == (str(folder / "session"), "oblique")


def test_a_whole_number_is_marked_as_one(file: Path) -> None:
    ranges = ["levels=1..30", "step=1..1.9"]
    settings = read_settings(file, {"ranges": ranges, "landscape": "levels,step"})
    assert [parameter.integer for parameter in settings.ranges] == [True, False]


@pytest.mark.parametrize(
    ("line", "instead", "says"),
    [
        ("organ: wall", "organs: wall", "fit.yaml:1: fit: unknown key 'organs'; allowed: epoch, "),
        ("  step: 0.1..1.9", "  stop: 0.1..1.9", "fit.yaml:6: fit.ranges.stop: model quasi_static "
         "has no value 'stop'; allowed: step, "),
        ("  step: 0.1..1.9", "  step: 0.1..2.5", "fit.yaml:6: fit.ranges.step: bound 2.5 of step: "
         "step = 2.5 is out of range; allowed: 0.01 to 1.99"),
        ("  step: 0.1..1.9", "  step: 1.9..0.1", "fit.yaml:6: fit.ranges.step: range "
         "'step=1.9..0.1' is not understood: step from 1.9 to 0.1 is no range"),
        ("  step: 0.1..1.9", "  step: [0.1, 1.9]", "fit.yaml:6: fit.ranges.step: must be a text"),
        ("  step: 0.1..1.9", "  springs.stiffness: 1..2", "appears twice"),
        ("generations: 20", "generations: 2.5", "fit.yaml:10: fit.generations: must be a whole "
         "number from 1 to 100000, not 2.5"),
        ("strategy: cma", "strategy: luck", "fit.yaml:8: fit.strategy: 'luck' is not allowed; "
         "allowed: cma, ea"),
        ("pareto: [4, 1, 2]", "pareto: [4, 0]", "fit.yaml:13: fit.pareto[1]: must be at least"),
        ("tolerance: 0.3", "tolerance: 0", "fit.yaml:14: fit.tolerance: must be greater than 0"),
        ("landscape: step,springs.stiffness:9", "landscape: step,levels:9",
         "allowed: two of the ranges (step, springs.stiffness)"),
        ("landscape: step,springs.stiffness:9", "landscape: step,springs.stiffness:1",
         "must be a whole number from 2 to 200, not 1"),
        ("target: quasi_static:levels=1000@1.9", "target: jelly",
         "fit.yaml:4: fit.target: there is no model 'jelly'; allowed: chain_mail"),
        ("reference: finite_element@rest", "reference: finite_element@never",
         "fit.yaml:3: fit.reference: effort 'never' is not possible; allowed"),
        ('interactions: [oblique, "circular:10"]', "interactions: []",
         "fit.yaml:2: fit.interactions: is empty"),
        ("target: quasi_static:levels=1000@1.9", "", "a fit needs target: give --target, or"),
    ],
)  # fmt: skip
def test_a_mistake_is_told_with_its_place(file: Path, line: str, instead: str, says: str) -> None:
    assert line in FILE
    file.write_text(FILE.replace(line + "\n", instead + "\n"))
    with pytest.raises(ValueError, match="fit") as told:
        read_settings(file, {})
    assert says in str(told.value)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"ranges": ["stop=1..2"]}, "command line: --range: model quasi_static has no value"),
        ({"ranges": ["step=1..1.5", "step=1..1.6"]}, "--range: step is there twice"),
        ({"population": 3}, "command line: --population: must be a whole number from 4"),
        ({"rate_hz": 2000}, "command line: --rate: must be at most 1000, not 2000"),
        ({"pareto": "1,two"}, "command line: --pareto: must be a number, not 'two'"),
        ({"units": "inch"}, "command line: --units: 'inch' is not allowed; allowed: mm, m"),
    ],
)
def test_a_mistake_on_the_command_line_names_the_option(
    file: Path, options: dict[str, object], says: str
) -> None:
    with pytest.raises(ValueError, match="command line") as told:
        read_settings(file, options)
    assert says in str(told.value)


def test_what_is_missing_is_named_with_its_option() -> None:
    with pytest.raises(ValueError, match=r"a fit needs interactions: give --interaction$"):
        read_settings(None, {})


@pytest.mark.parametrize("name", ["fit_wall.yaml", "fit_recording.yaml"])
def test_examples_can_be_read(repository: Path, name: str) -> None:
    assert read_settings(repository / "examples" / name, {}).strategy == "cma"


def test_an_example_explains_every_key(repository: Path) -> None:
    text = (repository / "examples" / "fit_wall.yaml").read_text()
    assert [key for key in KEYS if f"{key}:" not in text] == []
