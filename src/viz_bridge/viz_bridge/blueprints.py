"""How rerun's viewer lays out what is drawn of a session."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

BACKGROUND = (24, 27, 33)


def scene_view(
    name: str,
    contents: Sequence[str],
    eye: NDArray[np.floating],
    target: NDArray[np.floating],
    origin: str = "/",
) -> rrb.Spatial3DView:
    """A view of bodies, upright along z.

    Args:
        name: What people read above it.
        contents: Entities in it, as rerun writes them.
        eye: Where it is looked at from [m], shape (3,).
        target: Where to [m], shape (3,).
        origin: Whose place is its zero.
    """
    return rrb.Spatial3DView(
        origin=origin,
        contents=list(contents),
        name=name,
        background=rrb.Background(color=BACKGROUND),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)),
    )


def quiet_panels(*views: rrb.View | rrb.Container) -> rrb.Blueprint:
    """A layout in which only the time panel is to be seen, folded."""
    return rrb.Blueprint(
        *views,
        rrb.TimePanel(state="collapsed", timeline="sim_time"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def session_blueprint(
    positions: NDArray[np.float32],
    tips: Sequence[NDArray[np.float64]] = (),
    difference: bool = False,
) -> rrb.Blueprint:
    """A layout that shows the organ large, with events and forces beside it.

    Args:
        positions: Node positions when it starts [m], shape (node_count, 3).
        tips: Where the tools that grab are then [m]: the organ is looked at from their side.
        difference: Whether there is a second model, which then stands beside the organ.
    """
    low, high = positions.min(axis=0), positions.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    side = np.mean([tip - middle for tip in tips], axis=0) if len(tips) else np.zeros(3)
    if np.linalg.norm(side) < 0.05 * size:
        side = np.array([0.55, -0.75, 0.0])
    side = side / np.linalg.norm(side) + np.array([0.0, 0.0, 0.35])
    eye = middle + (1.2 if difference else 0.9) * size * side / np.linalg.norm(side)
    views = [
        scene_view("Organ", ["+ /organ/**", "+ /tools/**", "+ /forces/**"], eye, middle),
    ]  # fmt: skip
    curves = [
        rrb.TimeSeriesView(origin="/plots/force", name="Force on tools [N]"),
        rrb.TimeSeriesView(origin="/plots/closure", name="Holes: covered [%], gap [mm]"),
    ]
    beside: list[rrb.View | rrb.Container] = [rrb.TextLogView(origin="/events", name="Events")]
    if difference:
        second = ["+ /difference/**", "+ /tools/**"]
        views.append(scene_view("Second model: difference", second, eye, middle))
        curves.insert(0, rrb.TimeSeriesView(origin="/plots/difference", name="Difference [mm]"))
        beside.append(rrb.Spatial2DView(origin="/difference_legend", name="Colours"))
    beside.append(rrb.Tabs(*curves))
    rows = [3, 1, 3] if difference else [3, 2]
    column = rrb.Vertical(*beside, row_shares=rows)
    return quiet_panels(
        rrb.Horizontal(
            *views, column, column_shares=[2] * len(views) + [1] if difference else [4, 1]
        )
    )
