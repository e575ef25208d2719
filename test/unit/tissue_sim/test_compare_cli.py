"""`tissue compare`: what it writes, and that wrong input is one line and exit code 2."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from support.pulled_block import block_organ, pull_of
from support.recorded_pull import pull_bag
from support.tissue_command import tissue
from tissue_sim.cli.main import BAD_INPUT
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.trajectory import Trajectory

QUICK = ("--rate", "10", "--no-pictures")


def compared(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Run `tissue compare`: exit code, output and errors."""
    return tissue(capsys, "compare", *arguments)


@pytest.fixture(autouse=True)
def _a_folder_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "argv", ["tissue"])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def small_wall(tmp_path: Path) -> str:
    """A scene of a wall with few nodes."""
    file = tmp_path / "small_wall.yaml"
    file.write_text(
        "/**/tissue_sim:\n  ros__parameters:\n    geometry: wall\n"
        "    shape: {columns: 6, rows: 8}\n",
        encoding="utf-8",
    )
    return str(file)


def test_models_are_ranked_and_the_report_is_written(
    capsys: pytest.CaptureFixture[str], small_wall: str
) -> None:
    code, out, err = compared(
        capsys, small_wall, "-i", "oblique:4", "-i", "normal", "--amplitude", "3",
        "-t", "quasi_static", "-t", "soft=relaxation@0.5", "--machine", "thesis", *QUICK,
    )  # fmt: skip
    assert (code, err) == (0, "")
    result = json.loads(Path("out/compare/result.json").read_text(encoding="utf-8"))
    oblique, normal = result["comparisons"]
    assert oblique["interaction"]["amplitude_m"] == pytest.approx(0.004)
    assert normal["interaction"]["amplitude_m"] == pytest.approx(0.003)
    assert [t["text"] for t in oblique["targets"]] == ["quasi_static@5.7", "soft=relaxation@0.5"]
    assert oblique["reference"]["subject"]["model"] == "finite_element"
    for told in oblique["targets"]:
        assert 0.0 < told["relative"] < 1.5
        line = next(line for line in out.splitlines() if line.startswith(told["label"])).split()
        assert f"{1e3 * told['mean_m']:.3f}" in line
    assert "of the worst, over 2 interactions" in out
    assert "<html" in Path("out/compare/report.html").read_text(encoding="utf-8")
    assert result["made"]["command"].startswith("tissue compare ")


def test_what_was_kept_can_be_compared_with_again(
    capsys: pytest.CaptureFixture[str], small_wall: str
) -> None:
    code, _, _ = compared(
        capsys, small_wall, "-i", "normal:3", "-t", "relaxation@1", "--keep", "--out", "first",
        "-r", "quasi_static@9", "--rrd", *QUICK,
    )  # fmt: skip
    assert code == 0
    assert Path("first/comparison.rrd").stat().st_size > 10_000
    kept = Path("first/trajectories")
    assert sorted(file.name for file in kept.iterdir()) == [
        "interaction.npz", "reference.npz", "target_relaxation.npz"
    ]  # fmt: skip
    code, _, err = compared(
        capsys, small_wall, "-i", str(kept / "interaction.npz"), "--out", "second",
        "-r", str(kept / "reference.npz"), "-t", "quasi_static@9", "-t", "relaxation@1", *QUICK,
    )  # fmt: skip
    assert (code, err) == (0, "")
    first, second = (
        json.loads(Path(f"{name}/result.json").read_text(encoding="utf-8"))["comparisons"][0]
        for name in ("first", "second")
    )
    same, again = second["targets"]
    assert same["mean_m"] == 0.0
    assert again["mean_m"] == first["targets"][0]["mean_m"]
    assert second["reference"]["subject"] is None
    code, _, err = tissue(
        capsys,
        "compare",
        small_wall,
        "-i",
        "normal:2",
        "-r",
        str(kept / "reference.npz"),
        "-t",
        "lr",
        *QUICK,
    )
    assert code == BAD_INPUT
    assert "was made under another interaction than normal" in err


def test_targets_of_one_model_are_told_apart(
    capsys: pytest.CaptureFixture[str], small_wall: str
) -> None:
    code, _, _ = compared(
        capsys, small_wall, "-i", "normal:3", "-r", "quasi_static@9", "-t", "relaxation@1",
        "-t", "relaxation@2", "--effort", "4", *QUICK,
    )  # fmt: skip
    assert code == 0
    result = json.loads(Path("out/compare/result.json").read_text(encoding="utf-8"))
    assert [t["label"] for t in result["comparisons"][0]["targets"]] == [
        "relaxation@1", "relaxation@2"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("wall", "-i", "oblique"), "there is no target: name one or more with --target"),
        (("wall", "-t", "lr"), "there is no interaction: name one with --interaction"),
        (("wall", "-i", "sideways", "-t", "lr"), "a motion (in_plane, normal, oblique"),
        (("wall", "-i", "oblique:far", "-t", "lr"), "is no number of millimetres"),
        (("wall", "-i", "oblique", "-t", "jelly"), "no model 'jelly'; allowed: chain_mail"),
        (("wall", "-i", "oblique", "-t", "lr:width=1"), "no parameter 'width'; allowed: step"),
        (("wall", "-i", "oblique", "-t", "lr@soon"), "effort 'soon' is not possible; allowed"),
        (("wall", "-i", "oblique", "-t", "lr", "--effort", "soon"), "effort 'soon'"),
        (("wall", "-i", "oblique", "-t", "lr", "-r", "jelly"), "there is no model 'jelly'"),
        (("wall", "-i", "oblique", "-t", "lr", "-r", "no.npz"), "No such file"),
        (("wall", "-i", "oblique", "-t", "lr", "-r", "measured"), "has no measured positions"),
        (("wall", "-i", "oblique", "-t", "lr", "-t", "lr"), "target lr is there 2 times"),
        (("wall", "-i", "oblique", "-t", "lr", "--machine", "new"), "allowed: thesis"),
        (("wall", "-i", "oblique", "-t", "chain_mail", "--machine", "thesis"), "no frame rate of"),
        (("wall", "-i", "oblique", "-t", "lr", "--machine", "thesis", "--effort", "2"),
         "effort and machine both"),
        (("wall", "-i", "oblique", "-t", "lr", "--young", "-1"), "young_modulus = -1 is out of"),
        (("wall", "-i", "oblique", "-t", "lr", "--kind", "gas"), "no geometry_kind 'gas'"),
        (("wall", "-i", "oblique", "-t", "lr", "--kind", "surface"), "finite_element needs tetra"),
        (("lung", "-i", "oblique", "-t", "lr"), "neither a shape (wall, block"),
        (("wall", "-i", "no.mcap", "-t", "lr"), "no.mcap is not there"),
        (("-i", "oblique", "-t", "lr"), "says of no organ: name one"),
        (("-i", "bag", "-t", "lr", "--units", "mm"), "are of an organ that is named"),
    ],
)  # fmt: skip
def test_wrong_input_is_one_line_that_says_what_is_allowed(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    code, out, err = compared(capsys, *arguments, "--rate", "10")
    assert code == BAD_INPUT
    assert out == ""
    assert said in err
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert not Path("out").exists()


def test_files_of_another_topology_are_refused(
    capsys: pytest.CaptureFixture[str], small_wall: str
) -> None:
    organ = block_organ()
    pull_of(organ).save(Path("pull.npz"))
    code, _, err = compared(capsys, small_wall, "-i", "pull.npz", "-t", "lr")
    assert code == BAD_INPUT
    assert "was recorded on another topology" in err
    frames = np.zeros((45, 64, 3), dtype=np.float32)
    Trajectory(
        "kept", 10.0, frames, np.ones(45, dtype=np.int64), np.zeros(45), 45, organ.digest
    ).save(Path("kept.npz"))
    code, _, err = compared(
        capsys, small_wall, "-i", "normal", "-r", "kept.npz", "-t", "lr", "--rate", "10"
    )
    assert code == BAD_INPUT
    assert "kept has another topology" in err
    code, _, err = compared(capsys, small_wall, "-i", "normal", "-r", "pull.npz", "-t", "lr")
    assert code == BAD_INPUT
    assert Interaction.load(Path("pull.npz")).frames == 6


def test_what_a_recording_measured_is_a_reference(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    bag, _ = pull_bag(tmp_path / "recorded")
    code, out, err = compared(
        capsys, "-i", str(bag), "-r", "measured", "-t", "quasi_static@2", "--no-pictures"
    )
    assert (code, err) == (0, "")
    result = json.loads(Path("out/compare/result.json").read_text(encoding="utf-8"))
    assert result["comparisons"][0]["reference"]["subject"] is None
    assert "reference: " in out


def test_bags_without_what_is_needed_are_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    code, _, err = compared(capsys, "-i", "empty", "-t", "lr")
    assert code == BAD_INPUT
    assert err.count("\n") == 1
    assert "empty" in err
