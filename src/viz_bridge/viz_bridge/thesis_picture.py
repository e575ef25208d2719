"""The thesis' table as a picture: our ranges, and its figures as marks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

OURS, MEDIAN, THESIS = "#9dbbe0", "#2f6fc4", "#c43c2f"


def draw_ranges(result: dict[str, Any], picture: Path) -> None:
    """Draw the range of every row that was fitted or brought to rest.

    Args:
        result: What `tissue thesis` writes.
        picture: PNG file to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = [row for row in result["rows"] if row["relative_range"]]
    rows = [row for row in shown if row["relative_range"][0] < 1.0]
    figure = Figure(figsize=(8.0, 0.42 * len(rows) + 1.3), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for place, row in enumerate(rows):
        low, high = row["relative_range"]
        axis.barh(place, high - low, left=low, height=0.5, color=OURS)
        axis.plot([row["relative_to_worst"]], [place], "|", markersize=14, color=MEDIAN)
        if row["thesis_relative_to_worst"] is not None:
            axis.plot([row["thesis_relative_to_worst"]], [place], "D", markersize=6, color=THESIS)
    axis.set_yticks(range(len(rows)), [row["row"] for row in rows])
    axis.invert_yaxis()
    axis.set_xlim(left=0.0)
    axis.set_xlabel("mean difference from exact finite elements, of the worst")
    axis.grid(axis="x", alpha=0.3)
    axis.barh([0], [0], color=OURS, label="ours, all pulls")
    axis.plot([], [], "|", markersize=14, color=MEDIAN, label="ours, median")
    axis.plot([], [], "D", markersize=6, color=THESIS, linestyle="none", label="thesis")
    figure.legend(loc="outside upper right", ncols=3, fontsize=8, frameon=False)
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
