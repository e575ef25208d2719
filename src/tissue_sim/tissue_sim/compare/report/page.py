"""The report of comparisons: one HTML page that needs nothing else and no network."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tissue_sim.compare.comparison import Comparison
from tissue_sim.compare.report import figures, markup, pictures
from tissue_sim.compare.report.meaning import CITING, LIMITS, MEANING
from tissue_sim.compare.report.result import made, organ_document, subject_document
from tissue_sim.compare.report.text import (
    cells,
    lost_words,
    notes,
    reference_words,
    share,
    summary_rows,
)
from tissue_sim.whole_files import write_text

COLUMNS = (
    "target", "effort a frame", "mean [mm]", "of the worst", "95th percentile [mm]", "largest [mm]",
    "volume error", "ms a frame", "steps a frame",
)  # fmt: skip

PICTURES = (
    "Each target beside the reference when they are farthest apart (mean over the nodes), and at "
    "the end; one moment where that is the same. Colour: distance of each node, on one scale in "
    "all pictures of this interaction, with its last colour for all that is more. Black: held "
    "nodes."
)

Draw = Callable[[Comparison], pictures.Pictures]


def write_page(
    path: Path,
    comparisons: Comparison | Sequence[Comparison],
    command: str = "",
    draw: Draw = pictures.draw,
) -> None:
    """Write the report of one comparison, or of several with the same organ and targets.

    Args:
        path: HTML file to write.
        comparisons: One for each interaction.
        command: The command that made them, as a person would type it again.
        draw: What draws the pictures.
    """
    several = (comparisons,) if isinstance(comparisons, Comparison) else tuple(comparisons)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, page(several, command, draw))


def page(comparisons: Sequence[Comparison], command: str = "", draw: Draw = pictures.draw) -> str:
    """The report; see `write_page`."""
    first = comparisons[0]
    names = ", ".join(comparison.interaction.name for comparison in comparisons)
    title = f"Elastic models compared: {first.organ.name}, {names}"
    parts = [
        markup.heading(1, title),
        markup.paragraph(
            f"{len(first.targets)} models beside {reference_words(first)} under the same "
            "recorded interaction, over time.",
            "lead",
        ),
        _what(comparisons, command),
    ]
    if len(comparisons) > 1:
        parts.append(_summary(comparisons))
    for number, comparison in enumerate(comparisons):
        parts.append(_section(comparison, f"c{number}", draw))
    return markup.document(title, *parts, _subjects(first), _meaning())


def _what(comparisons: Sequence[Comparison], command: str) -> str:
    first, origin = comparisons[0], made(command)
    organ = organ_document(first.organ)
    material = organ["material"]
    versions = ", ".join(f"{name} {value}" for name, value in origin["versions"].items() if value)
    values = {
        "organ": f"{organ['name']}: {organ['nodes']:,} nodes ({organ['fixed_nodes']:,} fixed), "
        f"{organ['elements']:,} {organ['kind']}, {1e3 * organ['size_m']:.3g} mm across; "
        f"digest {organ['digest']}",
        "material": f"E = {material['young_modulus']:g} Pa, nu = {material['poisson_ratio']:g}, "
        f"{material['density']:g} kg/m³"
        + (f"; regions {', '.join(material['regions'])}" if material["regions"] else ""),
        "reference": reference_words(first),
        "made": origin["at"],
        "machine": f"{origin['processor']}, {origin['cores']} cores, {origin['system']}",
        "versions": f"tissue_sim {origin['git_revision'] or 'without git'}, {versions}",
        "command": command,
    }
    rows = [_interaction_cells(comparison) for comparison in comparisons]
    return (
        markup.heading(2, "What was compared")
        + markup.facts(values)
        + markup.table(
            ("interaction", "held nodes", "amplitude [mm]", "length [s]", "frames", "frames/s"),
            rows,
        )
    )


def _interaction_cells(comparison: Comparison) -> list[str]:
    done = comparison.interaction
    return [
        done.name, f"{len(done.nodes)}", f"{1e3 * done.amplitude:.3g}", f"{done.seconds:.3g}",
        f"{done.frames}", f"{done.rate_hz:g}",
    ]  # fmt: skip


def _summary(comparisons: Sequence[Comparison]) -> str:
    names = [comparison.interaction.name for comparison in comparisons]
    rows = [
        (name, share(sum(shares) / len(shares)), *(share(value) for value in shares))
        for name, shares in summary_rows(comparisons)
    ]
    return (
        markup.heading(2, "All interactions")
        + markup.table(
            ("target", "mean", *names), rows, caption="Mean difference relative to the worst."
        )
        + markup.plot(
            figures.summary_bars(comparisons), "The same for each interaction.", "summary"
        )
    )


def _section(comparison: Comparison, prefix: str, draw: Draw) -> str:
    ranking = comparison.ranking
    lost = [not target.trajectory.is_stable for target in ranking]
    rows = [
        (target.subject.name, str(target.subject.effort).removesuffix(" a frame"), *cells(target))
        for target in ranking
    ]
    drawings = [
        (figures.over_time(comparison), "Mean over the nodes of the distance from the reference in "
         "each frame; the bands reach up to the 95th percentile of the nodes. Shaded: something "
         "is held, where that is not all of the time.", "difference"),
        (figures.relative_bars(comparison), "Mean difference over that of tissue that does not "
         "follow at all.", "relative"),
        (figures.volume_over_time(comparison), "Volume of the target over that of the reference, "
         "less one.", "volume"),
        (figures.error_against_cost(comparison), "Mean difference relative to the worst against "
         "the time that the steps of a frame took, median.", "price"),
        (figures.steps_over_time(comparison), "Steps of the model in each frame.", "steps"),
        (figures.cost_over_time(comparison), "Time of the steps of each frame.", "cost"),
    ]  # fmt: skip
    return "".join(
        [
            markup.heading(2, f"Interaction: {comparison.interaction.name}"),
            markup.heading(3, "Ranking"),
            markup.table(COLUMNS, rows, words=2, lost=lost),
            markup.listing(notes(comparison)),
            *(
                markup.plot(drawn, caption, f"{prefix}-{name}")
                for drawn, caption, name in drawings
                if drawn is not None
            ),
            _maps(comparison, prefix, draw),
        ]
    )


def _maps(comparison: Comparison, prefix: str, draw: Draw) -> str:
    drawn = draw(comparison)
    parts = [markup.heading(3, "Where they differ")]
    parts.append(
        markup.paragraph(drawn.message, "note") if drawn.message else markup.paragraph(PICTURES)
    )
    for target, png in zip(comparison.ranking, drawn.png, strict=False):
        words = target.subject.name if target.trajectory.is_stable else lost_words(target)
        parts.append(markup.image(pictures.data_uri(png), words))
    parts.append(
        markup.plot(
            figures.node_map(comparison),
            "Mean over the frames of each node's distance, on the reference in the frame in which "
            "it is farthest from rest. Turn it with the mouse; the menu chooses the target. It "
            "needs WebGL.",
            f"{prefix}-map",
        )
    )
    return "".join(parts)


def _subjects(comparison: Comparison) -> str:
    subjects = [target.subject for target in comparison.targets]
    if comparison.reference_subject is not None:
        subjects.insert(0, comparison.reference_subject)
    rows = [_subject_cells(subject_document(subject)) for subject in subjects]
    return markup.heading(2, "Models and parameters") + markup.table(
        ("name", "model", "set", "all parameters", "effort"), rows, words=5
    )


def _subject_cells(document: dict[str, Any]) -> list[str]:
    def listed(values: dict[str, float]) -> str:
        return ", ".join(f"{name} = {value:g}" for name, value in values.items())

    return [
        document["label"], document["model"], listed(document["values"]) or "defaults",
        listed(document["parameters"]), document["effort"],
    ]  # fmt: skip


def _meaning() -> str:
    return "".join(
        [
            markup.heading(2, "What the figures mean"),
            markup.listing(MEANING),
            markup.heading(2, "What they do not say"),
            markup.listing(LIMITS),
            markup.heading(2, "Citing this page"),
            markup.paragraph(CITING),
        ]
    )
