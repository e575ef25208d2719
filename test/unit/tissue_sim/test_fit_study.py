"""The study of fits computes what its page shows."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console

from tissue_sim.compare.fit.fit_study import run
from tissue_sim.compare.fit.fit_study_table import as_markdown, print_result
from tissue_sim.compare.fit.fit_trials import SELF_FITS, THESIS, Size, self_problem

SMALL = Size((4, 5, 2), (0.2, 0.1), (1, 2), (4, 4), (2, 2), processes=1)


def test_each_model_has_no_error_where_it_is_itself() -> None:
    for fit in SELF_FITS:
        problem = self_problem(fit, SMALL)
        truth = problem.space.encode(problem.subject.values)
        assert problem.evaluate(truth).error < 1e-6


def test_of_step_and_stiffness_the_product_counts() -> None:
    """THESIS.md, section 7: they trade off along a valley."""
    problem = self_problem(THESIS, SMALL)
    for factor in (0.4, 2.0, 4.0):
        values = {"force_step": 0.2 * factor, "springs.stiffness": 0.2 / factor}
        assert problem.evaluate(problem.space.encode(values)).error < 1e-6
        values["force_step"] *= 1.02
        assert problem.evaluate(problem.space.encode(values)).error > 1e-3


def test_the_study_is_written_and_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = run(tmp_path / "docs" / "fit.json", SMALL)
    assert (tmp_path / "docs" / "fit.json").exists()
    assert result["times"]["same_seed_same_result"]
    assert result["times"]["resumed_same_result"]
    assert len(result["self"]) == 2 * (len(SMALL.seeds) + len(SELF_FITS) - 1)
    capsys.readouterr()
    print_result(result, Console(width=80))
    table = capsys.readouterr().out
    assert len([line for line in table.splitlines() if THESIS.name in line]) == 4
    assert max(map(len, table.splitlines()[:8])) <= 80
    assert len(as_markdown(result).splitlines()) == 2 + len(result["self"])
