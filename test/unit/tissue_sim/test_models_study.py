"""All models at equal cost per frame: what a budget buys, how rows are judged, and the results."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tissue_sim.compare.effort import Effort
from tissue_sim.compare.models import study
from tissue_sim.compare.models.fits import FITS
from tissue_sim.compare.models.step_cost import StepCost, bought, step_cost
from tissue_sim.compare.models.study import Study
from tissue_sim.compare.models.table import BEGIN, END, SECOND, as_markdown, into_page, standings
from tissue_sim.compare.models.trial import REFERENCES, Error, Reference, Row, Trial
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.sources.motions import MOTIONS
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import only_held, simulate
from tissue_sim.elastic import registry

RATE = 30.0
SHORTEST = 1.0 / 4800.0
IN_TIME = Subject("vertex_block_descent", {"dynamic": 1.0, "iterations": 1.0})


@pytest.fixture(scope="module")
def block() -> Organ:
    return load_organ("block", parameters={f"nodes_{axis}": 4 for axis in "xyz"})


@pytest.fixture(scope="module")
def trial(block: Organ, tmp_path_factory: pytest.TempPathFactory) -> Trial:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        return Trial.of(block, "oblique")


def cost_of(ms: float, time_step: float | None = None) -> StepCost:
    return StepCost(ms, 100, time_step)


@pytest.mark.parametrize(("ms", "steps"), [(0.3, 13.0), (4.0, 1.0), (5.0, 0.8), (3000.0, 0.00133)])
def test_a_budget_buys_whole_steps_or_a_fraction_of_one(ms: float, steps: float) -> None:
    share = bought(Subject("lr", {"levels": 6.0}), cost_of(ms), 4.0, RATE)
    assert share.steps == steps
    assert share.subject == Subject("lr", {"levels": 6.0}, Effort(steps=steps))
    assert share.real_time


@given(st.floats(1e-3, 100.0), st.floats(0.1, 50.0), st.sampled_from(["springs", "descent"]))
def test_simulated_time_keeps_up_or_it_is_said(ms: float, budget_ms: float, kind: str) -> None:
    springs = kind == "springs"
    subject, time_step = (Subject("spring_mass"), SHORTEST) if springs else (IN_TIME, 1.0 / RATE)
    share = bought(subject, cost_of(ms, time_step), budget_ms, RATE)
    values = share.subject.values
    simulated = share.steps * values.get("time_step", time_step)
    assert share.real_time == math.isclose(simulated, 1.0 / RATE)
    assert simulated < (1.0 + 1e-9) / RATE
    # Never more than what was paid for, but for a fraction's rounding.
    assert share.steps * values.get("iterations", 1.0) * ms <= 1.01 * budget_ms
    if springs:
        # A budget for the shortest steps buys exactly them, with masses as they are.
        enough = int(budget_ms / ms) >= round(1.0 / (RATE * SHORTEST))
        assert ("mass_scaling" in values) != enough
    share.subject.checked()


def test_a_step_is_measured_while_the_model_works(trial: Trial) -> None:
    springs, solid = (
        step_cost(Subject(name), trial.organ, trial.interaction, budget_ms=0.5)
        for name in ("spring_mass", "finite_element")
    )
    assert springs.time_step is not None
    assert solid.time_step is None
    assert springs.ms > 0.0
    # Springs swing through all frames; once motions are known finite elements have nothing to do.
    assert springs.steps > 10 * trial.interaction.frames
    assert trial.interaction.frames <= solid.steps + 1 < springs.steps


def test_references_are_exact_for_themselves_and_the_worst_is_one(trial: Trial) -> None:
    own = trial.errors(simulate(REFERENCES["linear"].subject, trial.organ, trial.interaction))
    assert own["linear"] == Error(0.0, 0.0, 0.0, 0.0, 0.0)
    assert 0.0 < own["corotated"].relative < 0.5
    for error in trial.errors(only_held(trial.organ, trial.interaction)).values():
        assert error.relative == 1.0
        assert error.mean_mm < error.p95_mm < error.largest_mm


def test_a_reference_counts_the_last_of_so_many_frames(trial: Trial) -> None:
    reference = Reference(Subject("finite_element", effort=Effort(to_rest=1e-9)), every=4)
    worst = only_held(trial.organ, trial.interaction)
    seen = reference.seen(worst)
    assert seen.frames == worst.frames // 4
    assert seen.rate_hz == RATE / 4
    np.testing.assert_array_equal(seen.displacement[2], worst.displacement[11])
    # Equilibrium has no memory: the shape of a frame does not depend on how many came before it.
    every = Reference(reference.subject).moved(trial.organ, trial.interaction, lambda line: None)
    few = reference.moved(trial.organ, trial.interaction, lambda line: None)
    far = np.abs(few.displacement - reference.seen(every).displacement).max()
    assert far < 1e-3 * trial.interaction.amplitude


def test_a_row_says_all_that_another_run_needs(trial: Trial) -> None:
    row = trial.judged(Subject("quasi_static", label="springs"), cost_of(2.5), 4.0)
    assert (row.label, row.model, row.steps, row.lost) == ("springs", "quasi_static", 1.0, 0)
    again = Row.of(json.loads(json.dumps(asdict(row))))
    assert again == row
    assert trial.errors(simulate(again.subject, trial.organ, trial.interaction)) == row.errors


def row_of(label: str, linear: float, corotated: float, interaction: str = "normal") -> Row:
    errors = {"linear": linear, "corotated": corotated}
    return Row(
        "wall", interaction, label, 4.0, label, {}, 2.0, label != "spring_mass", 3.9, 0,
        {name: Error(error, error, error, error, error) for name, error in errors.items()},
    )  # fmt: skip


def test_models_are_ordered_by_the_mean_over_the_interactions() -> None:
    rows = [
        row_of("lr", 0.5, 0.1), row_of("spring_mass", 0.3, 0.3),
        row_of("lr", 0.2, 0.1, "oblique"), row_of("spring_mass", 0.5, 0.3, "oblique"),
    ]  # fmt: skip
    assert [each.label for each in standings(rows, "wall", 4.0)] == ["lr", "spring_mass"]
    assert standings(rows, "wall", 4.0)[0].relative() == pytest.approx(0.35)
    assert standings(rows, "wall", 4.0)[0].relative(SECOND) == pytest.approx(0.1)
    assert standings(rows, "heart", 4.0) == []
    costs = [
        {"label": label, "budget_ms": 4.0, "cost": asdict(cost_of(1.5))}
        for label in ("lr", "spring_mass")
    ]
    about = {"nodes": 884, "costs": costs}
    lines = as_markdown({"organs": {"wall": about}, "rows": [asdict(row) for row in rows]})
    assert "| 1 | `lr` | **0.350** | 0.200 .. 0.500 |" in lines
    assert "| 2 | `spring_mass` (slower than real time) | **0.400** | 0.300 .. 0.500 |" in lines


def test_a_study_goes_on_where_it_was_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(study, "SUBJECTS", (Subject("relaxation"), Subject("chain_mail")))
    monkeypatch.setattr(study, "step_cost", lambda *of: cost_of(0.3))
    monkeypatch.setattr(study, "measure_triad", lambda: 1e10)
    monkeypatch.setitem(REFERENCES, "corotated", REFERENCES["linear"])
    file = tmp_path / "errors.json"
    whole = study.run(file, ("wall",), ("oblique",), (1.0,), fits=())
    assert json.loads(file.read_text()) == whole
    assert [row["label"] for row in whole["rows"]] == ["relaxation", "chain_mail"]
    interrupted = {**whole, "rows": whole["rows"][:1]}
    file.write_text(json.dumps(interrupted))
    resumed = study.run(file, ("wall",), ("oblique",), (1.0,), resume=True, fits=())
    assert resumed["organs"] == whole["organs"]
    for now, then in zip(resumed["rows"], whole["rows"], strict=True):
        assert {**now, "ms": 0.0} == {**then, "ms": 0.0}
    elsewhere = {**whole, "machine": {**whole["machine"], "processor": "abacus"}}
    file.write_text(json.dumps(elsewhere))
    with pytest.raises(ValueError, match="measured on abacus"):
        Study(file, resume=True)
    with pytest.raises(ValueError, match="budget of 0 ms a frame is out of range"):
        study.run(None, ("wall",), budgets_ms=(0.0,))


def test_tables_take_the_place_of_those_before() -> None:
    page = f"before\n{BEGIN}\nold\n{END}\nafter\n"
    once = into_page(page, "new")
    assert once == f"before\n{BEGIN}\nnew\n{END}\nafter\n"
    assert into_page(once, "new") == once
    with pytest.raises(ValueError, match="no place for tables"):
        into_page("before\n", "new")


def test_every_model_takes_part() -> None:
    assert {subject.model for subject in study.SUBJECTS} == set(registry.names())
    for subject in study.SUBJECTS:
        subject.checked()


def test_the_study_is_shown_as_it_came_out(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    file = repository / "docs/results/model_errors.json"
    result = json.loads(file.read_text(encoding="utf-8"))
    page = (repository / "docs/model_errors.md").read_text(encoding="utf-8")
    assert into_page(page, as_markdown(result)) == page
    assert (repository / "docs/pictures/model_errors.png").is_file()
    rows = {
        (row.organ, row.interaction, row.label, row.budget_ms): row
        for row in map(Row.of, result["rows"])
    }
    labels = [subject.name for subject in (*study.SUBJECTS, *(f.subject for f in FITS))]
    organs, budgets = study.ORGANS, study.BUDGETS_MS
    assert set(rows) == set(product(organs, MOTIONS, labels, budgets))
    # What the page says, and is.
    for budget in budgets:
        first = standings(rows.values(), "wall", budget)
        relative = {each.label: each.relative() for each in first}
        corotated = {each.label: each.relative(SECOND) for each in first}
        assert first[0].label == "finite_element"
        assert relative["finite_element"] < 0.005
        for solid in ("vertex_block_descent, all levels", "finite_element, corotated"):
            assert relative[solid] < min(relative["quasi_static"], relative["spring_mass"])
            assert corotated[solid] < corotated["quasi_static"]
            assert corotated[solid] < corotated["finite_element"] or budget < 4.0
        for springs in ("quasi_static", "spring_mass", "relaxation", "lr"):
            assert corotated[springs] > 0.2
        for model in ("vertex_block_descent", "lr"):
            assert relative[f"{model}, all levels"] < relative[model]
    for chains in ("chain_mail", "voxel_chain_mail"):
        found = [
            each.relative()
            for budget in budgets
            for each in standings(rows.values(), "wall", budget)
            if each.label == chains
        ]
        assert max(found) - min(found) < 0.01
    at_once = {each.label: each.relative() for each in standings(rows.values(), "wall", 1.0)}
    for springs in ("quasi_static", "lr"):
        assert at_once[f"{springs}, fitted"] > at_once[f"{springs}, all levels"]
    for chains in ("chain_mail", "voxel_chain_mail"):
        assert at_once[f"{chains}, fitted"] < at_once[chains]
    for budget in budgets:
        heart = standings(rows.values(), "heart", budget)
        assert heart[0].label == "finite_element"
        if budget == min(budgets):
            rest = [each for each in heart if not each.label.startswith("finite_element")]
            assert min(each.relative() for each in rest) > 0.4
    # Spot check: with the stored steps the errors come out again.
    trial = Trial.of(load_organ("wall"), "normal", ("linear",))
    for label in ("chain_mail", "quasi_static"):
        row = rows["wall", "normal", label, 1.0]
        again = trial.errors(simulate(row.subject, trial.organ, trial.interaction))["linear"]
        assert again.relative == pytest.approx(row.errors["linear"].relative, rel=1e-3)
        assert again.volume == pytest.approx(row.errors["linear"].volume, rel=1e-2)
