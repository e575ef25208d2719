"""Whether a score repeats: for the same people again, and for another rater.

References:
    P. E. Shrout, J. L. Fleiss: Intraclass correlations: uses in assessing rater reliability.
    Psychological Bulletin 86(2), 1979, 420-428, doi:10.1037/0033-2909.86.2.420.
    K. O. McGraw, S. P. Wong: Forming inferences about some intraclass correlation coefficients.
    Psychological Methods 1(1), 1996, 30-46, doi:10.1037/1082-989X.1.1.30 (intervals).
    T. K. Koo, M. Y. Li: A guideline of selecting and reporting intraclass correlation coefficients
    for reliability research. J. Chiropractic Medicine 15(2), 2016, 155-163,
    doi:10.1016/j.jcm.2016.02.012.
    J. M. Bland, D. G. Altman: Statistical methods for assessing agreement between two methods of
    clinical measurement. Lancet 327(8476), 1986, 307-310, doi:10.1016/S0140-6736(86)90837-8.
    J. Cohen: Weighted kappa. Psychological Bulletin 70(4), 1968, 213-220, doi:10.1037/h0026256.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import f as f_distribution

Reals = NDArray[np.float64]

CONFIDENCE = 0.95
NAN = float("nan")


@dataclass(frozen=True)
class Intraclass:
    """An intraclass correlation coefficient with its confidence interval at `CONFIDENCE`."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Variances:
    """Mean squares of scores of n targets, each scored k times (two-way analysis of variance).

    Attributes:
        targets: n.
        scores: k.
        between: Of targets (BMS).
        within: Within targets (WMS).
        columns: Of scorings (JMS).
        error: What is left (EMS).
    """

    targets: int
    scores: int
    between: float
    within: float
    columns: float
    error: float


def variances_of(scores: Reals) -> Variances:
    """Mean squares of scores, shape (targets, scorings).

    Raises:
        ValueError: There are fewer than two targets or scorings, or a score is not finite.
    """
    scores = np.asarray(scores, dtype=np.float64)
    if scores.ndim != 2 or min(scores.shape) < 2:
        raise ValueError("a reliability needs at least two targets that are scored at least twice")
    if not np.isfinite(scores).all():
        raise ValueError("a reliability needs a score of every target in every scoring")
    n, k = scores.shape
    mean = scores.mean()
    between = k * float(((scores.mean(axis=1) - mean) ** 2).sum())
    columns = n * float(((scores.mean(axis=0) - mean) ** 2).sum())
    total = float(((scores - mean) ** 2).sum())
    error = max(total - between - columns, 0.0)
    return Variances(
        n, k, between / (n - 1), (total - between) / (n * (k - 1)), columns / (k - 1),
        error / ((n - 1) * (k - 1)),
    )  # fmt: skip


def absolute_agreement(scores: Reals) -> Intraclass:
    """ICC(2,1) of Shrout and Fleiss: agreement of single scores, scorings drawn at random.

    What Koo and Li recommend for test and retest and for raters that stand for others: a constant
    difference between the scorings lowers it.

    Args:
        scores: Shape (targets, scorings).

    Raises:
        ValueError: As `variances_of`.
    """
    v = variances_of(scores)
    n, k = v.targets, v.scores
    whole = v.between + (k - 1) * v.error + k * (v.columns - v.error) / n
    if whole <= 0.0:
        return Intraclass(NAN, NAN, NAN)
    value = (v.between - v.error) / whole
    if v.error <= 0.0:
        return Intraclass(value, NAN, NAN)
    # Satterthwaite's degrees of freedom (McGraw and Wong, table 7).
    odds = k * value / (n * (1.0 - value))
    from_columns, from_error = odds * v.columns, (1.0 + odds * (n - 1)) * v.error
    spread = from_columns**2 / (k - 1) + from_error**2 / ((n - 1) * (k - 1))
    if spread <= 0.0:
        return Intraclass(value, NAN, NAN)
    freedom = (from_columns + from_error) ** 2 / spread
    upper, lower = _quantile(n - 1, freedom), _quantile(freedom, n - 1)
    rest = k * v.columns + (k * n - k - n) * v.error
    return Intraclass(
        value,
        n * (v.between - upper * v.error) / (upper * rest + n * v.between),
        n * (lower * v.between - v.error) / (rest + n * lower * v.between),
    )


def consistency(scores: Reals) -> Intraclass:
    """ICC(3,1) of Shrout and Fleiss: consistency of single scores, just these scorings.

    A constant difference between the scorings, such as learning, does not lower it.

    Args:
        scores: Shape (targets, scorings).

    Raises:
        ValueError: As `variances_of`.
    """
    v = variances_of(scores)
    n, k = v.targets, v.scores
    whole = v.between + (k - 1) * v.error
    if whole <= 0.0:
        return Intraclass(NAN, NAN, NAN)
    value = (v.between - v.error) / whole
    if v.error <= 0.0:
        return Intraclass(value, NAN, NAN)
    ratio, freedom = v.between / v.error, (n - 1) * (k - 1)
    low, high = ratio / _quantile(n - 1, freedom), ratio * _quantile(freedom, n - 1)
    return Intraclass(value, (low - 1) / (low + k - 1), (high - 1) / (high + k - 1))


def standard_error_of_measurement(scores: Reals) -> float:
    """Standard deviation of a person's scores about their own, in the score's unit.

    The root of the error's and the scorings' variances, which is what absolute agreement counts.
    Two scores of one person differ by more than 2.77 times that in one case of twenty.

    Args:
        scores: Shape (targets, scorings).

    Raises:
        ValueError: As `variances_of`.
    """
    v = variances_of(scores)
    return float(np.sqrt(max((v.columns - v.error) / v.targets, 0.0) + v.error))


@dataclass(frozen=True)
class Agreement:
    """Differences of two scorings (Bland and Altman), in the score's unit.

    Attributes:
        bias: Mean of second minus first.
        low: Lower limit of agreement: bias less 1.96 standard deviations of the differences.
        high: Upper limit of agreement.
    """

    bias: float
    low: float
    high: float


def agreement(first: Reals, second: Reals) -> Agreement:
    """Limits of agreement of two scorings of the same targets, shape (n,) each, n at least 2."""
    apart = np.asarray(second, dtype=np.float64) - np.asarray(first, dtype=np.float64)
    if len(apart) < 2:
        raise ValueError("limits of agreement need at least two targets")
    bias, spread = float(apart.mean()), 1.96 * float(apart.std(ddof=1))
    return Agreement(bias, bias - spread, bias + spread)


def correlation(first: Reals, second: Reals) -> float:
    """Pearson's correlation of two scorings; nan where one of them does not vary.

    It is the thesis' measure of test and retest. It says nothing of a constant difference.
    """
    if len(first) < 2 or min(float(np.ptp(first)), float(np.ptp(second))) <= 0.0:
        return NAN
    return float(np.corrcoef(first, second)[0, 1])


def weighted_kappa(first: Reals, second: Reals) -> float:
    """Cohen's kappa of two raters' ordered grades with quadratic weights.

    0: no more agreement than by chance; 1: full agreement. Grades are numbers, and a disagreement
    counts with the square of their difference. With two grades it is the plain kappa.

    Args:
        first: Grades of one rater, shape (n,).
        second: Grades of the other for the same targets, shape (n,).

    Returns:
        The value; nan where both give everybody the same grade.
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    by_chance = float(((a[:, None] - b) ** 2).mean())
    if by_chance <= 0.0:
        return NAN
    return 1.0 - float(((a - b) ** 2).mean()) / by_chance


def cliffs_delta(one: ArrayLike, other: ArrayLike) -> float:
    """How far two groups' scores lie apart: P(one > other) - P(one < other), -1 to 1.

    Args:
        one: Scores of a group, shape (n,).
        other: Scores of the other group, shape (m,).

    References:
        N. Cliff: Dominance statistics. Psychological Bulletin 114(3), 1993, 494-509,
        doi:10.1037/0033-2909.114.3.494.
    """
    return float(np.sign(np.subtract.outer(np.asarray(one), np.asarray(other))).mean())


def _quantile(first: float, second: float) -> float:
    return float(f_distribution.ppf(0.5 + 0.5 * CONFIDENCE, first, second))
