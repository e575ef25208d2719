"""The plots of a fit."""

from __future__ import annotations

from itertools import combinations, islice

import numpy as np
import plotly.graph_objects as go

from tissue_sim.compare.fit.landscape import Landscape
from tissue_sim.compare.fit.outcome import FitOutcome
from tissue_sim.compare.fit.pareto import SpeedFront
from tissue_sim.compare.fit.problem import Evaluation
from tissue_sim.compare.fit.space import FitParameter
from tissue_sim.compare.report.figures import COLORS, INK, blank

SCALE = "Viridis"
LOST = "#c9d0d8"
MOST_PAIRS = 6
"""Pairs of values whose candidates are drawn."""

LEAST = 1e-9
"""Smallest error that is drawn: single precision does not see less."""


def over_generations(outcome: FitOutcome) -> go.Figure:
    """Smallest error so far and median of each generation."""
    history = outcome.found.history
    numbers = [generation.number for generation in history]
    plot = blank("generation", "error relative to the worst")
    for name, errors, color in (
        ("best so far", [generation.best for generation in history], COLORS[0]),
        ("median of the generation", [generation.median for generation in history], COLORS[1]),
    ):
        plot.add_scatter(
            x=numbers, y=np.maximum(errors, LEAST), name=name, mode="lines+markers",
            line={"color": color, "width": 2}, marker={"size": 5},
        )  # fmt: skip
    plot.update_yaxes(type="log", exponentformat="power")
    return plot


def candidates(outcome: FitOutcome) -> list[go.Figure]:
    """All candidates over pairs of values; over the one there is with their error."""
    parameters = outcome.problem.space.parameters
    if len(parameters) == 1:
        return [_over_one(outcome, parameters[0])]
    return [
        _over_two(outcome, first, second)
        for first, second in islice(combinations(parameters, 2), MOST_PAIRS)
    ]


def speed(front: SpeedFront, tolerance: float) -> go.Figure:
    """Smallest error at each number of steps a frame; filled: the Pareto front."""
    plot = blank("steps a frame", "error relative to the worst", height=320)
    chosen = front.front
    plot.add_scatter(
        x=[point.steps for point in chosen], y=[point.best.error for point in chosen],
        name="Pareto front", mode="lines+markers", marker={"size": 11, "color": COLORS[0]},
        line={"color": COLORS[0], "shape": "hv", "width": 1},
    )  # fmt: skip
    rest = [point for point in front.points if point not in chosen]
    if rest:
        plot.add_scatter(
            x=[point.steps for point in rest], y=[point.best.error for point in rest],
            name="not on it", mode="markers",
            marker={"size": 10, "color": COLORS[0], "symbol": "circle-open"},
        )  # fmt: skip
    plot.add_hline(y=tolerance, line={"color": "#8a939e", "dash": "dash"})
    plot.update_xaxes(type="log", tickvals=[point.steps for point in front.points])
    return plot


def landscape(outcome: FitOutcome) -> go.Figure:
    """The error over two values; where the model is unstable there is nothing."""
    grid = outcome.grid
    assert grid is not None
    plot = blank(grid.first.name, grid.second.name, height=480)
    errors = np.where(grid.stable, np.log10(np.maximum(grid.error, LEAST)), np.nan)
    words = np.vectorize("{:.3g}".format)(grid.error)
    plot.add_heatmap(
        x=grid.first_values, y=grid.second_values, z=errors.T, customdata=words.T,
        colorscale=SCALE, colorbar=_powers(errors),
        hovertemplate="%{x:.4g}, %{y:.4g}: %{customdata}<extra></extra>",
    )  # fmt: skip
    _mark(plot, outcome, grid.first, grid.second, "#fff")
    _scale(plot, grid.first, grid.second)
    _keep_inside(plot, grid)
    return plot


def _over_one(outcome: FitOutcome, parameter: FitParameter) -> go.Figure:
    plot = blank(parameter.name, "error relative to the worst")
    for stable in (False, True):
        shown = [each for each in outcome.found.evaluations if each.stable is stable]
        plot.add_scatter(
            x=[each.values[parameter.name] for each in shown],
            y=[max(each.error, LEAST) for each in shown], mode="markers",
            name="stable" if stable else "unstable", marker=_marker(stable),
        )  # fmt: skip
    plot.update_yaxes(type="log", exponentformat="power")
    if parameter.log:
        plot.update_xaxes(type="log")
    return plot


def _over_two(outcome: FitOutcome, first: FitParameter, second: FitParameter) -> go.Figure:
    plot = blank(first.name, second.name, height=480)
    for stable in (False, True):
        # The best are drawn last, on top.
        shown = sorted(
            (each for each in outcome.found.evaluations if each.stable is stable),
            key=lambda each: -each.error,
        )
        if not shown:
            continue
        marker = _marker(stable)
        if stable:
            logs = np.log10([max(each.error, LEAST) for each in shown])
            marker |= {"color": logs, "colorscale": SCALE, "colorbar": _powers(logs)}
        plot.add_scatter(
            x=[each.values[first.name] for each in shown],
            y=[each.values[second.name] for each in shown], mode="markers",
            name="stable" if stable else "unstable", marker=marker, showlegend=False,
            text=[_words(each) for each in shown], hoverinfo="text",
        )  # fmt: skip
    _mark(plot, outcome, first, second, INK)
    _scale(plot, first, second)
    return plot


def _marker(stable: bool) -> dict[str, object]:
    if stable:
        return {"size": 7, "color": COLORS[0]}
    return {"size": 5, "color": LOST, "symbol": "x-thin", "line": {"width": 1, "color": LOST}}


def _words(evaluation: Evaluation) -> str:
    values = ", ".join(f"{name} {value:.4g}" for name, value in evaluation.values.items())
    return f"{evaluation.error:.3g}: {values}" + (
        f" ({evaluation.reason})" if evaluation.reason else ""
    )


def _mark(
    plot: go.Figure, outcome: FitOutcome, first: FitParameter, second: FitParameter, color: str
) -> None:
    """Put a ring around the best values."""
    values = outcome.found.best.values
    plot.add_scatter(
        x=[values[first.name]], y=[values[second.name]], mode="markers", showlegend=False,
        marker={"size": 16, "symbol": "circle-open", "color": color, "line": {"width": 2}},
        hovertemplate="best<extra></extra>",
    )  # fmt: skip


def _scale(plot: go.Figure, first: FitParameter, second: FitParameter) -> None:
    if first.log:
        plot.update_xaxes(type="log")
    if second.log:
        plot.update_yaxes(type="log")


def _keep_inside(plot: go.Figure, grid: Landscape) -> None:
    """Let the axes end with the grid."""
    for update, parameter in ((plot.update_xaxes, grid.first), (plot.update_yaxes, grid.second)):
        ends = (parameter.low, parameter.high)
        update(range=list(np.log10(ends)) if parameter.log else list(ends))


def _powers(logs: np.ndarray) -> dict[str, object]:
    """A colour bar of logarithms with the errors themselves beside it."""
    known = logs[np.isfinite(logs)]
    if not len(known):
        return {"title": "error"}
    ticks = np.linspace(known.min(), known.max(), 6)
    return {
        "title": "error",
        "tickvals": ticks,
        "ticktext": [f"{10.0**tick:.2g}" for tick in ticks],
    }
