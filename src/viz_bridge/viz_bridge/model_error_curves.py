"""Curves of every model's error against what a frame may cost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tissue_sim.compare.models.table import FIRST, SECOND, standings
from tissue_sim.compare.models.trial import Row

COLORS = {
    "finite_element": "#1f2933", "vertex_block_descent": "#2f6fc4", "quasi_static": "#c43c2f",
    "lr": "#e08a1e", "relaxation": "#8c6bb1", "spring_mass": "#3b9a57",
    "chain_mail": "#a0714f", "voxel_chain_mail": "#d5a06b",
}  # fmt: skip
STYLES = ("-", "--", ":", "-.")
"""Of the variants of a model, in the order in which they appear."""

TITLES = {
    FIRST: "from linear finite elements in equilibrium",
    SECOND: "from corotated finite elements in equilibrium",
}
LEAST = 1e-3
"""Errors below are drawn here."""


def draw_model_errors(result: dict[str, Any], picture: Path) -> None:
    """Draw the mean error over all interactions against the time a frame.

    Args:
        result: What `compare.models.study.run` gave.
        picture: PNG file to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter, NullLocator

    rows = [Row.of(values) for values in result["rows"]]
    organs = [name for name in result["organs"] if any(row.organ == name for row in rows)]
    labels = list(dict.fromkeys(row.label for row in rows))
    figure = Figure(figsize=(5.6 * len(organs) + 3.2, 9.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(organs), squeeze=False)
    budgets = sorted({row.budget_ms for row in rows})
    for line, reference in enumerate((FIRST, SECOND)):
        for column, organ in enumerate(organs):
            axis = axes[line, column]
            for label, style in _styles(rows, labels):
                curve = _curve(rows, organ, label, reference, budgets)
                axis.plot(budgets, curve, marker="o", markersize=3.5, label=label, **style)
            axis.set_xscale("log")
            axis.set_yscale("log")
            axis.set_ylim(LEAST, 2.0)
            axis.set_xticks(budgets, [f"{budget:g}" for budget in budgets])
            axis.xaxis.set_minor_locator(NullLocator())
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.grid(alpha=0.3)
            axis.set_title(f"{organ}: {TITLES[reference]}", fontsize=10)
            axis.set_xlabel("time a frame [ms]")
        axes[line, 0].set_ylabel("mean distance / that of tissue that does not follow")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside right upper", fontsize=8)
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def _styles(rows: list[Row], labels: list[str]) -> list[tuple[str, dict[str, Any]]]:
    """How each variant is drawn: the colour is the model's."""
    model_of = {row.label: row.model for row in rows}
    before: dict[str, int] = {}
    styles = []
    for label in labels:
        model = model_of[label]
        number = before[model] = before.get(model, -1) + 1
        style = {"color": COLORS.get(model, "#5b6673"), "linestyle": STYLES[number % len(STYLES)]}
        styles.append((label, style))
    return styles


def _curve(
    rows: list[Row], organ: str, label: str, reference: str, budgets: list[float]
) -> list[float]:
    curve = []
    for budget in budgets:
        found = [each for each in standings(rows, organ, budget) if each.label == label]
        curve.append(max(found[0].relative(reference), LEAST) if found else float("nan"))
    return curve
