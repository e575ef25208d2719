"""Pictures of reference and target side by side, with the difference as colour."""

from __future__ import annotations

import base64
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.comparison import Comparison, Target
from tissue_sim.compare.trajectory import Trajectory
from tissue_sim.geometry.surface import surface_triangles
from tissue_sim.model_study import Pull

PANEL = (380, 310)
"""Width and height of one organ in a picture [pixels]."""
LABELS = 6
"""Numbers beside the colours."""
MOST_EDGES = 5000
"""Triangles up to which their edges are drawn."""


@dataclass(frozen=True)
class Pictures:
    """Pictures of a comparison.

    Attributes:
        png: PNG file of each target, in the order of the ranking; empty where none can be drawn.
        message: Why there are none.
    """

    png: tuple[bytes, ...]
    message: str = ""


def draw(comparison: Comparison) -> Pictures:
    """Draw each target beside the reference: when they are farthest apart, and at the end.

    All have the same view and the same colours. A machine without a graphics driver gives none and
    a message, never an error.
    """
    from viz_bridge.pictures import render_files

    top = colour_limit(comparison)
    files = {
        f"target{number:03d}": panels(comparison, target, top)
        for number, target in enumerate(comparison.ranking)
    }
    with tempfile.TemporaryDirectory(prefix="tissue_compare_") as folder:
        drawn = render_files(files, Path(folder))
        if len(drawn.files) < len(files):
            return Pictures((), drawn.message or "no pictures: some could not be drawn")
        return Pictures(tuple((Path(folder) / f"{name}.png").read_bytes() for name in files))


def data_uri(png: bytes) -> str:
    """A PNG file as an address that holds it."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def moments(target: Target) -> list[int]:
    """The frame in which a target is farthest from the reference while it is stable, and its last.

    The distance is the mean over the nodes; a target that is lost ends with its last stable frame.
    One frame if they are the same.
    """
    stable = max(1, target.trajectory.stable)
    return sorted({int(np.argmax(target.difference.frame_mean[:stable])), stable - 1})


def colour_limit(comparison: Comparison) -> float:
    """Difference that has the last colour in all pictures [mm]; larger ones have it too.

    The largest 95th percentile of the nodes in a frame that is drawn, rounded up, and at most that
    of tissue which does not follow at all: a model that is lost must not fade the others.
    """
    from viz_bridge.difference_colors import scale_top

    largest = max(
        float(target.difference.frame_p95[frame])
        for target in comparison.targets
        for frame in moments(target)
    )
    return 1e3 * scale_top(min(largest, float(comparison.worst.frame_p95.max())))


def apart(comparison: Comparison, target: Trajectory, frame: int) -> NDArray[np.float64]:
    """Distance of each node from the reference [m], nan where that knows nothing."""
    reference = comparison.reference
    distance: NDArray[np.float64] = np.linalg.norm(
        target.displacement[frame].astype(np.float64) - reference.displacement[frame], axis=1
    )
    if reference.rows is not None:
        unknown = np.ones(len(distance), dtype=np.bool_)
        unknown[reference.rows] = False
        distance[unknown] = np.nan
    return distance


def panels(comparison: Comparison, target: Target, top: float) -> dict[str, NDArray]:
    """What `viz_bridge.picture_grid` draws, in plain arrays.

    Args:
        comparison: The comparison.
        target: Which of its targets.
        top: Difference that has the last colour [mm].
    """
    from viz_bridge.organ_surface import surface_of

    part = surface_of(comparison.organ.mesh).outside
    frames, drawable = moments(target), _drawable(comparison, target)
    shown = [(trajectory, frame) for frame in frames for trajectory in drawable]
    arrays: dict[str, NDArray] = {
        "grid": np.array([len(frames), len(drawable), *PANEL]),
        "range_mm": np.array([0.0, top]),
        "labels": np.array(LABELS),
        "colors_are": np.array("difference [mm]"),
    }
    camera = _camera(comparison)
    surface = surface_triangles(comparison.organ.mesh)
    for number, (trajectory, frame) in enumerate(shown):
        positions = (comparison.organ.rest + trajectory.displacement[frame]).astype(np.float32)
        vertices = part.vertices(positions)
        distance = 1e3 * apart(comparison, target.trajectory, frame)
        held = np.intersect1d(comparison.interaction.held_rows(frame), surface)
        arrays |= {
            f"panel{number}_points": vertices,
            f"panel{number}_triangles": part.triangles,
            f"panel{number}_normals": part.normals(vertices),
            f"panel{number}_mm": distance[part.nodes],
            f"panel{number}_held": positions[held],
            f"panel{number}_words": np.array(_words(comparison, target, trajectory, frame)),
            f"panel{number}_camera": camera,
            f"panel{number}_edges": np.array(len(part.triangles) < MOST_EDGES),
        }
    return arrays


def _drawable(comparison: Comparison, target: Target) -> list[Trajectory]:
    """The reference, if it knows the whole surface, and the target."""
    reference = comparison.reference
    surface = np.unique(surface_triangles(comparison.organ.mesh))
    known = reference.rows is None or bool(np.isin(surface, reference.rows).all())
    return [reference, target.trajectory] if known else [target.trajectory]


def _words(comparison: Comparison, target: Target, trajectory: Trajectory, frame: int) -> list[str]:
    when = f"t = {(frame + 1) / trajectory.rate_hz:.2f} s"
    if trajectory is comparison.reference:
        return ["reference", when]
    mean = 1e3 * float(target.difference.frame_mean[frame])
    return [target.subject.name, f"{when}, mean difference {mean:.3g} mm"]


def _camera(comparison: Comparison) -> NDArray[np.float64]:
    """Position, target and up of the camera of all pictures, shape (3, 3)."""
    from viz_bridge.model_pictures import camera_of_pull

    interaction = comparison.interaction
    farthest = np.linalg.norm(interaction.displacement.mean(axis=1), axis=1).argmax()
    vector = interaction.displacement[farthest].mean(axis=0)
    organ = comparison.organ
    camera = camera_of_pull(Pull(organ.name, organ.mesh, interaction.nodes, vector))
    return np.stack([camera.position, camera.target, camera.up])
