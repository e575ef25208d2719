"""Pictures of every elastic model on the wall and the heart, and the figures beside them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim import model_study
from tissue_sim.geometry.surface import surface_triangles
from tissue_sim.model_study import Pull, Row, Shape
from viz_bridge.organ_surface import surface_of
from viz_bridge.picture_scene import VIEW_ANGLE, Camera
from viz_bridge.pictures import Pictures, render_files

COLUMNS = 3
PANEL = (380, 310)
"""Width and height of one model in a picture [pixels]."""
FROM = {"wall": (0.8, 1.0, 0.55), "heart": (0.9, -0.75, 0.05)}
"""Where each geometry is looked at from."""
RAISED = {"wall": -0.04, "heart": 0.14}
"""How far the camera looks above the middle, in radii of that sphere."""

SPACE = {"wall": 0.84, "heart": 1.02}
"""Distance of the camera over the least from which the sphere around the geometry is in view."""


def draw_models(
    pictures: Path,
    results: Path,
    geometries: tuple[str, ...] = ("wall", "heart"),
    progress: Callable[[Row], None] | None = None,
) -> Pictures:
    """Pull every model, write the figures, and draw a grid per geometry and a picture per model.

    Args:
        pictures: Folder of the PNG files.
        results: JSON file for the figures.
        geometries: What to pull.
        progress: Called with each row as it is ready.
    """
    shapes = []
    for shape in model_study.study(geometries):
        shapes.append(shape)
        if progress is not None:
            progress(shape.row)
    model_study.write(results, [shape.row for shape in shapes])
    return draw_shapes(shapes, pictures)


def draw_shapes(shapes: list[Shape], folder: Path) -> Pictures:
    """Draw pulled organs: models_<geometry>.png and model_<model>.png."""
    files: dict[str, dict[str, NDArray]] = {}
    for geometry in dict.fromkeys(shape.pull.geometry for shape in shapes):
        chosen = [shape for shape in shapes if shape.pull.geometry == geometry]
        files[f"models_{geometry}"] = panels(chosen, COLUMNS, [s.row.label for s in chosen])
    order = {variant.label: place for place, variant in enumerate(model_study.VARIANTS)}
    for model in dict.fromkeys(shape.row.model for shape in shapes):
        chosen = [shape for shape in shapes if shape.row.model == model]
        columns = len({shape.pull.geometry for shape in chosen})
        chosen.sort(key=lambda shape: order[shape.row.label])
        titles = [f"{shape.row.label}: {shape.pull.geometry}" for shape in chosen]
        files[f"model_{model}"] = panels(chosen, columns, titles)
    return render_files(files, folder)


def panels(shapes: list[Shape], columns: int, titles: list[str]) -> dict[str, NDArray]:
    """What `picture_grid` draws, in plain arrays."""
    arrays: dict[str, NDArray] = {
        "grid": np.array([-(-len(shapes) // columns), columns, *PANEL]),
        "range_mm": np.array([0.0, max(shape.row.pull_mm for shape in shapes)]),
    }
    for number, (shape, title) in enumerate(zip(shapes, titles, strict=True)):
        pull = shape.pull
        rest = pull.mesh.rest[: pull.mesh.node_rows]
        part = surface_of(pull.mesh).outside
        positions = (rest + shape.displacement).astype(np.float32)
        vertices = part.vertices(positions)
        shown = np.intersect1d(pull.held, surface_triangles(pull.mesh))
        camera = camera_of_pull(pull)
        arrays |= {
            f"panel{number}_points": vertices,
            f"panel{number}_triangles": part.triangles,
            f"panel{number}_normals": part.normals(vertices),
            f"panel{number}_mm": 1e3 * np.linalg.norm(shape.displacement[part.nodes], axis=1),
            f"panel{number}_held": positions[shown],
            f"panel{number}_words": np.array([title, words_of(shape.row)]),
            f"panel{number}_camera": np.stack([camera.position, camera.target, camera.up]),
            f"panel{number}_edges": np.array(len(part.triangles) < 5000),
        }
    return arrays


def words_of(row: Row) -> str:
    """The line below a model's name."""
    inverted = f", {row.inverted} inverted" if row.inverted else ""
    if row.label == model_study.REFERENCE.label:
        return f"the reference{inverted}"
    return (
        f"off by {row.mean_difference_mm:.2f} mm, at most {row.largest_difference_mm:.1f}{inverted}"
    )


def camera_of_pull(pull: Pull) -> Camera:
    """The same camera for every model on a geometry: all of it in view, at rest and pulled."""
    rest = pull.mesh.rest[: pull.mesh.node_rows]
    everything = np.concatenate([rest, rest[pull.held] + pull.vector])
    middle = (everything.min(axis=0) + everything.max(axis=0)) / 2
    radius = float(np.linalg.norm(everything - middle, axis=1).max())
    direction = np.array(FROM.get(pull.geometry, (0.6, -1.0, 0.4)))
    direction /= np.linalg.norm(direction)
    distance = SPACE.get(pull.geometry, 1.0) * radius / np.sin(np.radians(VIEW_ANGLE / 2))
    up = np.array([0.0, 0.0, 1.0])
    # Lower in the picture, so that the words have the top to themselves.
    target = middle + RAISED.get(pull.geometry, 0.1) * radius * up
    return Camera(target + distance * direction, target, up)
