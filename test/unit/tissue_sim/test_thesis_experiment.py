"""The thesis' experiment: its rows, its walls, many fits at once, and what is made of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tissue_sim.compare.effort import Effort
from tissue_sim.compare.fit.evolutionary import Evolutionary
from tissue_sim.compare.fit.problem import Problem
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.thesis import experiment, run, side_by_side
from tissue_sim.compare.thesis.conditions import AMPLITUDES, PULLS, Conditions
from tissue_sim.compare.thesis.experiment import Search, rows_of, trials_of
from tissue_sim.compare.thesis.influences import COLUMNS, INFLUENCES, USUAL, rows_looked_at
from tissue_sim.compare.thesis.rows import MASSES, ROWS, SWEEPS, Row
from tissue_sim.compare.thesis.side_by_side import Bundle, fit_all
from tissue_sim.compare.thesis.wall import Walls
from tissue_sim.compare.trajectory import only_held, simulate

ONE_PULL = Conditions(pulls=("oblique",), amplitudes=(0.008,), per_element=(1.0,))


def row_named(start: str) -> Row:
    return next(row for row in ROWS if row.name.startswith(start))


@pytest.fixture(scope="module")
def walls() -> Walls:
    return Walls.build(Conditions())


@pytest.fixture(scope="module")
def problems() -> tuple[Problem, ...]:
    """Small fits of one and two values; the first half second of a pull."""
    chosen = [row_named("quasi-static, tetrahedra"), row_named("relaxation only")]
    found = [trial.problem for trial in trials_of(ONE_PULL, chosen)]
    return tuple(_shortened(problem) for problem in found if problem)


def _shortened(problem: Problem, frames: int = 15) -> Problem:
    case = problem.cases[0]
    interaction = replace(
        case.interaction, held=case.interaction.held[:frames],
        displacement=case.interaction.displacement[:frames],
    )  # fmt: skip
    reference = replace(case.reference, displacement=case.reference.displacement[:frames],
                        stable=frames)  # fmt: skip
    return replace(problem, cases=(replace(case, interaction=interaction, reference=reference),))


def test_rows_are_those_of_the_thesis() -> None:
    """THESIS.md, section 7: differences over the worst, and steps in 1/30 s from its rates."""
    shown = [None if row.thesis is None else round(row.thesis, 3) for row in ROWS]
    assert shown == [1.0, 0.327, 0.316, 0.308, 0.292, 0.274, 0.246, 0.244, 0.238, None]
    steps = [row.steps() for row in ROWS]
    assert steps == [None, 3.0, 3.0, 3.5, 1.9, 2.9, 2.0, 2.0, None, 0.4]
    assert [row.thesis_fps for row in ROWS[1:6]] == [90.0, 90.0, 106.0, 57.0, 86.0]


@pytest.mark.parametrize("row", [row for row in ROWS if row.model], ids=lambda row: row.name)
def test_a_row_can_be_fitted_and_the_thesis_values_lie_in_its_space(row: Row) -> None:
    subject = row.subject().checked()
    space = row.space
    assert (space is None) == (not row.found)
    if space is not None:
        assert set(space.checked(subject).names) == set(row.found)
        inside = space.encode(row.found)
        assert ((inside > 0.0) | np.isclose(inside, 0.0)).all()
        assert (inside < 1.0).all()


def test_the_two_walls_are_one_tissue(walls: Walls) -> None:
    one, other = walls.tetrahedra, walls.connected
    assert one.mesh.node_rows == other.mesh.node_rows == 884
    np.testing.assert_array_equal(np.sort(walls.rows), np.arange(884))
    np.testing.assert_array_equal(one.rest[walls.rows], other.rest)
    np.testing.assert_array_equal(one.mesh.fixed[walls.rows], other.mesh.fixed[:884])
    np.testing.assert_array_equal(np.sort(walls.rows[other.hold]), one.hold)
    assert len(one.hold) == 10


def test_a_case_means_the_same_on_both_walls(walls: Walls) -> None:
    case = walls.case("oblique", 0.008, Conditions())
    carried = walls.carried(case)
    assert carried.worst == pytest.approx(case.worst, rel=1e-12)
    one, other = (
        only_held(organ, played.interaction).displacement
        for organ, played in ((walls.tetrahedra, case), (walls.connected, carried))
    )
    np.testing.assert_array_equal(one[:, walls.rows], other)
    np.testing.assert_array_equal(
        case.reference.displacement[:, walls.rows], carried.reference.displacement
    )


def test_the_pull_lasts_as_long_as_in_the_thesis(walls: Walls) -> None:
    interaction = walls.case("normal", 0.004, Conditions()).interaction
    way = np.linalg.norm(interaction.displacement[:, 0], axis=1)
    assert (interaction.rate_hz, interaction.frames) == (30.0, 135)
    assert np.flatnonzero(way < 0.004 * (1 - 1e-12)).max() == 43
    np.testing.assert_allclose(way[44:], 0.004)


def test_a_trembling_hand_ends_where_a_steady_one_does(walls: Walls) -> None:
    steady = walls.case("oblique", 0.008, Conditions()).interaction
    trembling = walls.case("oblique", 0.008, Conditions(tremor=1.0)).interaction
    np.testing.assert_array_equal(trembling.displacement[45:], steady.displacement[45:])
    apart = np.abs(trembling.displacement - steady.displacement)[:45]
    assert 0 < apart.max() < 0.003
    # All that is held moves together.
    np.testing.assert_array_equal(apart[:, :1].repeat(10, axis=1), apart)


@pytest.mark.parametrize(
    ("model", "values", "other"),
    [
        ("quasi_static", {**SWEEPS, "force_step": 0.08},
         {"force_step": 0.02, "springs.stiffness": 4.0}),
        ("spring_mass", {**MASSES, "springs.stiffness": 0.1, "damping": 0.1},
         {"springs.stiffness": 0.4, "springs.node_mass": 4.0 / 3600.0}),
    ],
)  # fmt: skip
def test_only_a_product_of_the_thesis_values_matters(
    walls: Walls, model: str, values: dict[str, float], other: dict[str, float]
) -> None:
    """So it is fitted, and not its two factors."""
    interaction = walls.case("oblique", 0.008, Conditions()).interaction
    first = Subject(model, values, Effort(steps=2.0))
    one, two = (
        simulate(subject, walls.tetrahedra, interaction).displacement[-1]
        for subject in (first, first.with_values(other))
    )
    np.testing.assert_allclose(one, two, atol=2e-7)
    assert np.abs(one).max() > 0.005


def test_trials_are_every_pull_of_every_row() -> None:
    conditions = replace(ONE_PULL, pulls=PULLS[:2], per_element=(0.0, 1.0), levels=5)
    rows = [row_named("quasi-static, tetrahedra"), row_named("relaxation only")]
    trials = trials_of(conditions, rows)
    assert [(t.row.name, t.pull, t.subject.values.get("springs.per_element")) for t in trials] == [
        (rows[0].name, pull, per) for per in (0.0, 1.0) for pull in PULLS[:2]
    ] + [(rows[1].name, pull, None) for pull in PULLS[:2]]
    assert trials[0].subject.values["levels"] == 5
    assert len(AMPLITUDES) == len(PULLS) == 3


def test_fits_side_by_side_are_those_of_one_after_the_other(problems: tuple[Problem, ...]) -> None:
    both = fit_all(problems, (3, 2), 7, 5, processes=1)
    for which, (problem, generations) in enumerate(zip(problems, (3, 2), strict=True)):
        strategy, errors = Evolutionary(problem.space.size, 7 + which, 5), []
        for _ in range(generations):
            asked = strategy.ask()
            told = [problem.evaluate(point).error for point in asked]
            strategy.tell(asked, np.array(told))
            errors += told
        assert both[which].error == min(errors)


def test_an_interrupted_search_goes_on_as_if_nothing_had_been(
    problems: tuple[Problem, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = fit_all(problems, (3, 2), 1, 5, processes=1)
    checkpoint, evaluated = tmp_path / "new" / "fits.json", 0
    evaluate = Bundle.evaluate

    def interrupted(self: Bundle, candidate: np.ndarray) -> Any:
        nonlocal evaluated
        evaluated += 1
        if evaluated == 14:
            raise KeyboardInterrupt
        return evaluate(self, candidate)

    monkeypatch.setattr(side_by_side.Bundle, "evaluate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fit_all(problems, (3, 2), 1, 5, processes=1, checkpoint=checkpoint)
    assert json.loads(checkpoint.read_text(encoding="utf-8"))["generation"] == 1
    again = fit_all(problems, (3, 2), 1, 5, processes=1, checkpoint=checkpoint)
    assert again == whole
    # What was done is not done again: 10 + 8 + 4 candidates, and 4 were lost.
    assert evaluated == 14 + 12
    # Another experiment does not go on from it.
    assert fit_all(problems, (1, 1), 2, 5, processes=1, checkpoint=checkpoint) == fit_all(
        problems, (1, 1), 2, 5, processes=1
    )


def outcome(row: Row, relative: float | None, **more: Any) -> dict[str, Any]:
    return {
        "row": row.name, "pull": "normal", "amplitude_mm": 8.0, "per_element": 1.0,
        "relative": relative, "values": dict(row.found), "relative_with_thesis_values": None,
        "steps_per_second": 1000.0, "frames_per_second": 10.0, **more,
    }  # fmt: skip


def test_a_row_agrees_if_the_thesis_lies_in_its_range() -> None:
    row = row_named("quasi-static, tetrahedra")
    spread = rows_of([outcome(row, 0.28), outcome(row, None), outcome(row, 0.4)], [row])[0]
    assert spread["relative_range"] == [0.28, 0.4]
    assert spread["relative_to_worst"] == pytest.approx(0.34)
    assert spread["agrees"] is True
    above = rows_of([outcome(row, 0.3), outcome(row, 0.4)], [row])[0]
    assert above["agrees"] is False
    assert "lies below our range" in above["note"]
    lost = rows_of([outcome(row, None)], [row])[0]
    assert lost["relative_range"] is None
    assert lost["parameters"] == {}


def test_every_influence_changes_one_thing_or_names_two() -> None:
    usual = USUAL.to_json()
    assert next(iter(INFLUENCES.values())) == USUAL
    for name, conditions in INFLUENCES.items():
        changed = {key for key, value in conditions.to_json().items() if value != usual[key]}
        two = ", corotated" in name or " and " in name
        assert len(changed) == (0 if conditions == USUAL else 1 + two)
    assert len(rows_looked_at()) == len(COLUMNS)


def test_the_command_writes_what_the_design_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """DESIGN.md, section 7; and the table is readable in 80 columns."""
    monkeypatch.setattr(run, "QUICK_CONDITIONS", ONE_PULL)
    monkeypatch.setattr(run, "QUICK", Search(4, (1, 1, 1)))
    equilibrium = row_named("quasi-static at full")
    quicker = tuple(row for row in ROWS if row is not equilibrium)

    def without_equilibrium(
        conditions: Conditions, search: Search, **more: Any
    ) -> list[dict[str, Any]]:
        return experiment.measure(conditions, search, quicker, **more)

    monkeypatch.setattr(run, "measure", without_equilibrium)
    monkeypatch.setenv("COLUMNS", "80")
    out = tmp_path / "results" / "thesis.json"
    run.experiment(out, quick=True, processes=1)
    rows = json.loads(out.read_text(encoding="utf-8"))["rows"]
    assert [row["row"] for row in rows] == [row.name for row in ROWS]
    wanted = {
        "row", "relative_to_worst", "relative_range", "thesis_relative_to_worst", "parameters",
        "frames_per_second", "note",
    }  # fmt: skip
    for row in rows:
        assert wanted <= set(row)
        if row["relative_range"]:
            assert row["relative_range"][0] <= row["relative_to_worst"] <= row["relative_range"][1]
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 1 + len(ROWS)
    assert all(len(line) <= 80 for line in shown)
    assert not list((tmp_path / "results" / "thesis").glob("*"))
