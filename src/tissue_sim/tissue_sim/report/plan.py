"""Where a cut was planned, and how far from there it was made.

A plan is a YAML file with lines on the organ at rest, or a procedure, whose cuts are planned where
its sweeps are: in the shape that the tissue has when it is cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.report.cut_surface import CutSurface, distances_from_lines, lengths_of
from tool_input.located_yaml import Item, ProcedureError, read_located_file
from tool_input.procedure import load_procedure
from tool_input.procedure_items import points_of

SPACING = 2.5e-4
"""Lines are compared at points this far apart at most [m]."""
HALF = 0.5
"""A line of a cut shorter than this share of its longest one is not held against a plan."""

Reals = NDArray[np.float64]


@dataclass(frozen=True)
class PlannedLine:
    """A line on the organ at rest along which a cut is planned.

    Attributes:
        name: What people call it.
        points: Its points in order [m], shape (n, 3), n at least 2.
    """

    name: str
    points: Reals

    @property
    def edges(self) -> Reals:
        """Its parts [m], shape (n - 1, 2, 3)."""
        return np.stack([self.points[:-1], self.points[1:]], axis=1)


@dataclass(frozen=True)
class PlannedSweep:
    """A surface along which a cut is planned, in the shape that the tissue has then.

    Attributes:
        name: What people call it.
        vertices: Corners [m], shape (n, 3).
        triangles: Three rows of them each, shape (m, 3).
    """

    name: str
    vertices: Reals
    triangles: NDArray[np.uint32]


Planned = PlannedLine | PlannedSweep


@dataclass(frozen=True)
class Deviation:
    """How far a cut is from its plan [m].

    Attributes:
        plan: Name of what was planned; of several the nearest.
        rms: Root mean square over the cut's line, or over its surface for a sweep.
        largest: Largest distance of the cut from the plan.
        missed: Largest distance of the plan from the cut: what was not cut; nan for a sweep, which
            reaches farther than the tissue.
    """

    plan: str
    rms: float
    largest: float
    missed: float


def read_plan(path: Path) -> tuple[Planned, ...]:
    """What a file plans.

    Args:
        path: A procedure with cuts, or a plan: `units` (m or mm) and `lines`, a list of `name` and
            `points`.

    Raises:
        ProcedureError: The file cannot be read, or plans no cut; the message names the line.
    """
    root = read_located_file(path, "plan")
    if isinstance(root.value, dict) and "timeline" in root.value:
        planned = [
            PlannedSweep(event.where, event.sweep.vertices, event.sweep.triangles)
            for event in load_procedure(path).events
            if event.sweep is not None
        ]
        if not planned:
            raise ProcedureError(
                f"{path}: no cut step is in this procedure; a plan needs one, or units and lines"
            )
        return tuple(planned)
    keys = root.mapping(("units", "lines"), ("units", "lines"))
    scale = 1e-3 if keys["units"].one_of(("m", "mm")) == "mm" else 1.0
    lines = [_line(item, scale) for item in keys["lines"].list()]
    if not lines:
        raise keys["lines"].error("must have at least one line")
    return tuple(lines)


def deviation_of(cut: CutSurface, seen: Reals, plans: Sequence[Planned]) -> Deviation | None:
    """How far a cut is from the nearest of several plans.

    Args:
        cut: What it has opened, at rest.
        seen: The same faces where they were when they were cut [m], shape (n, 3, 3).
        plans: Where cuts are planned.

    Returns:
        The deviation; None: nothing of the cut can be held against any of them.
    """
    found = [
        deviation
        for plan in plans
        for deviation in (
            _from_line(cut, plan) if isinstance(plan, PlannedLine) else _from_sweep(seen, plan),
        )
        if deviation is not None
    ]
    return min(found, key=lambda deviation: deviation.rms, default=None)


def _from_line(cut: CutSurface, plan: PlannedLine) -> Deviation | None:
    """From the line of the cut that is nearest: of those on both sides of a wall one is meant."""
    meant = [line for line in cut.lines if lengths_of(line).sum() >= HALF * cut.length]
    found = []
    for line in meant:
        points, weights = _along(line)
        apart = distances_from_lines(points, plan.edges)
        ends = distances_from_lines(line.reshape(-1, 3), plan.edges)
        missed = distances_from_lines(_along(plan.edges)[0], line)
        missed = np.append(missed, distances_from_lines(plan.points, line))
        rms = float(np.sqrt(np.average(apart**2, weights=weights)))
        found.append(Deviation(plan.name, rms, float(ends.max()), float(missed.max())))
    return min(found, key=lambda deviation: deviation.rms, default=None)


def _from_sweep(seen: Reals, plan: PlannedSweep) -> Deviation | None:
    if not len(seen):
        return None
    # Here, because cut_service depends on this package.
    from cut_service.sweep import Sweep

    sweep = Sweep.from_arrays(plan.vertices, plan.triangles)
    a, b, c = seen.transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    # At the middles of the sides: exact for squares of what runs straight across a triangle.
    middles = 0.5 * np.stack([a + b, b + c, c + a], axis=1)
    squared = (sweep.distance(middles.reshape(-1, 3)) ** 2).reshape(-1, 3).mean(axis=1)
    largest = float(sweep.distance(seen.reshape(-1, 3)).max())
    return Deviation(
        plan.name, float(np.sqrt(np.average(squared, weights=areas))), largest, float("nan")
    )


def _along(edges: Reals) -> tuple[Reals, Reals]:
    """Points along edges [m], shape (n, 3), and the length that each stands for [m], shape (n,)."""
    lengths = lengths_of(edges)
    counts = np.maximum(np.ceil(lengths / SPACING).astype(np.int64), 1)
    owner = np.repeat(np.arange(len(edges)), counts)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = ((number + 0.5) / counts[owner])[:, None]
    points = (1.0 - share) * edges[owner, 0] + share * edges[owner, 1]
    return points, (lengths / counts)[owner]


def _line(item: Item, scale: float) -> PlannedLine:
    keys = item.mapping(("name", "points"), ("name", "points"))
    points = points_of(keys["points"], scale)
    if len(points) < 2:
        raise keys["points"].error(f"must have at least 2 points, not {len(points)}")
    return PlannedLine(keys["name"].text(), points)
