"""People, sessions, raters, and what a report makes of several of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tissue_sim.report.reliability import absolute_agreement, correlation, weighted_kappa
from tissue_sim.report.reliability_tables import (
    first_and_second,
    inter_rater,
    known_groups,
    repeats_of,
)
from tissue_sim.report.study import (
    Entry,
    named_apart,
    parse_entry,
    read_study,
    with_experts,
)
from tissue_sim.report.summary import Figure
from tool_input.located_yaml import ProcedureError

STUDY = """
sessions:
  - {bag: a1, person: anna, session: 1, role: expert,
     ratings: {kim: {care: 5, OSATS: 30.5}, lou: {care: 4, OSATS: 29}}}
  - {bag: b1, person: ben, session: 1, role: trainee,
     ratings: {kim: {care: 2, OSATS: 18}, lou: {care: 2, OSATS: 20}}}
  - {bag: c1, person: cleo, session: 1, role: trainee,
     ratings: {kim: {care: 3, OSATS: 22}, lou: {care: 4, OSATS: 21}}}
"""


def one(value: float, key: str = "path") -> list[Figure]:
    return [Figure(key, "tool hook", "path length", "m", value)]


def test_sessions_are_named_on_the_command_line(tmp_path: Path) -> None:
    assert parse_entry("out/a@anna:2") == Entry(Path("out/a"), "anna", "2")
    assert parse_entry("out/a@anna").name == "anna"
    assert parse_entry("out/a").person == ""
    odd = tmp_path / "bag@home"
    odd.mkdir()
    assert parse_entry(str(odd)) == Entry(odd)
    for text in ("bag@", "@anna", "bag@:1"):
        with pytest.raises(ValueError, match="names nobody"):
            parse_entry(text)


def test_bags_of_runs_are_told_apart_by_their_folders() -> None:
    entries = [parse_entry("x/session"), parse_entry("y/session"), parse_entry("z/y")]
    assert named_apart(entries) == ["x", "y (2)", "y (3)"]


def test_a_study_says_who_did_what_and_how_it_was_rated(tmp_path: Path) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(STUDY)
    entries = read_study(file)
    assert [entry.name for entry in entries] == ["anna 1", "ben 1", "cleo 1"]
    assert entries[0].bag == tmp_path / "a1"
    rows = {row.label: row for row in inter_rater(entries)}
    assert set(rows) == {"care: kim and lou", "OSATS: kim and lou"}
    care = np.array([[5.0, 4.0], [2.0, 2.0], [3.0, 4.0]])
    found = rows["care: kim and lou"]
    assert found.kappa == weighted_kappa(*care.T)
    assert found.agree == absolute_agreement(care)
    assert found.limits is not None
    assert found.limits.bias == pytest.approx(0.0)
    # Half points are no grades: no kappa.
    assert np.isnan(rows["OSATS: kim and lou"].kappa)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sessions: []\n", "has no session"),
        ("sessions: [{person: anna}]\n", "'bag' is missing"),
        ("sessions: [{bag: a, role: chief}]\n", "allowed: expert, trainee"),
        ("sessions: [{bag: a, ratings: {kim: {care: much}}}]\n", "must be a number"),
        ("people: []\n", "unknown key 'people'"),
    ],
)
def test_what_is_no_study_is_refused(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(text)
    with pytest.raises(ProcedureError, match=said):
        read_study(file)


def test_experts_are_marked_by_person_or_session() -> None:
    entries = [parse_entry("a@anna:1"), parse_entry("b"), parse_entry("c@cleo:1")]
    roles = [entry.role for entry in with_experts(entries, ["anna", "b"])]
    assert roles == ["expert", "expert", "trainee"]
    assert [entry.role for entry in with_experts(entries, [])] == ["", "", ""]
    with pytest.raises(ValueError, match="no session is by expert 'dora'; there are: anna, b"):
        with_experts(entries, ["dora"])


def test_the_second_session_is_that_with_the_next_number() -> None:
    entries = [parse_entry(f"bag{k}@anna:{k}") for k in (10, 2)] + [parse_entry("x@ben:1")]
    assert repeats_of(entries) == [(1, 0)]


def test_figures_repeat_as_the_persons_do() -> None:
    """Three persons, twice each; a fourth did it once, and is left out."""
    first, second = [0.1, 0.2, 0.4], [0.12, 0.19, 0.41]
    entries, figures = [], []
    for person, pair in zip("abc", zip(first, second, strict=True), strict=True):
        for session, value in enumerate(pair, start=1):
            entries.append(parse_entry(f"x@{person}:{session}"))
            figures.append(one(value))
    entries.append(parse_entry("x@d:1"))
    figures.append(one(9.0))
    (row,) = first_and_second(entries, figures)
    scores = np.array([first, second]).T
    assert (row.label, row.targets, row.unit) == ("tool hook: path length", 3, "m")
    assert row.agree.value == pytest.approx(absolute_agreement(scores).value)
    assert row.correlation == pytest.approx(correlation(*scores.T))
    assert row.limits is not None
    assert row.limits.bias == pytest.approx(np.mean(scores[:, 1] - scores[:, 0]))


def test_one_person_says_nothing_of_reliability() -> None:
    entries = [parse_entry("x@anna:1"), parse_entry("x@anna:2"), parse_entry("x@ben:1")]
    assert first_and_second(entries, [one(1.0), one(2.0), one(3.0)]) == []
    # Missing in one of two sessions: only one person is left with both.
    entries.append(parse_entry("x@ben:2"))
    figures = [one(1.0), one(2.0), one(3.0), one(float("nan"))]
    assert first_and_second(entries, figures) == []


def test_groups_are_of_persons_not_of_sessions() -> None:
    """Anna's two sessions are one expert, at their median."""
    entries = [
        Entry(Path(name), name, str(k), role)
        for k, (name, role) in enumerate(
            [("anna", "expert"), ("anna", "expert"), ("dan", "expert"), ("ben", "trainee"),
             ("cleo", "trainee")]
        )
    ]  # fmt: skip
    figures = [one(value) for value in (0.1, 0.3, 0.5, 0.4, 0.6)]
    (row,) = known_groups(entries, figures)
    assert (row.expert_count, row.trainee_count) == (2, 2)
    assert (row.experts, row.trainees) == pytest.approx((0.35, 0.5))
    # 0.2 and 0.5 against 0.4 and 0.6: one pair of four is greater.
    assert row.delta == pytest.approx((1 - 3) / 4)
    assert known_groups(entries[:4], figures[:4]) == []
