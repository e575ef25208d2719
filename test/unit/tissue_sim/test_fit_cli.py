"""`tissue fit` as a person runs it: what it says, what it writes, and what it refuses."""

from __future__ import annotations

import json
import re
import signal
import sys
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from support.bags import ROOMY
from support.tissue_command import tissue
from tissue_sim.cli import fit as command
from tissue_sim.cli.main import BAD_INPUT, INTERRUPTED
from tissue_sim.compare.effort import Effort
from tissue_sim.compare.fit.scene_lines import scene_lines
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.organs import SceneValues, load_organ
from tissue_sim.compare.sources.motions import motion
from tissue_sim.compare.subject import Subject, parse_subject
from tissue_sim.compare.trajectory import simulate
from tissue_sim.scene_file import read_scene
from viz_bridge.bag_writer import BagWriter

FIT: dict[str, Any] = {
    "organ": "block",
    "interactions": ["pull.npz"],
    "reference": "quasi_static:step=1.2@2",
    "target": "quasi_static@2",
    "ranges": {"step": "0.5..1.9", "momentum": "0..0.9"},
    "strategy": "ea",
    "population": 6,
    "generations": 3,
    "processes": 1,
    "out": "out",
}


@pytest.fixture(autouse=True)
def _own_arguments(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "argv", ["tissue"])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(tmp_path)


@pytest.fixture(autouse=True)
def _short_pull(tmp_path: Path) -> None:
    """An interaction of a few frames with a block."""
    block = load_organ("block")
    motion("oblique", block, pull_seconds=0.2, hold_seconds=0.1).save(tmp_path / "pull.npz")
    (tmp_path / "fit.yaml").write_text(yaml.safe_dump(FIT))


def result(folder: str) -> dict[str, Any]:
    """What was found, without when and how fast."""
    content: dict[str, Any] = json.loads((Path(folder) / "result.json").read_text())
    return {key: value for key, value in content.items() if key not in ("made", "seconds")}


class Addresses(HTMLParser):
    """Addresses that a page asks for."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.headings: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [str(value) for name, value in attrs if name in ("src", "href")]
        if tag == "h2":
            self.headings.append("")

    def handle_data(self, data: str) -> None:
        if self.get_starttag_text() == "<h2>" and self.headings and not self.headings[-1]:
            self.headings[-1] = data


def test_a_fit_says_and_writes_what_it_found(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, errors = tissue(
        capsys, "fit", "fit.yaml", "--pareto", "1,3", "--landscape", "step,momentum:3",
        "--tolerance", "1.5",
    )  # fmt: skip
    assert code == 0, errors
    found = result("out")
    best = found["best"]
    assert max(map(len, out.splitlines())) <= 80 or "@2" in out
    assert re.search(rf"step +{best['values']['step']:.6g} +0.5 +1.9", out)
    assert f"--target {best['subject']}" in out
    assert "fewest steps within 1.5 of the worst: 1 a frame" in out
    fitted = parse_subject(best["subject"])
    assert fitted.effort == Effort(steps=2.0)
    assert dict(fitted.values) == best["values"]
    assert best["error"] == min(entry["error"] for entry in found["evaluations"])
    assert [generation["number"] for generation in found["generations"]] == [1, 2, 3]
    assert [point["steps"] for point in found["speed"]["points"]] == [1.0, 3.0]
    assert len(found["landscape"]["error"]) == len(found["landscape"]["error"][0]) == 3
    page = Addresses()
    page.feed(Path("out/report.html").read_text())
    assert page.found == []
    assert page.headings == [
        "Best values", "Search", "Speed against error", "Landscape", "What was fitted",
    ]  # fmt: skip


def test_what_tissue_fit_says_tissue_compare_confirms(capsys: pytest.CaptureFixture[str]) -> None:
    """Both measure the same error with the same values."""
    assert tissue(capsys, "fit", "fit.yaml")[0] == 0
    best = result("out")["best"]
    code, _, errors = tissue(
        capsys, "compare", "block", "--interaction", "pull.npz", "--reference", FIT["reference"],
        "--target", best["subject"], "--no-pictures", "--out", "compared",
    )  # fmt: skip
    assert code == 0, errors
    compared = json.loads(Path("compared/result.json").read_text())
    assert compared["comparisons"][0]["targets"][0]["relative"] == pytest.approx(best["error"])


def test_measured_markers_are_fitted_to(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Positions of some nodes, as a camera would see them, of tissue that is a known model."""
    block, pull = load_organ("block"), Interaction.load(tmp_path / "pull.npz")
    moved = simulate(parse_subject("quasi_static:step=1.2,momentum=0.3@2"), block, pull)
    seen = np.union1d(pull.nodes, np.flatnonzero(~block.mesh.fixed[: block.mesh.node_rows])[::9])
    rest = np.zeros((1, *moved.displacement.shape[1:]))
    places = block.rest + np.concatenate([rest, moved.displacement])
    held = np.isin(seen, pull.nodes)
    np.savez(
        tmp_path / "markers.npz", positions=places[:, seen], rate_hz=pull.rate_hz,
        held=np.repeat(held[None], len(places), axis=0),
    )  # fmt: skip
    code, _, errors = tissue(
        capsys, "fit", "fit.yaml", "--interaction", "markers.npz", "--reference", "measured",
        "--generations", "6",
    )  # fmt: skip
    assert code == 0, errors
    assert result("out")["cases"][0]["reference"] == f"{len(seen)} markers of markers"
    assert result("out")["best"]["error"] < 0.1


def test_the_same_seed_gives_the_same_and_another_does_not(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for out, seed in (("a", "1"), ("b", "1"), ("c", "2")):
        assert tissue(capsys, "fit", "fit.yaml", "--out", out, "--seed", seed)[0] == 0
    assert result("a") == result("b")
    assert result("a")["evaluations"] != result("c")["evaluations"]


def test_interrupted_and_resumed_is_as_if_it_was_not(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    told = command._Bar.told

    def interrupt(bar: Any, what: str, done: int, of: int, error: float | None) -> None:
        told(bar, what, done, of, error)
        if (what, done) == ("search", 2):
            signal.raise_signal(signal.SIGINT)

    # Tests that run in the background of a shell ignore it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with monkeypatch.context() as patched:
            patched.setattr(command._Bar, "told", interrupt)
            code, _, errors = tissue(capsys, "fit", "fit.yaml")
    finally:
        signal.signal(signal.SIGINT, before)
    assert code == INTERRUPTED
    assert "to go on: tissue fit fit.yaml --out out --resume" in errors
    assert "Traceback" not in errors
    code, _, errors = tissue(capsys, "fit", "fit.yaml", "--resume")
    assert code == 0, errors
    assert tissue(capsys, "fit", "fit.yaml", "--out", "whole")[0] == 0
    assert result("out") == result("whole")


def test_a_value_at_its_bound_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, errors = tissue(
        capsys, "fit", "fit.yaml", "--reference", "quasi_static:step=1.9@2",
        "--range", "step=0.1..0.3", "--range", "momentum=0..0.9", "--generations", "8",
    )  # fmt: skip
    assert code == 0, errors
    assert "at its upper bound" in out
    assert "momentum is at its upper bound: a wider range may hold better values" in out
    assert result("out")["best"]["at_bounds"]["momentum"] == "upper"


def test_a_bound_of_the_model_itself_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, errors = tissue(
        capsys, "fit", "fit.yaml", "--reference", "quasi_static:step=1.99@4",
        "--target", "quasi_static@1", "--range", "step=0.1..1.99", "--generations", "8",
    )  # fmt: skip
    assert code == 0, errors
    assert "step is at its upper bound: the model takes none beyond it" in out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--range", "stop=1..2"), "model quasi_static has no value 'stop'; allowed: step, "),
        (("--range", "step=0.1..2.5"), "bound 2.5 of step: step = 2.5 is out of range; allowed: "
         "0.01 to 1.99"),
        (("--range", "step=1.9..0.1"), "step from 1.9 to 0.1 is no range"),
        (("--interaction", "empty"), "empty is empty: it holds no message"),
        (("--interaction", "wall.npz"), "was recorded on another topology (organ "),
        (("--interaction", "nothing"), "there is no interaction 'nothing'; allowed: a motion"),
        (("--reference", "measured"), "has no measured positions"),
        (("--target", "quasi_static@4ms"), "effort 4 ms a frame depends on the machine"),
        (("--scheduler", "tcp://127.0.0.1:9"), "tcp://127.0.0.1:9"),
        (("--resume",), "there is no fit to resume in out: it has no checkpoint.json"),
        (("--out", "kept"), "kept holds a fit already; allowed: --resume"),
        (("--out", "kept", "--resume"), "kept/checkpoint.json is no checkpoint of a fit"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line_and_exit_code_2(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: tuple[str, ...], says: str
) -> None:
    if "empty" in arguments:
        BagWriter(tmp_path / "empty", ROOMY).close()
    if "wall.npz" in arguments:
        motion("normal", load_organ("wall"), pull_seconds=0.1).save(tmp_path / "wall.npz")
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "checkpoint.json").write_text("{}")
    code, _, errors = tissue(capsys, "fit", "fit.yaml", *arguments)
    assert code == BAD_INPUT
    assert says in errors
    assert "Traceback" not in errors
    assert not (tmp_path / "out").exists()


def test_a_fit_is_not_resumed_with_another_problem(capsys: pytest.CaptureFixture[str]) -> None:
    assert tissue(capsys, "fit", "fit.yaml")[0] == 0
    code, _, errors = tissue(capsys, "fit", "fit.yaml", "--resume", "--seed", "2")
    assert code == BAD_INPUT
    assert "is the checkpoint of another fit" in errors
    assert re.search(r'"seed": 1.*"seed": 2', errors)


def subjects() -> st.SearchStrategy[Subject]:
    numbers = st.floats(0.1, 0.9)
    efforts = st.one_of(
        st.builds(Effort), st.just(Effort.parse("rest")),
        st.builds(lambda steps: Effort(steps=steps), st.floats(0.01, 100.0)),
    )  # fmt: skip
    names = st.sampled_from(["momentum", "step", "springs.stiffness", "release_momentum"])
    return st.builds(
        Subject, st.just("quasi_static"), st.dictionaries(names, numbers), efforts,
        st.sampled_from(["", "soft"]),
    )  # fmt: skip


@given(subject=subjects())
def test_a_subject_is_read_from_its_text(subject: Subject) -> None:
    assert parse_subject(subject.text) == subject


@pytest.fixture
def scene_with(tmp_path: Path) -> Callable[[list[str]], SceneValues]:
    def values_of(lines: list[str]) -> SceneValues:
        path = tmp_path / "scene.yaml"
        text = "".join(f"    {line}\n" for line in lines)
        path.write_text(f"/**/tissue_sim:\n  ros__parameters:\n{text}")
        return SceneValues.of(read_scene(path))

    return values_of


def test_lines_for_a_scene_are_those_of_the_subject(
    scene_with: Callable[[list[str]], SceneValues],
) -> None:
    subject = parse_subject(
        "quasi_static:step=1.2,levels=1000,rest_tolerance=1e-9,material.young_modulus=1e5@2"
    )
    values = scene_with(scene_lines(subject, 30.0)).given
    assert (values["model"], values["steps_per_frame"], values["rate_hz"]) == (
        "quasi_static", 2, 30.0,
    )  # fmt: skip
    assert values["quasi_static.levels"] == 1000
    assert values["quasi_static.rest_tolerance"] == 1e-9
    assert values["young_modulus"] == 1e5


def test_what_a_scene_cannot_have_is_a_comment(
    scene_with: Callable[[list[str]], SceneValues],
) -> None:
    lines = scene_lines(parse_subject("quasi_static:springs.stiffness=3@2.5"), 30.0)
    assert [line for line in lines if line.startswith("# springs.stiffness 3")]
    assert [line for line in lines if line.startswith("# 2.5 steps")]
    assert scene_with(lines).given["model"] == "quasi_static"
