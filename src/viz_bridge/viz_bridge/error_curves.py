"""Curves of how fast sweeps converge."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tissue_sim.acceleration_study import GEOMETRIES, MODELS, Row
from tissue_sim.prediction_study import AHEAD, FrameRow

COLORS = {"none": "#5b6673", "momentum": "#c43c2f", "chebyshev": "#2f6fc4"}
STYLES = (":", "-", "--")
PREDICTOR_COLORS = ("#5b6673", "#8fce9f", "#3b9a57", "#c43c2f")
LEAST = 1e-4


def draw_curves(result: dict[str, Any], picture: Path) -> None:
    """Draw errors over time: sweeps with accelerations above, frames with predictors below.

    Args:
        result: What `acceleration_study.run` gave.
        picture: PNG file to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    geometries = [g for g in GEOMETRIES if any(row["geometry"] == g for row in result["sweeps"])]
    columns = [(geometry, model) for geometry in geometries for model in MODELS]
    figure = Figure(figsize=(3.4 * len(columns), 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(columns), squeeze=False)
    frames = [FrameRow(**values) for values in result["frames"]]
    for place, (geometry, model) in enumerate(columns):
        above, below = axes[0, place], axes[1, place]
        for row in (Row(**values) for values in result["sweeps"]):
            if (row.geometry, row.model) == (geometry, model):
                _draw_row(above, row)
        _draw_frames(
            below, [row for row in frames if (row.geometry, row.model) == (geometry, model)]
        )
        above.set_title(f"{geometry}: {model}", fontsize=10)
        above.set_xlabel("processor time since the pull [ms]")
        below.set_xlabel("processor time of a frame [ms]")
        below.set_xscale("log")
        below.xaxis.set_minor_formatter(NullFormatter())
        for axis in (above, below):
            axis.set_yscale("log")
            axis.grid(alpha=0.3)
        above.set_ylim(LEAST, 2.0)
        below.set_ylim(2e-3, 2.0)
    axes[0, 0].set_ylabel("error of a pull in one jump")
    axes[1, 0].set_ylabel("error at the end of a pull of half a second")
    for axis in axes[:, -1]:
        axis.legend(fontsize=7, loc="lower left")
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def _draw_frames(axis: Any, frames: list[FrameRow]) -> None:
    for (predictor, steps), color in zip(AHEAD, PREDICTOR_COLORS, strict=True):
        rows = [row for row in frames if (row.predictor, row.predictor_steps) == (predictor, steps)]
        label = f"{predictor}, {steps} steps" if predictor else "no predictor"
        axis.plot(
            [row.ms for row in rows], [row.moving for row in rows], "o-", markersize=4,
            color=color, label=label,
        )  # fmt: skip


def _draw_row(axis: Any, row: Row) -> None:
    kind = next(iter(row.parameters), "none")
    style = STYLES[sum(value > row.parameters.get(kind, 0.0) for value in _values(kind))]
    errors = np.clip(row.errors, LEAST / 10, None)
    milliseconds = row.ms * np.arange(1, len(errors) + 1)
    axis.plot(milliseconds, errors, style, color=COLORS[kind], linewidth=1.3, label=row.label)


def _values(kind: str) -> tuple[float, ...]:
    from tissue_sim.acceleration_study import VARIANTS

    return tuple(variant[kind] for variant in VARIANTS if kind in variant)
