"""The plots of a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from tissue_sim.compare.comparison import Comparison, Target
from tissue_sim.compare.report.text import summary_rows
from tissue_sim.geometry.surface import surface_triangles

COLORS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#332288", "#882255",
)  # fmt: skip
"""Colours of the targets, told apart by colour-blind people (Okabe and Ito; Tol)."""
DASHES = ("solid", "dash", "dot")
"""Styles of lines, taken in turn where there are more targets than colours."""
INK, GRID, HELD = "#1c2530", "#dde2e8", "rgba(28, 37, 48, 0.05)"
DIFFERENCE_SCALE = "YlOrRd"
"""Colour scale of differences, as in the pictures."""


def over_time(comparison: Comparison) -> go.Figure:
    """Mean difference in every frame, with a band up to the 95th percentile of the nodes."""
    times = _times(comparison)
    plot = blank("time [s]", "difference [mm]")
    _shade_holds(plot, comparison)
    for target in comparison.ranking:
        style, apart = _style(comparison, target), target.difference
        mean, p95 = 1e3 * apart.frame_mean, 1e3 * apart.frame_p95
        plot.add_scatter(
            x=np.concatenate([times, times[::-1]]), y=np.concatenate([mean, p95[::-1]]),
            fill="toself", fillcolor=style["color"], opacity=0.08, mode="lines",
            line={"color": style["color"], "width": 0.5}, showlegend=False,
            legendgroup=target.subject.name, hoverinfo="skip",
        )  # fmt: skip
        plot.add_scatter(
            x=times, y=mean, line=style, name=_name(target), legendgroup=target.subject.name
        )
    worst = 1e3 * comparison.worst.frame_mean
    plot.add_scatter(
        x=times, y=worst, name="nothing follows", line={"color": "#8a939e", "dash": "dashdot"}
    )
    return plot


def relative_bars(comparison: Comparison) -> go.Figure:
    """Mean difference of each target over that of tissue that does not follow at all."""
    ranking = comparison.ranking[::-1]
    plot = blank("difference relative to the worst", "", height=90 + 34 * len(ranking))
    values = [target.relative for target in ranking]
    plot.add_bar(
        x=values, y=[_name(target) for target in ranking], orientation="h",
        marker_color=[_style(comparison, target)["color"] for target in ranking],
        text=[f"{value:.3f}" for value in values], textposition="outside", cliponaxis=False,
        showlegend=False,
    )  # fmt: skip
    plot.update_layout(bargap=0.35)
    plot.update_xaxes(range=[0.0, 1.1 * max(1.0, *values)])
    plot.add_vline(x=1.0, line={"color": "#8a939e", "dash": "dashdot"})
    return plot


def volume_over_time(comparison: Comparison) -> go.Figure | None:
    """Volume of each target over that of the reference; None where there is no volume."""
    if all(np.isnan(target.difference.volume_error).all() for target in comparison.targets):
        return None
    plot = blank("time [s]", "volume error [%]", height=300)
    _shade_holds(plot, comparison)
    for target in comparison.ranking:
        errors = 100.0 * target.difference.volume_error
        plot.add_scatter(
            x=_times(comparison), y=errors, line=_style(comparison, target), name=_name(target)
        )
    return plot


def error_against_cost(comparison: Comparison) -> go.Figure:
    """Relative difference of each target over the time of its frames."""
    plot = blank("median time of a frame [ms]", "relative to the worst", height=300)
    for target in comparison.ranking:
        plot.add_scatter(
            x=[target.trajectory.ms_per_frame], y=[target.relative], mode="markers",
            marker={"size": 12, "color": _style(comparison, target)["color"]}, name=_name(target),
            hovertemplate="%{x:.3g} ms: %{y:.3f}",
        )  # fmt: skip
    plot.update_xaxes(type="log", dtick="D2")
    plot.update_yaxes(rangemode="tozero")
    return plot


def steps_over_time(comparison: Comparison) -> go.Figure:
    """Steps of every frame."""
    plot = blank("time [s]", "steps in a frame", height=300)
    for target in comparison.ranking:
        steps = target.trajectory.steps
        plot.add_scatter(
            x=_times(comparison), y=steps, name=_name(target),
            line={**_style(comparison, target), "shape": "hv", "width": 1},
        )  # fmt: skip
    most = [int(target.trajectory.steps.max(initial=0)) for target in comparison.targets]
    if max(most) > 20 * max(1, min(most)):
        plot.update_yaxes(type="log", dtick="D2")
    return plot


def cost_over_time(comparison: Comparison) -> go.Figure:
    """Time that the steps of every frame took on the machine that ran it."""
    plot = blank("time [s]", "time of a frame [ms]", height=300)
    for target in comparison.ranking:
        ms = 1e3 * target.trajectory.seconds
        plot.add_scatter(
            x=_times(comparison), y=np.where(ms > 0.0, ms, np.nan), line=_style(comparison, target),
            name=_name(target),
        )  # fmt: skip
    plot.update_yaxes(type="log", dtick="D2")
    return plot


def node_map(comparison: Comparison) -> go.Figure:
    """Mean difference of each node on the reference, farthest from rest; can be turned."""
    organ, reference = comparison.organ, comparison.reference
    frame = int(np.argmax(np.abs(reference.displacement).mean(axis=(1, 2))))
    triangles = surface_triangles(organ.mesh)
    nodes, corners = np.unique(triangles, return_inverse=True)
    i, j, k = corners.reshape(triangles.shape).astype(np.int32).T
    x, y, z = (1e3 * (organ.rest + reference.displacement[frame])[nodes]).astype(np.float32).T
    maps = [_millimetres(target.difference.node_mean[nodes]) for target in comparison.ranking]
    top = max((value for values in maps for value in values if value is not None), default=1.0)
    plot = blank("", "", height=560)
    plot.add_mesh3d(
        x=x, y=y, z=z, i=i, j=j, k=k, intensity=maps[0], colorscale=DIFFERENCE_SCALE, cmin=0.0,
        cmax=top or 1.0, colorbar={"title": "mean<br>difference<br>[mm]"}, flatshading=False,
        lighting={"ambient": 0.65, "diffuse": 0.5, "specular": 0.05},
    )  # fmt: skip
    hidden = {axis: {"visible": False} for axis in ("xaxis", "yaxis", "zaxis")}
    plot.update_layout(
        scene={**hidden, "aspectmode": "data", "bgcolor": "#f1f3f6"},
        margin={"l": 0, "r": 0, "t": 40, "b": 0},
        updatemenus=[
            {
                "x": 0.0, "y": 1.0, "xanchor": "left", "yanchor": "bottom", "direction": "down",
                "buttons": [
                    {"label": _name(target), "method": "restyle", "args": [{"intensity": [values]}]}
                    for target, values in zip(comparison.ranking, maps, strict=True)
                ],
            }
        ],
    )  # fmt: skip
    return plot


def summary_bars(comparisons: Sequence[Comparison]) -> go.Figure:
    """Relative difference of each target under each interaction."""
    targets = {target.subject.name: target for target in comparisons[0].targets}
    plot = blank("", "difference relative to the worst")
    for name, shares in summary_rows(comparisons):
        plot.add_bar(
            x=[one.interaction.name for one in comparisons], y=shares, name=name,
            marker_color=_style(comparisons[0], targets[name])["color"],
            hovertemplate="%{x}: %{y:.3f}",
        )  # fmt: skip
    plot.update_layout(barmode="group")
    return plot


def blank(x: str, y: str, height: int = 380) -> go.Figure:
    """A plot without data, with titles of its axes."""
    plot = go.Figure()
    plot.update_layout(
        template="plotly_white", height=height, font={"color": INK, "size": 13},
        margin={"l": 60, "r": 10, "t": 20, "b": 50}, hovermode="closest",
        legend={"orientation": "h", "y": -0.22, "x": 0.0},
    )  # fmt: skip
    plot.update_xaxes(title=x, gridcolor=GRID, zeroline=False, automargin=True)
    plot.update_yaxes(title=y, gridcolor=GRID, zeroline=False, automargin=True)
    return plot


def _shade_holds(plot: go.Figure, comparison: Comparison) -> None:
    """Shade the time during which something is held, where that is not all of it."""
    held = comparison.interaction.held.any(axis=1)
    if held.all():
        return
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(np.int8)))
    for begin, end in edges.reshape(-1, 2) / comparison.interaction.rate_hz:
        plot.add_vrect(x0=float(begin), x1=float(end), fillcolor=HELD, line_width=0, layer="below")


def _times(comparison: Comparison) -> NDArray[np.float64]:
    interaction = comparison.interaction
    times = np.arange(1, interaction.frames + 1, dtype=np.float64) / interaction.rate_hz
    return times


def _style(comparison: Comparison, target: Target) -> dict[str, Any]:
    """The same line for a target in all plots, whatever its rank."""
    number = [other.subject.name for other in comparison.targets].index(target.subject.name)
    dash = DASHES[number // len(COLORS) % len(DASHES)]
    return {"color": COLORS[number % len(COLORS)], "dash": dash, "width": 2}


def _name(target: Target) -> str:
    return target.subject.name + ("" if target.trajectory.is_stable else " (lost)")


def _millimetres(values: NDArray[np.float64]) -> list[float | None]:
    return [None if np.isnan(v) else float(f"{1e3 * v:.4g}") for v in values]
