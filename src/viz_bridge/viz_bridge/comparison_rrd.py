"""A comparison of models as a recording for rerun: all bodies side by side, and their curves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from tissue_sim.compare.comparison import Comparison, Target
from tissue_sim.compare.trajectory import Trajectory
from viz_bridge.blueprints import quiet_panels, scene_view
from viz_bridge.difference_colors import UNKNOWN, color_bar, difference_colors, scale_top
from viz_bridge.organ_surface import SurfacePart, surface_of
from viz_bridge.recording import file_stream

MOST_COLUMNS = 4
GAP = 1.15
"""Distance between two bodies over their size."""

HELD = (17, 17, 17)
FROM = (0.55, -0.75, 0.35)
"""Direction to the eye."""


@dataclass(frozen=True)
class _Body:
    """One trajectory as it is drawn: where, under which name, and with which distances [m]."""

    entity: str
    title: str
    trajectory: Trajectory
    place: NDArray[np.float64]
    distance: NDArray[np.float32] | None


def write_rrd(path: Path, comparison: Comparison) -> None:
    """Write a comparison as an .rrd file, whole or not at all.

    The reference and every target stand side by side and move with the interaction. Targets are
    coloured by the distance of each node from the reference, on one scale in millimetres whose end
    is at the largest 95th percentile of a frame. Timelines: `sim_time` and `frame`.

    Args:
        path: The file; replaced where it is there.
        comparison: What to draw.

    Raises:
        OSError: The file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    stream = file_stream(str(partial))
    bodies = _bodies(comparison)
    top = scale_top(max((t.difference.frame_p95.max() for t in comparison.targets), default=0.0))
    stream.send_blueprint(_blueprint(comparison, bodies))
    stream.log("legend", rr.Image(color_bar(top)), static=True)
    stream.log(
        "summary", rr.TextDocument(_summary(comparison), media_type="text/markdown"), static=True
    )
    part = surface_of(comparison.organ.mesh).outside
    for body in bodies:
        _log_body(stream, comparison, body, part, top)
    for target in comparison.targets:
        _log_curves(stream, comparison, target)
    _log_curve(
        stream, comparison, "plots/mean/worst", "only what is held moves",
        1e3 * comparison.worst.frame_mean, UNKNOWN,
    )  # fmt: skip
    stream.flush()
    stream.disconnect()
    partial.replace(path)


def entity_of(number: int, target: Target) -> str:
    """Where a target is drawn; targets may have one name twice."""
    return f"bodies/{number} {target.subject.name}"


def _bodies(comparison: Comparison) -> list[_Body]:
    organ, reference = comparison.organ, comparison.reference
    count = 1 + len(comparison.targets)
    places = _places(organ.rest + reference.displacement[-1], count)
    bodies = [
        _Body("bodies/reference", f"reference: {reference.label}", reference, places[0], None)
    ]
    unknown = np.zeros(organ.mesh.node_rows, dtype=np.bool_)
    if reference.rows is not None:
        unknown[:] = True
        unknown[reference.rows] = False
    for number, target in enumerate(comparison.targets, start=1):
        apart = target.trajectory.displacement - reference.displacement
        distance = np.linalg.norm(apart, axis=2)
        distance[:, unknown] = np.nan
        title = f"{target.subject.name}: {1e3 * target.difference.mean:.3g} mm"
        bodies.append(
            _Body(entity_of(number, target), title, target.trajectory, places[number], distance)
        )
    return bodies


def _places(shape: NDArray[np.floating], count: int) -> list[NDArray[np.float64]]:
    """Where bodies of about this shape stand: beside and below one another as the eye sees it."""
    right, up = np.cross([0.0, 0.0, 1.0], FROM), np.array([0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    columns = min(count, MOST_COLUMNS)
    wide, high = (GAP * float(np.ptp(shape @ axis)) for axis in (right, up))
    high = max(high, 0.4 * wide)
    return [(n % columns) * wide * right - (n // columns) * high * up for n in range(count)]


def _log_body(
    stream: rr.RecordingStream,
    comparison: Comparison,
    body: _Body,
    part: SurfacePart,
    top: float,
) -> None:
    rest, trajectory = comparison.organ.rest, body.trajectory
    path = rr.new_entity_path(body.entity.split("/"))
    highest = rest[:, 2].max() + 0.06 * comparison.organ.size
    label = [*rest.mean(axis=0)[:2], highest]
    stream.log(path, rr.Transform3D(translation=body.place), static=True)
    stream.log(f"{path}/name", rr.Points3D([label], labels=[body.title], radii=[0.0]), static=True)
    indexes = _times(comparison)
    if trajectory.rows is not None:
        known = rest[trajectory.rows] + trajectory.displacement[:, trajectory.rows]
        points = rr.Points3D.columns(positions=known.reshape(-1, 3).astype(np.float32))
        stream.send_columns(
            f"{path}/measured", indexes, points.partition([known.shape[1]] * len(known))
        )
        return
    frames = len(trajectory.displacement)
    shapes = (rest + trajectory.displacement).astype(np.float32)
    vertices = shapes[:, part.nodes]
    normals = np.concatenate([part.normals(np.ascontiguousarray(v)) for v in vertices])
    lengths = [len(part.nodes)] * frames
    own = part.colors if body.distance is None else None
    surface = rr.Mesh3D.from_fields(triangle_indices=part.triangles, vertex_colors=own)
    stream.log(f"{path}/surface", surface, static=True)
    moving = rr.Mesh3D.columns(vertex_positions=vertices.reshape(-1, 3), vertex_normals=normals)
    stream.send_columns(f"{path}/surface", indexes, moving.partition(lengths))
    if body.distance is not None:
        colors = difference_colors(body.distance[:, part.nodes].ravel(), top)
        colored = rr.Mesh3D.columns(vertex_colors=colors)
        stream.send_columns(f"{path}/surface", indexes, colored.partition(lengths))
    _log_held(stream, comparison, f"{path}/held", shapes)


def _log_held(
    stream: rr.RecordingStream, comparison: Comparison, path: str, shapes: NDArray[np.float32]
) -> None:
    interaction = comparison.interaction
    rows = [interaction.held_rows(frame) for frame in range(interaction.frames)]
    places = np.concatenate([shape[held] for shape, held in zip(shapes, rows, strict=True)])
    stream.log(
        path,
        rr.Points3D.from_fields(colors=[HELD], radii=[0.004 * comparison.organ.size]),
        static=True,
    )
    stream.send_columns(
        path,
        _times(comparison),
        rr.Points3D.columns(positions=places).partition([len(held) for held in rows]),
    )


def _log_curves(stream: rr.RecordingStream, comparison: Comparison, target: Target) -> None:
    number, found = comparison.targets.index(target) + 1, target.difference
    for what, values in (
        ("mean", 1e3 * found.frame_mean),
        ("p95", 1e3 * found.frame_p95),
        ("volume", 100.0 * found.volume_error),
    ):
        if np.isfinite(values).all():
            _log_curve(stream, comparison, f"plots/{what}/{number}", target.subject.name, values)


def _log_curve(
    stream: rr.RecordingStream,
    comparison: Comparison,
    path: str,
    name: str,
    values: NDArray[np.float64],
    color: tuple[int, int, int] | None = None,
) -> None:
    lines = rr.SeriesLines(names=[name], colors=None if color is None else [color])
    stream.log(path, lines, static=True)
    stream.send_columns(path, _times(comparison), rr.Scalars.columns(scalars=values))


def _times(comparison: Comparison) -> list[rr.TimeColumn]:
    frames = 1 + np.arange(comparison.interaction.frames)
    return [
        rr.TimeColumn("sim_time", duration=frames / comparison.interaction.rate_hz),
        rr.TimeColumn("frame", sequence=frames),
    ]


def _summary(comparison: Comparison) -> str:
    """The figures as a table in Markdown, the closest target first."""
    lines = [
        f"**{comparison.organ.name}**, {comparison.interaction.name}, "
        f"{comparison.interaction.seconds:.3g} s; reference: {comparison.reference.label}",
        "",
        "| target | mean [mm] | of the worst | p95 [mm] | largest [mm] |",
        "|---|---|---|---|---|",
    ]
    for target in comparison.ranking:
        found = target.difference
        lines.append(
            f"| {target.subject.name} | {1e3 * found.mean:.3g} | {target.relative:.3f} "
            f"| {1e3 * found.p95:.3g} | {1e3 * found.largest:.3g} |"
        )
    return "\n".join(lines)


def _blueprint(comparison: Comparison, bodies: list[_Body]) -> rrb.Blueprint:
    rest = comparison.organ.rest
    corners = np.concatenate([rest + body.place for body in bodies])
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    toward = np.array(FROM) / np.linalg.norm(FROM)
    eye = middle + 1.1 * float(np.linalg.norm(np.ptp(corners, axis=0))) * toward
    scene = scene_view("Reference and targets", ["$origin/**"], eye, middle, origin="/bodies")
    beside = rrb.Vertical(
        rrb.Spatial2DView(origin="/legend", name="Colours"),
        rrb.Tabs(
            rrb.TimeSeriesView(origin="/plots/mean", name="Mean difference [mm]"),
            rrb.TimeSeriesView(origin="/plots/p95", name="95th percentile [mm]"),
            rrb.TimeSeriesView(origin="/plots/volume", name="Volume error [%]"),
        ),
        rrb.TextDocumentView(origin="/summary", name="Figures"),
        row_shares=[1, 4, 3],
    )
    return quiet_panels(rrb.Horizontal(scene, beside, column_shares=[3, 2]))
