"""Reliability against the tables of the papers that define it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tissue_sim.report.reliability import (
    absolute_agreement,
    agreement,
    cliffs_delta,
    consistency,
    correlation,
    standard_error_of_measurement,
    variances_of,
    weighted_kappa,
)

SHROUT_FLEISS = np.array(
    [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]],
    dtype=np.float64,
)
"""Table 2 of Shrout and Fleiss (1979): four judges' ratings of six targets."""


def test_mean_squares_are_those_of_shrout_and_fleiss() -> None:
    """Their table 3."""
    found = variances_of(SHROUT_FLEISS)
    assert found.between == pytest.approx(11.24, abs=0.005)
    assert found.within == pytest.approx(6.26, abs=0.005)
    assert found.columns == pytest.approx(32.49, abs=0.005)
    assert found.error == pytest.approx(1.02, abs=0.005)


def test_intraclass_correlations_are_those_of_shrout_and_fleiss() -> None:
    """Their table 4; the intervals as R's package psych prints them for these data."""
    agree = absolute_agreement(SHROUT_FLEISS)
    assert (agree.value, agree.low, agree.high) == pytest.approx((0.290, 0.019, 0.761), abs=6e-4)
    consistent = consistency(SHROUT_FLEISS)
    assert consistent.value == pytest.approx(0.715, abs=6e-4)
    assert (consistent.low, consistent.high) == pytest.approx((0.342, 0.946), abs=6e-4)


def test_a_constant_difference_lowers_agreement_but_not_consistency() -> None:
    first = np.array([3.0, 5.0, 8.0, 9.0, 12.0])
    scores = np.stack([first, first + 4.0], axis=1)
    assert consistency(scores).value == pytest.approx(1.0)
    assert correlation(scores[:, 0], scores[:, 1]) == pytest.approx(1.0)
    # Var of targets 12.3; of the scorings 8, which agreement counts as error.
    assert absolute_agreement(scores).value == pytest.approx(12.3 / (12.3 + 8.0))
    assert standard_error_of_measurement(scores) == pytest.approx(np.sqrt(8.0))
    apart = agreement(scores[:, 0], scores[:, 1])
    assert (apart.bias, apart.low, apart.high) == pytest.approx((4.0, 4.0, 4.0))


def test_limits_of_agreement_hold_the_differences() -> None:
    """Differences -1, 0, 1, 2: mean 0.5, standard deviation sqrt(5/3)."""
    found = agreement(np.zeros(4), np.array([-1.0, 0.0, 1.0, 2.0]))
    assert found.bias == pytest.approx(0.5)
    assert found.high - found.bias == pytest.approx(1.96 * np.sqrt(5.0 / 3.0))
    assert found.bias - found.low == pytest.approx(found.high - found.bias)


def test_kappa_of_two_grades_is_cohens() -> None:
    """20 times both yes, 15 both no, 5 and 10 apart: observed 0.7, by chance 0.5, kappa 0.4."""
    first = np.repeat([1.0, 1.0, 0.0, 0.0], [20, 5, 10, 15])
    second = np.repeat([1.0, 0.0, 1.0, 0.0], [20, 5, 10, 15])
    assert weighted_kappa(first, second) == pytest.approx(0.4)


GRADES = st.lists(st.tuples(st.integers(1, 5), st.integers(1, 5)), min_size=2, max_size=30).filter(
    lambda pairs: len({grade for pair in pairs for grade in pair}) > 1
)


@settings(deadline=None)
@given(GRADES)
def test_weighted_kappa_is_that_of_the_table_of_grades(pairs: list[tuple[int, int]]) -> None:
    """The definition with weights (i - j)^2 over observed and expected shares."""
    observed = np.zeros((5, 5))
    for one, other in pairs:
        observed[one - 1, other - 1] += 1.0 / len(pairs)
    expected = np.outer(observed.sum(axis=1), observed.sum(axis=0))
    weights = np.subtract.outer(np.arange(5), np.arange(5)) ** 2
    first, second = np.array(pairs, dtype=np.float64).T
    defined = 1.0 - (weights * observed).sum() / (weights * expected).sum()
    assert weighted_kappa(first, second) == pytest.approx(defined)


@settings(max_examples=20, deadline=None)
@given(GRADES)
def test_kappa_of_many_is_the_agreement_of_raters(pairs: list[tuple[int, int]]) -> None:
    """Fleiss and Cohen (1973): with n targets instead of n - 1, it is ICC(2,1)."""
    scores = np.tile(np.array(pairs, dtype=np.float64), (1000, 1))
    assert weighted_kappa(*scores.T) == pytest.approx(absolute_agreement(scores).value, abs=2e-3)


def test_cliffs_delta_counts_pairs() -> None:
    """Of 6 pairs 4 are greater, 1 is less, 1 equal."""
    assert cliffs_delta([2.0, 5.0], [1.0, 2.0, 3.0]) == pytest.approx((4 - 1) / 6)
    assert cliffs_delta([1.0], [2.0]) == -1.0


@pytest.mark.parametrize("scores", [np.ones((1, 3)), np.ones((3, 1)), np.full((2, 2), np.nan)])
def test_too_few_or_missing_scores_are_refused(scores: np.ndarray) -> None:
    with pytest.raises(ValueError, match="reliability needs"):
        absolute_agreement(scores)


def test_scores_without_any_difference_have_no_reliability() -> None:
    same = np.ones((4, 2))
    assert np.isnan(absolute_agreement(same).value)
    assert np.isnan(consistency(same).value)
    assert np.isnan(correlation(same[:, 0], same[:, 1]))
    assert np.isnan(weighted_kappa(same[:, 0], same[:, 1]))
