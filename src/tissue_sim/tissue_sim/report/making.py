"""From sessions to a report."""

from __future__ import annotations

from collections.abc import Sequence

from tissue_sim.report.document import Comparison, Reported
from tissue_sim.report.reliability_tables import first_and_second, inter_rater, known_groups
from tissue_sim.report.session import Session
from tissue_sim.report.study import EXPERT, Entry
from tissue_sim.report.summary import Settings, deviations_of, figures_of
from tissue_sim.report.words import same_organ


def reported_of(entry: Entry, session: Session, settings: Settings) -> Reported:
    """A session with its figures.

    Raises:
        ValueError: A hand has a tool that is not in it.
    """
    return Reported(entry, session, figures_of(session, settings), deviations_of(session, settings))


def comparisons_of(reported: Sequence[Reported]) -> list[Comparison]:
    """Sessions side by side, those on each organ by themselves, experts first."""
    found = []
    for places in same_organ([one.session for one in reported]):
        if len(places) < 2:
            continue
        places = sorted(places, key=lambda place: reported[place].entry.role != EXPERT)
        entries = [reported[place].entry for place in places]
        figures = [reported[place].figures for place in places]
        found.append(
            Comparison(
                places,
                first_and_second(entries, figures),
                inter_rater(entries),
                known_groups(entries, figures),
            )
        )
    return found
