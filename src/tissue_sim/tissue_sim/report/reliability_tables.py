"""Test and retest, raters, and known groups, over the sessions of a study.

The thesis' appendix C defines these kinds of reliability and validity and tabulates no figures:
test-retest is "a correlation between the scores on each testing" of the same persons, inter-rater
the extent to which different raters score the same test alike.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, combinations

import numpy as np

from tissue_sim.report.reliability import (
    Agreement,
    Intraclass,
    Reals,
    absolute_agreement,
    agreement,
    cliffs_delta,
    consistency,
    correlation,
    standard_error_of_measurement,
    weighted_kappa,
)
from tissue_sim.report.study import EXPERT, TRAINEE, Entry
from tissue_sim.report.summary import Figure

FEWEST = 2
"""Persons (of each group), or sessions that were rated, below which nothing can be said."""


@dataclass(frozen=True)
class Repeated:
    """How well a score repeats.

    Attributes:
        label: Of the figure, or the item and the raters.
        unit: Of the score, SI; empty: a plain number.
        targets: Persons, or sessions.
        correlation: Pearson's.
        agree: ICC(2,1), absolute agreement.
        consistent: ICC(3,1), consistency.
        error: Standard error of measurement, in the unit.
        limits: Bland and Altman's limits of agreement, second less first; None: more than two.
        kappa: Cohen's, with quadratic weights; nan where scores are no whole grades.
    """

    label: str
    unit: str
    targets: int
    correlation: float
    agree: Intraclass
    consistent: Intraclass
    error: float
    limits: Agreement | None
    kappa: float = math.nan


@dataclass(frozen=True)
class Groups:
    """What experts and trainees reach: one value a person, the median of their sessions.

    Attributes:
        label: Of the figure.
        unit: SI; empty: a plain number.
        experts: Median of the experts.
        trainees: Median of the trainees.
        expert_count: Experts with this figure.
        trainee_count: Trainees with it.
        delta: Cliff's delta, experts over trainees, -1 to 1.
    """

    label: str
    unit: str
    experts: float
    trainees: float
    expert_count: int
    trainee_count: int
    delta: float


def repeats_of(entries: Sequence[Entry]) -> list[tuple[int, int]]:
    """First and second session of each person who did at least two, as places in the list."""
    by_person: dict[str, list[int]] = {}
    for place, entry in enumerate(entries):
        if entry.person:
            by_person.setdefault(entry.person, []).append(place)
    pairs = []
    for places in by_person.values():
        ordered = sorted(places, key=lambda place: _natural(entries[place].session))
        if len(ordered) >= 2:
            pairs.append((ordered[0], ordered[1]))
    return pairs


def first_and_second(
    entries: Sequence[Entry], figures: Sequence[Sequence[Figure]]
) -> list[Repeated]:
    """How each figure repeats from the first to the second session of the same persons.

    Args:
        entries: Sessions on one organ.
        figures: Figures of each.

    Returns:
        A row for each figure that at least `FEWEST` persons have in both; may be empty.
    """
    pairs = repeats_of(entries)
    by_key = [{figure.key: figure.value for figure in of} for of in figures]
    rows = []
    for figure in _all(figures):
        scores = np.array(
            [
                (by_key[first].get(figure.key, math.nan), by_key[second].get(figure.key, math.nan))
                for first, second in pairs
            ]
        ).reshape(-1, 2)
        scores = scores[np.isfinite(scores).all(axis=1)]
        if len(scores) >= FEWEST and np.ptp(scores) > 0.0:
            label = f"{figure.group}: {figure.label}"
            rows.append(_repeated(label, figure.unit, scores, graded=False))
    return rows


def inter_rater(entries: Sequence[Entry]) -> list[Repeated]:
    """How alike raters score the same sessions: all of them together, and each two.

    Returns:
        Rows by item; may be empty.
    """
    items = dict.fromkeys(
        item for entry in entries for scores in entry.ratings.values() for item in scores
    )
    raters = list(dict.fromkeys(rater for entry in entries for rater in entry.ratings))
    rows = []
    for item in items:
        chosen = [r for r in raters if any(item in e.ratings.get(r, {}) for e in entries)]
        groups: list[tuple[str, ...]] = list(combinations(chosen, 2))
        if len(chosen) > 2:
            groups.insert(0, tuple(chosen))
        for group in groups:
            scores = _scores(entries, item, group)
            if len(scores) >= FEWEST:
                who = "all raters" if len(group) > 2 else " and ".join(group)
                rows.append(_repeated(f"{item}: {who}", "", scores, graded=True))
    return rows


def known_groups(entries: Sequence[Entry], figures: Sequence[Sequence[Figure]]) -> list[Groups]:
    """What experts and trainees reach; empty with fewer than `FEWEST` persons in a group.

    Args:
        entries: Sessions on one organ. A session without a person is a person of its own.
        figures: Figures of each.
    """
    rows = []
    for figure in _all(figures):
        values: dict[str, dict[str, list[float]]] = {EXPERT: {}, TRAINEE: {}}
        for place, (entry, of) in enumerate(zip(entries, figures, strict=True)):
            found = next((f.value for f in of if f.key == figure.key), math.nan)
            if entry.role and math.isfinite(found):
                who = entry.person or f"session {place}"
                values[entry.role].setdefault(who, []).append(found)
        one, other = (
            np.array([float(np.median(of)) for of in values[role].values()])
            for role in (EXPERT, TRAINEE)
        )
        if min(len(one), len(other)) >= FEWEST:
            label, middle = f"{figure.group}: {figure.label}", float(np.median(other))
            delta = cliffs_delta(one, other)
            rows.append(
                Groups(
                    label, figure.unit, float(np.median(one)), middle, len(one), len(other), delta
                )
            )
    return rows


def _repeated(label: str, unit: str, scores: Reals, graded: bool) -> Repeated:
    two = scores.shape[1] == 2
    first, second = scores[:, 0], scores[:, 1]
    whole = graded and two and bool((scores == np.round(scores)).all())
    return Repeated(
        label, unit, len(scores), correlation(first, second) if two else math.nan,
        absolute_agreement(scores), consistency(scores), standard_error_of_measurement(scores),
        agreement(first, second) if two else None,
        weighted_kappa(first, second) if whole else math.nan,
    )  # fmt: skip


def _scores(entries: Sequence[Entry], item: str, raters: Sequence[str]) -> Reals:
    """Scores of the sessions that all raters scored, shape (sessions, raters)."""
    rows = [
        [entry.ratings[rater][item] for rater in raters]
        for entry in entries
        if all(item in entry.ratings.get(rater, {}) for rater in raters)
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, len(raters))


def _all(figures: Sequence[Sequence[Figure]]) -> list[Figure]:
    """Every figure that any session has, in the order they appear."""
    found: dict[str, Figure] = {}
    for figure in chain.from_iterable(figures):
        found.setdefault(figure.key, figure)
    return list(found.values())


def _natural(text: str) -> list[tuple[int, int, str]]:
    """Sorts 2 before 10."""
    parts = re.findall(r"\d+|\D+", text)
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts]
