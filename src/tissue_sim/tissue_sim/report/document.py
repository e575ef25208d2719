"""The report as plain JSON values in SI units; docs/session_report.md is the schema."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from tissue_sim.compare.report.result import made, number, numbers
from tissue_sim.report.plan import Deviation
from tissue_sim.report.reliability_tables import Groups, Repeated
from tissue_sim.report.session import CutMade, Missing, Session
from tissue_sim.report.study import Entry
from tissue_sim.report.summary import Figure, Settings

FORMAT = 1
"""Version of the schema."""


@dataclass(frozen=True)
class Reported:
    """A session with what was made of it.

    Attributes:
        entry: Who did it.
        session: The session.
        figures: Its figures.
        deviations: Of its cuts from their plans, one for each.
    """

    entry: Entry
    session: Session
    figures: list[Figure]
    deviations: list[Deviation | None]


@dataclass(frozen=True)
class Comparison:
    """Sessions on one organ side by side.

    Attributes:
        places: Of the sessions in the report, experts first.
        retest: How figures repeat.
        raters: How raters agree.
        groups: What experts and trainees reach.
    """

    places: list[int]
    retest: list[Repeated]
    raters: list[Repeated]
    groups: list[Groups]


def report_document(
    reported: Sequence[Reported],
    comparisons: Sequence[Comparison],
    settings: Settings,
    command: str = "",
) -> dict[str, Any]:
    """The report, in SI units, with None for what is not a number."""
    return {
        "format": FORMAT,
        "made": made(command),
        "settings": {
            "idle_speed_m_s": settings.idle_speed,
            "hands": {hand: list(tools) for hand, tools in settings.hands.items()},
            "plans": [plan.name for plan in settings.plans],
        },
        "sessions": [_session(one) for one in reported],
        "comparisons": [
            {
                "sessions": [reported[place].session.name for place in one.places],
                "test_retest": [_plain(asdict(row)) for row in one.retest],
                "inter_rater": [_plain(asdict(row)) for row in one.raters],
                "known_groups": [_plain(asdict(row)) for row in one.groups],
            }
            for one in comparisons
        ],
    }


def _session(one: Reported) -> dict[str, Any]:
    session, entry = one.session, one.entry
    return {
        "name": session.name,
        "bag": session.bag,
        "person": entry.person,
        "session": entry.session,
        "role": entry.role,
        "ratings": entry.ratings,
        "organ": {"name": session.organ, "digest": session.digest, "nodes": session.nodes},
        "models": list(session.models),
        "rate_hz": session.rate_hz,
        "notes": list(session.notes),
        "figures": {
            figure.key: {
                "label": f"{figure.group}: {figure.label}",
                "unit": figure.unit,
                "value": number(figure.value),
                **({"why": figure.why} if figure.why else {}),
            }
            for figure in one.figures
        },
        "events": [asdict(event) for event in session.events],
        "stress": _stress(session),
        "cuts": _missing(session.cuts) or _cuts(session.cuts, one.deviations),
        "violations": _missing(session.violations)
        or [_plain(asdict(violation)) for violation in _listed(session.violations)],
        "holes": _missing(session.holes) or _holes(session),
    }


def _stress(session: Session) -> Any:
    stress = session.stress
    if isinstance(stress, Missing):
        return str(stress)
    peak = stress.peak
    return {
        "quantity": stress.quantity,
        "unit": stress.unit,
        "source": stress.source,
        "seconds": numbers(peak.times),
        "peak": numbers(peak.values),
    }


def _cuts(cuts: Any, deviations: Sequence[Deviation | None]) -> list[dict[str, Any]]:
    return [
        _cut(cut) | {"deviation": None if apart is None else _plain(asdict(apart))}
        for cut, apart in zip(cuts, deviations, strict=True)
    ]


def _cut(cut: CutMade) -> dict[str, Any]:
    surface = cut.surface
    return {
        "kind": cut.kind,
        "tool": cut.tool,
        "begin": cut.begin,
        "end": cut.end,
        "edits": cut.edits,
        "removed_elements": cut.removed,
        "undone": cut.undone,
        "length_m": number(surface.length),
        "area_m2": number(surface.area),
        "mean_depth_m": number(surface.mean_depth),
        "depth_m": number(surface.depth),
    }


def _holes(session: Session) -> dict[str, Any]:
    holes = {} if isinstance(session.holes, Missing) else session.holes
    return {
        name: {
            "first_area_m2": number(hole.first_area),
            "seconds": numbers(hole.times),
            "covered": numbers(hole.covered),
            "open_area_m2": numbers(hole.open_area),
            "gap_m": numbers(hole.gap),
            "problem": hole.problem,
        }
        for name, hole in holes.items()
    }


def _missing(what: object) -> str:
    return str(what) if isinstance(what, Missing) else ""


def _listed(what: Any) -> Sequence[Any]:
    return () if isinstance(what, Missing) else what


def _plain(value: Any) -> Any:
    """With None for numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _plain(of) for key, of in value.items()}
    return number(value) if isinstance(value, float) else value
