"""The plots of a session."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from tissue_sim.compare.report.figures import COLORS, blank
from tissue_sim.readings.fields import in_words
from tissue_sim.report.motion import Reals, speeds_of
from tissue_sim.report.plan import PlannedLine
from tissue_sim.report.session import Missing, Session
from tissue_sim.report.summary import Settings, was_moved

MARKS = {
    "cut": ("x", "#d55e00"), "suture": ("star", "#0072b2"), "patch": ("square", "#009e73"),
    "undo": ("triangle-left", "#cc79a7"), "redo": ("triangle-right", "#cc79a7"),
    "pause": ("hourglass", "#8a939e"), "frozen": ("diamond", "#8a939e"),
    "warning": ("triangle-up", "#e69f00"), "label": ("line-ns", "#8a939e"),
}  # fmt: skip
"""Symbol and colour of each kind of event; others are small circles."""
REST = "events"
"""Row of the events that belong to no tool."""
MARGIN = 110
"""Left of plots over time, so that most names of tools have room [pixels]."""
MOST_POINTS = 4000
"""Points of a line in a page at most; more are thinned."""


def timeline(session: Session) -> go.Figure:
    """When each tool was pressed, and what happened."""
    tools = [tool for tool, track in session.tools.items() if was_moved(track)]
    rows = [REST, *reversed(tools)]
    plot = _over_time(session, "", height=150 + 42 * len(rows))
    for number, tool in enumerate(tools):
        pressed = session.tools[tool].pressed
        edges = np.flatnonzero(np.diff(np.concatenate([[0], pressed.astype(np.int8), [0]])))
        for begin, end in edges.reshape(-1, 2):
            plot.add_bar(
                x=[(end - begin) / session.rate_hz], y=[tool], base=[session.times[begin]],
                orientation="h", width=0.4, showlegend=False, name=tool,
                marker={"color": COLORS[number % len(COLORS)], "opacity": 0.75},
                hovertemplate=f"{tool} pressed, %{{x:.2f}} s<extra></extra>",
            )  # fmt: skip
    kinds = dict.fromkeys(e.kind for e in session.events if e.kind not in ("press", "release"))
    for kind in kinds:
        symbol, colour = MARKS.get(kind, ("circle", "#8a939e"))
        those = [event for event in session.events if event.kind == kind]
        plot.add_scatter(
            x=[event.time for event in those],
            y=[event.tool if event.tool in tools else REST for event in those],
            text=[event.text for event in those], mode="markers", name=kind,
            marker={"symbol": symbol, "size": 11, "color": colour, "line": {"width": 1.5,
                    "color": colour}},
            hovertemplate="%{x:.2f} s: %{text}<extra></extra>",
        )  # fmt: skip
    # Said, because a row that has no event yet would otherwise have no place.
    plot.update_yaxes(categoryorder="array", categoryarray=rows, range=[-0.6, len(rows) - 0.4])
    plot.update_layout(barmode="overlay", legend={"y": -0.3 - 0.2 / len(rows)})
    return plot


def speeds(session: Session, settings: Settings) -> go.Figure | None:
    """Speed of each tool that was moved; None: none was."""
    moved = [track for track in session.tools.values() if was_moved(track)]
    if not moved:
        return None
    plot = _over_time(session, "speed [mm/s]")
    for number, track in enumerate(moved):
        speed = 1e3 * speeds_of(track.positions, session.rate_hz)
        plot.add_scatter(
            x=_thin(session.times), y=_thin(speed), name=track.tool,
            line={"color": COLORS[number % len(COLORS)], "width": 1.5},
        )  # fmt: skip
    plot.add_hline(y=1e3 * settings.idle_speed, line={"color": "#8a939e", "dash": "dash"})
    return plot


def forces(session: Session) -> go.Figure | None:
    """Force on each tool that felt one; None: none did."""
    plot, some = _over_time(session, "force [N]"), False
    for number, track in enumerate(t for t in session.tools.values() if was_moved(t)):
        force = track.force
        if isinstance(force, Missing) or not force.values.any():
            continue
        some = True
        plot.add_scatter(
            x=_thin(force.times), y=_thin(force.values), name=track.tool,
            line={"color": COLORS[number % len(COLORS)], "width": 1.5},
        )  # fmt: skip
    return plot if some else None


def stress(session: Session) -> go.Figure | None:
    """Largest stress over time, with warnings shaded; None: not known."""
    history = session.stress
    if isinstance(history, Missing):
        return None
    scale, unit = (1e-3, "kPa") if history.unit == "Pa" else (1.0, history.unit)
    name = f"peak {in_words(history.quantity)}" + (f" [{unit}]" if unit else "")
    plot = _over_time(session, name)
    plot.add_scatter(
        x=history.peak.times, y=scale * history.peak.values, mode="lines+markers",
        marker={"size": 4}, line={"color": COLORS[1], "width": 1.5}, showlegend=False,
    )  # fmt: skip
    if not isinstance(session.violations, Missing):
        for one in session.violations:
            plot.add_vrect(
                x0=one.begin, x1=one.end, fillcolor="#e69f00", opacity=0.18, line_width=0,
                layer="below",
            )  # fmt: skip
    return plot


def closure(session: Session) -> go.Figure | None:
    """Share covered of each hole over time; None: no hole was measured."""
    if isinstance(session.holes, Missing):
        return None
    measured = [hole for hole in session.holes.values() if len(hole.times)]
    if not measured:
        return None
    plot = _over_time(session, "covered [%]")
    for number, hole in enumerate(measured):
        plot.add_scatter(
            x=hole.times, y=100.0 * hole.covered, name=hole.name, mode="lines+markers",
            line={"color": COLORS[number % len(COLORS)]}, showlegend=True,
        )  # fmt: skip
    plot.update_yaxes(rangemode="tozero")
    return plot


def ways(session: Session, settings: Settings) -> go.Figure | None:
    """Ways of the tips, lines of the cuts and the plan; can be turned. None: nothing moved."""
    moved = [track for track in session.tools.values() if was_moved(track)]
    if not moved:
        return None
    plot = blank("", "", height=520)
    for number, track in enumerate(moved):
        colour = COLORS[number % len(COLORS)]
        _line(plot, _thin(track.positions), track.tool, {"color": colour, "width": 3})
    cuts = () if isinstance(session.cuts, Missing) else session.cuts
    lips = [line for cut in cuts if not cut.undone for line in cut.surface.lines[:2]]
    if lips:
        _line(plot, _strokes(np.concatenate(lips)), "cut", {"color": "#000000", "width": 8})
    planned = [plan.edges for plan in settings.plans if isinstance(plan, PlannedLine)]
    if planned:
        style = {"color": "#777777", "width": 6, "dash": "dash"}
        _line(plot, _strokes(np.concatenate(planned)), "plan", style)
    axes = {f"{axis}axis": {"title": f"{axis} [mm]"} for axis in "xyz"}
    plot.update_layout(
        scene={**axes, "aspectmode": "data", "bgcolor": "#f1f3f6",
               "camera": {"eye": {"x": 1.5, "y": 1.5, "z": 1.3}, "center": {"z": -0.2}}},
        margin={"l": 0, "r": 0, "t": 10, "b": 0}, legend={"y": 0.0},
    )  # fmt: skip
    return plot


def _over_time(session: Session, what: str, height: int = 300) -> go.Figure:
    """A plot of the whole session without data: one time is at one place in all of them."""
    plot = blank("time [s]", what, height)
    plot.update_layout(margin={"l": MARGIN})
    plot.update_xaxes(range=[0.0, 1.02 * max(session.seconds, 0.1)])
    return plot


def _line(plot: go.Figure, points: Reals, name: str, style: dict[str, object]) -> None:
    x, y, z = (1e3 * points).round(3).T
    plot.add_scatter3d(x=x, y=y, z=z, mode="lines", name=name, line=style)


def _strokes(edges: Reals) -> Reals:
    """Edges as one line with gaps."""
    gaps = np.full((len(edges), 1, 3), np.nan)
    return np.concatenate([edges, gaps], axis=1).reshape(-1, 3)


def _thin(values: Reals) -> Reals:
    step = max(1, -(-len(values) // MOST_POINTS))
    thin: Reals = values[::step].astype(np.float32)
    return thin
