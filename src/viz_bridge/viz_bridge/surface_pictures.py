"""A picture of organs made of tetrahedra, connected surfaces and a surface, pulled alike."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tissue_sim import surface_study
from tissue_sim.model_study import Row, Shape
from viz_bridge.model_pictures import panels
from viz_bridge.pictures import Pictures, render_files


def draw_surfaces(
    folder: Path,
    geometries: tuple[str, ...] = ("wall", "heart"),
    progress: Callable[[Row], None] | None = None,
) -> Pictures:
    """Draw surfaces_<geometry>.png for each geometry.

    Args:
        folder: Folder of the PNG files.
        geometries: What to pull.
        progress: Called with each row as it is ready.
    """
    files = {}
    for geometry in geometries:
        shapes: list[Shape] = []
        for shape in surface_study.study(geometry):
            shapes.append(shape)
            if progress is not None:
                progress(shape.row)
        titles = [shape.row.label for shape in shapes]
        files[f"surfaces_{geometry}"] = panels(shapes, len(shapes), titles)
    return render_files(files, folder)
