"""`tissue report`: the page, the JSON beside it, and what it refuses."""

from __future__ import annotations

import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.bags import session_bag
from support.recorded_pull import PRESS, PULL, pull_bag
from support.tissue_command import tissue

VOID = {"meta", "link", "img", "br"}
PLAN = "units: mm\nlines: [{name: front, points: [[30, 0, 60], [30, 60, 60]]}]\n"
STUDY = """
sessions:
  - {bag: cut, person: anna, session: 1, role: expert, ratings: {kim: {care: 5}, lou: {care: 5}}}
  - {bag: whole, person: anna, session: 2, ratings: {kim: {care: 4}, lou: {care: 5}}}
  - {bag: whole, person: "ben <b>", session: 1, ratings: {kim: {care: 1}, lou: {care: 2}}}
  - {bag: short, person: "ben <b>", session: 2, ratings: {kim: {care: 2}, lou: {care: 2}}}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bags of a simulated pull, with a cut, without one, and a shorter one; and another organ."""
    made = tmp_path_factory.mktemp("report")
    pull_bag(made / "cut", cut_at=30)
    pull_bag(made / "whole")
    pull_bag(made / "short", frames=45)
    session_bag(made / "other")
    (made / "plan.yaml").write_text(PLAN)
    (made / "study.yaml").write_text(STUDY)
    return made


@pytest.fixture(autouse=True)
def restored(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setattr(sys, "argv", sys.argv)
    monkeypatch.chdir(folder)


class Tags(HTMLParser):
    """Fails where tags are not closed in their order, and keeps addresses."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def refused(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


def made(folder: Path, out: str) -> tuple[str, dict[str, Any]]:
    """The page without its scripts, and the JSON."""
    page = (folder / out / "report.html").read_text(encoding="utf-8")
    tags = Tags()
    tags.feed(page)
    assert tags.open == []
    assert all(address.startswith("data:") for address in tags.addresses)
    text = (folder / out / "result.json").read_text(encoding="utf-8")
    return re.sub(r"<script.*?</script>", "", page, flags=re.S), json.loads(
        text, parse_constant=refused
    )


def test_a_session_is_a_page_that_stands_alone(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its figures are those of the pull: 2.24 mm a tenth of a second, on the plan of its cut."""
    arguments = ("report", "cut", "--plan", "plan.yaml", "--no-pictures", "--out", "one")
    code, said, errors = tissue(capsys, *arguments, "--idle-speed", "2")
    assert (code, errors) == (0, "")
    assert "wrote one/report.html" in said
    assert max(map(len, said.splitlines())) <= 80
    page, result = made(folder, "one")
    figures = result["sessions"][0]["figures"]
    way = float(np.linalg.norm(PULL)) * (60 - PRESS)
    assert figures["tool.grasper.path"]["value"] == pytest.approx(way, rel=1e-6)
    assert figures["tool.grasper.peak_force"]["value"] is None
    assert "measured_cf" in figures["tool.grasper.peak_force"]["why"]
    assert figures["cuts.length"]["value"] == pytest.approx(0.06)
    assert figures["cuts.deviation_rms"]["value"] == pytest.approx(0.0, abs=1e-9)
    assert figures["cuts.missed"]["value"] == pytest.approx(0.0, abs=1e-9)
    assert result["comparisons"] == []
    for words in (
        "not recorded: tools/grasper/measured_cf", "left out with --no-pictures", "SPARC",
        "no thresholds of competence", "face", "content", "construct", "concurrent", "predictive",
        "read again by tissue_sim.readings",
    ):  # fmt: skip
        assert words in page


def test_several_sessions_are_side_by_side_with_the_expert_first(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("report", "--study", "study.yaml", "--no-pictures", "--out", "study")
    code, _, errors = tissue(capsys, *arguments)
    assert (code, errors) == (0, "")
    page, result = made(folder, "study")
    (compared,) = result["comparisons"]
    assert compared["sessions"] == ["anna 1", "anna 2", "ben <b> 1", "ben <b> 2"]
    assert "ben &lt;b&gt; 1" in page
    care = next(row for row in compared["inter_rater"] if row["label"] == "care: kim and lou")
    # Squared differences 0, 1, 1, 0 over 16 pairs' mean by chance.
    grades = np.array([[5, 4, 1, 2], [5, 5, 2, 2]], dtype=np.float64)
    chance = float(((grades[0][:, None] - grades[1]) ** 2).mean())
    assert care["kappa"] == pytest.approx(1 - 0.5 / chance)
    assert care["targets"] == 4
    retest = {row["label"]: row for row in compared["test_retest"]}
    length = retest["session: simulated time"]
    # Anna 59 and 59 frames, ben 59 and 44: differences 0 and -0.25 s.
    assert length["limits"]["bias"] == pytest.approx(-0.125)
    assert compared["known_groups"] == []
    assert "at least two experts" in page


def test_sessions_on_other_organs_are_not_compared(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, errors = tissue(
        capsys, "report", "whole@anna", "other@ben", "--expert", "anna", "--no-pictures",
        "--out", "organs",
    )  # fmt: skip
    assert (code, errors) == (0, "")
    page, result = made(folder, "organs")
    assert result["comparisons"] == []
    assert "Sessions on different organs" in page
    assert len(result["sessions"]) == 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "name bags, or a study file"),
        (("nothing",), "nothing"),
        (("plan.yaml",), "plan.yaml"),
        (("whole@",), "names nobody"),
        (("whole", "--expert", "dora"), "no session is by expert 'dora'"),
        (("whole", "--hand", "left"), "allowed: NAME=TOOL,TOOL"),
        (("whole", "--hand", "left=grasper", "--hand", "right=grasper"), "each once, in one hand"),
        (("whole", "--hand", "left=hook"), "has no tool 'hook' for the hand left"),
        (("whole", "--idle-speed", "0"), "allowed: 0 to 1000 mm/s"),
        (("whole", "--plan", "study.yaml"), "study.yaml"),
        (("whole", "--risk", "plan.yaml"), "risk_regions"),
        (("whole", "--epoch", "2"), "has no epoch 2"),
        (("whole", "--namespace", "left"), "no organ in namespace"),
    ],
)
def test_bad_input_is_one_line(
    arguments: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, errors = tissue(capsys, "report", *arguments, "--no-pictures", "--out", "bad")
    assert code == 2
    assert said in errors
    assert errors.count("\n") == 1
