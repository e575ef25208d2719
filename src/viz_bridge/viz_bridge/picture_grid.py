"""Draws several organs side by side, coloured by how far each point was moved."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from viz_bridge.picture_scene import VIEW_ANGLE

PAPER, INK, GREY, HELD = "#f1f3f6", "#1c2530", "#5b6673", "#111111"
COLORS = "YlOrRd"
BAR = 58
"""Height of the strip with the colour bar [pixels]."""


def draw_grid(arrays: dict[str, NDArray], picture: str) -> None:
    """Draw the arrays of `model_pictures.panels`, or of `compare.report.pictures`."""
    import pyvista

    rows, columns, width, height = (int(number) for number in arrays["grid"])
    total = rows * height + BAR
    plotter = pyvista.Plotter(
        off_screen=True,
        shape=(rows + 1, columns),
        row_weights=[height] * rows + [BAR],
        groups=[(rows, slice(None))],
        window_size=[columns * width, total],
        border=False,
        lighting="none",
    )
    plotter.set_background(PAPER, all_renderers=True)
    limits = [float(number) for number in arrays["range_mm"]]
    number, mapper = 0, None
    while f"panel{number}_points" in arrays:
        plotter.subplot(number // columns, number % columns)
        part = {
            name.partition("_")[2]: array
            for name, array in arrays.items()
            if name.startswith(f"panel{number}_")
        }
        mapper = _add_panel(plotter, part, limits, height)
        number += 1
    title = str(arrays.get("colors_are", "displacement [mm]"))
    labels = int(arrays.get("labels", round(limits[1] / 2) + 1))
    plotter.subplot(rows, 0)
    plotter.add_scalar_bar(
        title="", mapper=mapper, n_labels=labels, fmt="%.3g", color=INK,
        width=0.55, height=0.7, position_x=0.35, position_y=0.15,
        label_font_size=14,
    )  # fmt: skip
    plotter.add_text(title, position=(24, 20), font_size=11, color=INK)
    plotter.enable_anti_aliasing("ssaa", all_renderers=True)
    plotter.screenshot(picture)
    plotter.close()


def _add_panel(plotter: Any, part: dict[str, NDArray], limits: list[float], height: int) -> Any:
    import pyvista

    surface = pyvista.PolyData.from_regular_faces(part["points"], part["triangles"])
    surface.point_data["Normals"] = part["normals"]
    surface.point_data.active_normals_name = "Normals"
    surface.point_data["mm"] = part["mm"]
    edges = bool(part["edges"])
    actor = plotter.add_mesh(
        surface, scalars="mm", clim=limits, cmap=COLORS, show_scalar_bar=False,
        smooth_shading=not edges, show_edges=edges, edge_color="#2b3542", edge_opacity=0.35,
        ambient=0.42, diffuse=0.72, specular=0.08,
    )  # fmt: skip
    position, target, up = part["camera"]
    if len(part["held"]):
        size = 3.0 if len(part["held"]) > 40 else 6.0
        plotter.add_points(part["held"], color=HELD, point_size=size, render_points_as_spheres=True)
    _light(plotter, position, target, up)
    plotter.camera.position, plotter.camera.focal_point = tuple(position), tuple(target)
    plotter.camera.up, plotter.camera.view_angle = tuple(up), VIEW_ANGLE
    plotter.reset_camera_clipping_range()
    title, words = (str(text) for text in part["words"])
    plotter.add_text(title, position=(10, height - 26), font_size=9, color=INK)
    plotter.add_text(words, position=(10, height - 46), font_size=8, color=GREY)
    return actor.mapper


def _light(
    plotter: Any,
    position: NDArray[np.float64],
    target: NDArray[np.float64],
    up: NDArray[np.float64],
) -> None:
    import pyvista

    toward = position - target
    side = np.cross(up, toward)
    for place, strength in ((toward + 0.5 * side + 0.6 * up * np.linalg.norm(toward), 0.75),
                            (toward - 0.9 * side, 0.35)):  # fmt: skip
        plotter.add_light(
            pyvista.Light(
                position=tuple(target + place),
                focal_point=tuple(target),
                intensity=strength,
                light_type="scene light",
            ),
            only_active=True,
        )
