"""Distances between two models as colours, and the bar that tells what a colour means."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viz_bridge.picture_grid import COLORS

UNKNOWN = (140, 146, 156)
"""Red, green, blue of a node that the reference knows nothing of."""

LEAST_TOP = 1e-6
"""Top of the scale where models agree [m]: rounding of positions stays without colour."""

PAPER, INK = "#181b21", "#dbe3ec"


def scale_top(distance: float) -> float:
    """The end of a colour scale: the next of 1, 2 and 5 times a power of ten [m].

    Args:
        distance: What should be on the scale [m].
    """
    if not distance > LEAST_TOP:
        return LEAST_TOP
    power = 10.0 ** math.floor(math.log10(distance))
    for factor in (1.0, 2.0, 5.0):
        if distance <= factor * power * (1 + 1e-6):
            return factor * power
    return 10.0 * power


def difference_colors(distance: NDArray[np.floating], top: float) -> NDArray[np.uint8]:
    """Red, green, blue of each distance, shape (n, 3).

    Args:
        distance: Distances [m], shape (n,); nan: unknown.
        top: Distance at the end of the scale [m]; larger ones have its colour.
    """
    known = np.isfinite(distance)
    steps = map_colors()
    place = np.clip(np.where(known, distance, 0.0) / top, 0.0, 1.0) * (len(steps) - 1)
    colors = steps[np.rint(place).astype(np.intp)]
    colors[~known] = UNKNOWN
    return colors


@lru_cache(maxsize=4)
def map_colors(name: str = COLORS, count: int = 256) -> NDArray[np.uint8]:
    """Colours spread evenly over one of matplotlib's maps, shape (count, 3).

    Args:
        name: The map; default that of the project's pictures.
        count: How many.
    """
    import matplotlib

    colors: NDArray[np.uint8] = matplotlib.colormaps[name](
        np.linspace(0.0, 1.0, count), bytes=True
    )[:, :3].copy()
    return colors


@lru_cache(maxsize=4)
def color_bar(top: float, title: str = "difference [mm]") -> NDArray[np.uint8]:
    """A picture of the scale in millimetres, shape (height, width, 3).

    Args:
        top: Distance at its end [m].
        title: What is written above it.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2, 1.0), dpi=120, facecolor=PAPER)
    canvas: Any = FigureCanvasAgg(figure)
    axis = figure.add_axes((0.06, 0.42, 0.88, 0.24))
    bar = figure.colorbar(
        ScalarMappable(Normalize(0.0, 1e3 * top), COLORS), cax=axis, orientation="horizontal"
    )
    bar.set_ticks(np.linspace(0.0, 1e3 * top, 6).tolist())
    bar.ax.xaxis.set_major_formatter("{x:.4g}")
    bar.ax.tick_params(colors=INK, labelsize=9)
    bar.outline.set_edgecolor(INK)
    axis.set_title(title, color=INK, fontsize=10)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
