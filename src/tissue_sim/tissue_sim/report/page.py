"""The report of sessions: one HTML page that needs nothing else and no network."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tissue_sim.compare.report import markup
from tissue_sim.compare.report.pictures import data_uri
from tissue_sim.compare.report.result import made
from tissue_sim.report import plots
from tissue_sim.report.document import Comparison, Reported
from tissue_sim.report.meaning import LIMITS, MEANING, RELIABILITY, VALIDITY
from tissue_sim.report.reliability import Intraclass
from tissue_sim.report.reliability_tables import Groups, Repeated
from tissue_sim.report.session import Missing, Session
from tissue_sim.report.summary import Figure, Settings
from tissue_sim.report.words import NONE, cell, grouped, number, shown, with_unit

Draw = Callable[[Session], tuple[list[tuple[bytes, str]], str]]
"""Pictures of a session as PNG files with captions, and why there are none."""

NARROW = 2
"""Tables of so many sessions are narrow enough to stand beside each other."""
VALUE_COLUMNS = ("n", "r", "ICC(2,1)", "95 %", "ICC(3,1)", "SEM", "bias", "limits", "kappa")


def page(
    reported: Sequence[Reported],
    comparisons: Sequence[Comparison],
    settings: Settings,
    draw: Draw,
    command: str = "",
) -> str:
    """The whole report.

    Args:
        reported: The sessions.
        comparisons: Those on one organ side by side.
        settings: What the figures depend on.
        draw: What draws pictures of a session.
        command: The command that made it, as a person would type it again.
    """
    names = ", ".join(one.session.name for one in reported)
    title = f"Report of {'a session' if len(reported) == 1 else 'sessions'}: {names}"
    parts = [
        markup.heading(1, title),
        markup.paragraph(
            "What was done to the tissue and how, from the recording. These figures describe; "
            "they do not judge: see the end of this page.",
            "lead",
        ),
        _what(reported, settings, command),
    ]
    parts += [_comparison(one, reported) for one in comparisons]
    if len(reported) > 1 and len(comparisons) != 1:
        parts.append(
            markup.paragraph(
                "Sessions on different organs, or whose organ at the start was not recorded, are "
                "not put side by side: their figures mean different things.",
                "note",
            )
        )
    parts += [_session(one, settings, f"s{place}", draw) for place, one in enumerate(reported)]
    return markup.document(title, *parts, _meaning(bool(comparisons)))


def _what(reported: Sequence[Reported], settings: Settings, command: str) -> str:
    origin = made(command)
    rows = [
        (
            one.session.name, one.entry.role or NONE,
            f"{one.session.organ or 'unknown organ'}, {one.session.nodes:,} nodes",
            ", ".join(one.session.models) or NONE, one.session.bag, number(one.session.seconds),
            number(one.session.rate_hz),
        )
        for one in reported
    ]  # fmt: skip
    notes = [f"{one.session.name}: {note}" for one in reported for note in one.session.notes]
    values = {
        "idle speed": f"{1e3 * settings.idle_speed:g} mm/s",
        "hands": "; ".join(f"{hand}: {', '.join(of)}" for hand, of in settings.hands.items())
        or "each tool that was moved",
        "plan": ", ".join(plan.name for plan in settings.plans) or "none",
        "made": origin["at"],
        "versions": f"tissue_sim {origin['git_revision'] or 'without git'}",
        "command": command,
    }
    return (
        markup.heading(2, "What was recorded")
        + markup.table(
            ("session", "role", "organ", "model", "bag", "length [s]", "frames/s"), rows, words=5
        )
        + markup.facts(values)
        + (markup.listing(notes) if notes else "")
    )


def _comparison(one: Comparison, reported: Sequence[Reported]) -> str:
    chosen = [reported[place] for place in one.places]
    reasons: list[str] = []
    tables = []
    for group, rows in grouped([of.figures for of in chosen]).items():
        cells = []
        for _, figures in rows:
            known = next(figure for figure in figures if figure is not None)
            values = [_short(figure, reasons) for figure in figures]
            cells.append((with_unit(known.label, known.unit), *values))
        heads = (group, *(_headed(of) for of in chosen))
        tables.append(markup.table(heads, cells))
    parts = [
        markup.heading(2, f"Side by side: {chosen[0].session.organ}"),
        markup.gallery(tables) if len(chosen) <= NARROW else "".join(tables),
        markup.listing(reasons) if reasons else "",
        _known(one.groups),
        _repeated("Test and retest", one.retest, "it needs at least two persons with two sessions "
                  "each (BAG@PERSON:SESSION, or a study file)"),
        _repeated("Raters", one.raters, "it needs scores of at least two sessions by at least two "
                  "raters (a study file with ratings)"),
    ]  # fmt: skip
    return "".join(parts)


def _headed(one: Reported) -> str:
    role = f" ({one.entry.role})" if one.entry.role else ""
    return one.session.name + role


def _short(figure: Figure | None, reasons: list[str]) -> str:
    """A value, or the number of the reason why there is none."""
    if figure is None:
        return NONE
    if not figure.why:
        return shown(figure.value, figure.unit)
    reason = f"{figure.group}: {figure.why}"
    marked = [said for said in reasons if said.partition(" ")[2] == reason]
    if not marked:
        reasons.append(f"({len(reasons) + 1}) {reason}")
        marked = reasons[-1:]
    return f"{NONE} {marked[0].partition(' ')[0]}"


def _known(groups: Sequence[Groups]) -> str:
    title = markup.heading(3, "Known groups: experts and trainees")
    if not groups:
        return title + markup.paragraph(
            "Not computed: it needs sessions of at least two experts (--expert) and two trainees."
        )
    rows = [
        (
            with_unit(row.label, row.unit), shown(row.experts, row.unit),
            shown(row.trainees, row.unit), f"{row.expert_count}", f"{row.trainee_count}",
            number(row.delta),
        )
        for row in groups
    ]  # fmt: skip
    heads = ("figure", "experts", "trainees", "experts", "trainees", "Cliff's delta")
    return title + markup.table(
        heads, rows, caption="Medians of persons, number of persons, and how far groups lie apart."
    )


def _repeated(title: str, rows: Sequence[Repeated], needs: str) -> str:
    head = markup.heading(3, title)
    if not rows:
        return head + markup.paragraph(f"Not computed: {needs}.")
    cells = [
        (
            with_unit(row.label, row.unit), f"{row.targets}", number(row.correlation),
            number(row.agree.value), _range(row.agree), number(row.consistent.value),
            shown(row.error, row.unit),
            NONE if row.limits is None else shown(row.limits.bias, row.unit),
            NONE if row.limits is None
            else f"{shown(row.limits.low, row.unit)} to {shown(row.limits.high, row.unit)}",
            number(row.kappa),
        )
        for row in rows
    ]  # fmt: skip
    return head + markup.table(("score", *VALUE_COLUMNS), cells)


def _range(of: Intraclass) -> str:
    return f"{number(of.low)} to {number(of.high)}" if of.low == of.low else NONE


def _session(one: Reported, settings: Settings, prefix: str, draw: Draw) -> str:
    session = one.session
    drawings = [
        (plots.timeline(session), "When tools were pressed (bars), and what happened (marks; what "
         "it is, under the mouse).", "timeline"),
        (plots.speeds(session, settings), "Speed of the tips. Dashed: idle below.", "speeds"),
        (plots.forces(session), "Force of the tissue on the tools.", "forces"),
        (plots.stress(session), _stress_words(session), "stress"),
        (plots.closure(session), "Share of each named hole that is covered.", "closure"),
        (plots.ways(session, settings), "Ways of the tips; black: lines of the cuts at rest; "
         "dashed: the plan. Turn it with the mouse. It needs WebGL.", "ways"),
    ]  # fmt: skip
    shown_plots = [
        markup.plot(plot, caption, f"{prefix}-{name}")
        for plot, caption, name in drawings
        if plot is not None
    ]
    drawn, message = draw(session)
    pictures = [markup.image(data_uri(png), caption) for png, caption in drawn]
    return "".join(
        [
            markup.heading(2, f"Session: {session.name}"),
            shown_plots[0],
            markup.gallery(pictures) if pictures else markup.paragraph(message, "note"),
            *shown_plots[1:],
            *_tables(one),
            _events(session),
        ]
    )


def _stress_words(session: Session) -> str:
    if isinstance(session.stress, Missing):
        return ""
    return f"Largest value at a node; {session.stress.source}. Shaded: warnings of risk regions."


def _tables(one: Reported) -> list[str]:
    tables = []
    for group, rows in grouped([one.figures]).items():
        figures = [figure for _, (figure,) in rows if figure is not None]
        cells = [(with_unit(f.label, f.unit), cell(f)) for f in figures]
        tables.append(markup.table((group, ""), cells))
    figures_of_all = markup.heading(3, "Figures") + markup.gallery(tables)
    return [figures_of_all, _cuts(one), _violations(one.session)]


def _cuts(one: Reported) -> str:
    cuts = one.session.cuts
    if isinstance(cuts, Missing) or not cuts:
        return ""
    rows = []
    for cut, apart in zip(cuts, one.deviations, strict=True):
        surface = cut.surface
        lengths = (surface.length, surface.mean_depth, surface.depth)
        away = (None,) * 3 if apart is None else (apart.rms, apart.largest, apart.missed)
        rows.append(
            (
                f"{cut.kind}{', undone' if cut.undone else ''}", cut.tool or "a service",
                "" if apart is None else apart.plan, number(cut.begin),
                f"{cut.edits}", *(shown(length, "m") for length in lengths),
                *(NONE if far is None else shown(far, "m") for far in away),
            )
        )  # fmt: skip
    heads = (
        "cut", "by", "plan", "begin [s]", "edits", "length [mm]", "mean depth [mm]", "depth [mm]",
        "RMS [mm]", "largest [mm]", "missed [mm]",
    )  # fmt: skip
    caption = "Each cut; the last three: deviation from the plan, and what of it was not cut."
    return markup.heading(3, "Cuts") + markup.table(heads, rows, words=3, caption=caption)


def _violations(session: Session) -> str:
    found = session.violations
    if isinstance(found, Missing) or not found:
        return ""
    units = {"near": "m", "stress": "Pa"}
    rows = [
        (
            one.region, one.what, one.tool or NONE, number(one.begin), number(one.end - one.begin),
            with_unit(shown(one.worst, units.get(one.what, "")), units.get(one.what, "")),
        )
        for one in found
    ]  # fmt: skip
    heads = ("region", "what", "tool", "begin [s]", "length [s]", "worst")
    return markup.heading(3, "Warnings of risk regions") + markup.table(heads, rows, words=3)


def _events(session: Session) -> str:
    rows = [(event.kind, event.text, number(event.time)) for event in session.events]
    body = markup.table(("event", "", "time [s]"), rows, words=2)
    return markup.folded(f"All {len(rows)} events", body) if rows else ""


def _meaning(compared: bool) -> str:
    return "".join(
        [
            markup.heading(2, "What the figures mean"),
            markup.listing(MEANING),
            markup.listing(RELIABILITY) if compared else "",
            markup.heading(2, "What they validate, and what they do not"),
            markup.table(("validity", "what it asks", "what this page adds"), VALIDITY, words=3),
            markup.listing(LIMITS),
        ]
    )
