"""The report of a fit: one HTML page that needs nothing else and no network."""

from __future__ import annotations

from pathlib import Path

from tissue_sim.compare.fit import fit_figures, fit_text
from tissue_sim.compare.fit.outcome import FitOutcome
from tissue_sim.compare.fit.scene_lines import scene_lines
from tissue_sim.compare.report import markup
from tissue_sim.compare.report.result import made, organ_document
from tissue_sim.compare.report.text import figure
from tissue_sim.whole_files import write_text

VALLEY = (
    "Every candidate, coloured by its error; small crosses are those that were unstable, the ring "
    "is the best. Where good candidates lie along a line, values stand in for each other."
)


def write_report(path: Path, outcome: FitOutcome, command: str = "") -> None:
    """Write the report.

    Args:
        path: HTML file to write.
        outcome: What the fit came to.
        command: The command that made it, as a person would type it again.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, report(outcome, command))


def report(outcome: FitOutcome, command: str = "") -> str:
    """The report; see `write_report`."""
    problem = outcome.problem
    title = f"{problem.subject.name} fitted to {problem.cases[0].reference.label}"
    return markup.document(
        title, markup.heading(1, title),
        *(markup.paragraph(line, "lead") for line in fit_text.head_lines(outcome)[1:]),
        _best(outcome), _search(outcome), _speed(outcome), _landscape(outcome),
        _what(outcome, command),
    )  # fmt: skip


def _best(outcome: FitOutcome) -> str:
    rate_hz = outcome.problem.cases[0].interaction.rate_hz
    return "".join(
        [
            markup.heading(2, "Best values"),
            markup.table(("value", "best", "from", "to", ""), fit_text.value_rows(outcome)),
            markup.listing(fit_text.notes(outcome)),
            markup.facts(
                {
                    "for tissue compare": f"--target {outcome.subject.text}",
                    "in a scene": "; ".join(scene_lines(outcome.subject, rate_hz)),
                }
            ),
        ]
    )


def _search(outcome: FitOutcome) -> str:
    return "".join(
        [
            markup.heading(2, "Search"),
            markup.plot(
                fit_figures.over_generations(outcome),
                "Smallest error so far, and the median of each generation's candidates, relative "
                "to tissue that does not follow at all.",
                "generations",
            ),
            *(
                markup.plot(drawn, VALLEY, f"candidates-{number}")
                for number, drawn in enumerate(fit_figures.candidates(outcome))
            ),
        ]
    )


def _speed(outcome: FitOutcome) -> str:
    if outcome.front is None:
        return ""
    return "".join(
        [
            markup.heading(2, "Speed against error"),
            markup.table(
                ("steps a frame", "ms a frame", "of the worst", "on the front", "values"),
                fit_text.speed_rows(outcome),
            ),
            markup.paragraph(fit_text.good_enough(outcome)),
            markup.plot(
                fit_figures.speed(outcome.front, outcome.tolerance),
                "The best at each number of steps a frame; on the front (filled) nothing else is "
                "both as fast and as close. Dashed: good enough.",
                "speed",
            ),
        ]
    )


def _landscape(outcome: FitOutcome) -> str:
    if outcome.grid is None:
        return ""
    others = ", ".join(f"{name} {value:.4g}" for name, value in outcome.grid.others.items())
    return markup.heading(2, "Landscape") + markup.plot(
        fit_figures.landscape(outcome),
        "Error over two values, relative to tissue that does not follow at all; white: unstable. "
        + (f"The other values are the best: {others}." if others else "The ring is the best."),
        "landscape",
    )


def _what(outcome: FitOutcome, command: str) -> str:
    problem, origin = outcome.problem, made(command)
    organ = organ_document(problem.organ)
    versions = ", ".join(f"{name} {value}" for name, value in origin["versions"].items() if value)
    search = ", ".join(f"{name} {value}" for name, value in outcome.strategy.items() if value)
    values = {
        "organ": f"{organ['name']}: {organ['nodes']:,} nodes, {organ['elements']:,} "
        f"{organ['kind']}; digest {organ['digest']}",
        "target": problem.subject.text,
        "search": search,
        "made": origin["at"],
        "machine": f"{origin['processor']}, {origin['cores']} cores, {origin['system']}",
        "versions": f"tissue_sim {origin['git_revision'] or 'without git'}, {versions}",
        "command": command,
    }
    rows = [
        (
            case.interaction.name, case.reference.label, f"{len(case.interaction.nodes)}",
            figure(1e3 * case.interaction.amplitude), f"{case.interaction.frames}",
            figure(1e3 * case.worst),
        )
        for case in problem.cases
    ]  # fmt: skip
    return (
        markup.heading(2, "What was fitted")
        + markup.facts(values)
        + markup.table(
            ("interaction", "reference", "held nodes", "amplitude [mm]", "frames", "worst [mm]"),
            rows,
            words=2,
        )
    )
