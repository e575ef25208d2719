"""Draws pictures with VTK, in a process of its own: VTK aborts without a graphics driver.

Usage: python -m viz_bridge.picture_process FILE.npz PICTURE.png [FILE.npz PICTURE.png ...]
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viz_bridge.picture_grid import draw_grid

SIZE = (1280, 960)
BACKGROUND, HORIZON = "#20262f", "#8b97a6"
STEEL, PRESSED, SHAFT = "#d5dde6", "#ffc45c", "#9aa5b2"
THREAD, THREAD_RADIUS, KNOT_RADIUS = "#2f4fd0", 0.00016, 0.0003
"""Colour of sutures, and radii [m]."""


def draw(file: str, picture: str) -> None:
    """Draw one saved moment, or several organs side by side."""
    import pyvista

    with np.load(file) as saved:
        arrays = {name: saved[name] for name in saved.files}
    if "grid" in arrays:
        draw_grid(arrays, picture)
        return
    plotter = pyvista.Plotter(off_screen=True, window_size=list(SIZE), lighting="none")
    plotter.set_background(BACKGROUND, top=HORIZON)
    position, target, up = arrays["camera"]
    _light(plotter, position, target, up)
    size = float(np.linalg.norm(np.ptp(arrays["outside_points"], axis=0)))
    _add_tissue(plotter, arrays, "outside", specular=0.28, power=22)
    _add_tissue(plotter, arrays, "inside", specular=0.6, power=45)
    if len(arrays.get("threads", ())):
        _add_threads(plotter, arrays["threads"])
    number = 0
    while f"tool{number}" in arrays:
        _add_tool(plotter, arrays[f"tool{number}"], bool(arrays[f"tool{number}_pressed"]))
        number += 1
    plotter.camera.position, plotter.camera.focal_point = tuple(position), tuple(target)
    plotter.camera.up, plotter.camera.view_angle = tuple(up), 28.0
    plotter.reset_camera_clipping_range()
    plotter.enable_ssao(radius=0.04 * size, bias=0.0005 * size, kernel_size=24, blur=True)
    plotter.enable_anti_aliasing("ssaa", all_renderers=False)
    caption, when = (str(words) for words in arrays["words"])
    plotter.add_text(caption, position=(28, 52), font_size=16, color="white", shadow=True)
    plotter.add_text(when, position=(30, 24), font_size=10, color="#dbe3ec")
    plotter.screenshot(picture)
    plotter.close()


def _light(
    plotter: Any,
    position: NDArray[np.float64],
    target: NDArray[np.float64],
    up: NDArray[np.float64],
) -> None:
    import pyvista

    toward = position - target
    side = np.cross(up, toward)
    side *= np.linalg.norm(toward) / np.linalg.norm(side)
    high = up * np.linalg.norm(toward)
    for place, strength, color in (
        (toward + 0.7 * high - 0.8 * side, 0.92, "#fff4e6"),
        (toward + 0.2 * high + 1.1 * side, 0.34, "#cfe0ff"),
        (-0.7 * toward + 0.9 * high + 0.5 * side, 0.35, "#ffffff"),
        (toward, 0.14, "#ffffff"),
    ):
        plotter.add_light(
            pyvista.Light(
                position=tuple(target + place),
                focal_point=tuple(target),
                color=color,
                intensity=strength,
                light_type="scene light",
            )
        )


def _add_tissue(
    plotter: Any, arrays: dict[str, NDArray], name: str, specular: float, power: float
) -> None:
    import pyvista

    triangles = arrays[f"{name}_triangles"]
    if not len(triangles):
        return
    surface = pyvista.PolyData.from_regular_faces(arrays[f"{name}_points"], triangles)
    surface.point_data["colors"] = arrays[f"{name}_colors"]
    surface.point_data["Normals"] = arrays[f"{name}_normals"]
    surface.point_data.active_normals_name = "Normals"
    plotter.add_mesh(
        surface,
        scalars="colors",
        rgb=True,
        smooth_shading=True,
        ambient=0.16,
        diffuse=0.9,
        specular=specular,
        specular_power=power,
    )


def _add_threads(plotter: Any, threads: NDArray[np.float64]) -> None:
    """Sutures, from their ends [m], shape (n, 2, 3)."""
    import pyvista

    for one, other in threads.astype(np.float64):
        length = float(np.linalg.norm(other - one))
        if length > 0.0:
            thread = pyvista.Cylinder(
                center=(one + other) / 2, direction=other - one, radius=THREAD_RADIUS, height=length
            )
            plotter.add_mesh(thread, color=THREAD, ambient=0.3)
    knots = pyvista.PolyData(threads.reshape(-1, 3).astype(np.float64))
    balls = knots.glyph(geom=pyvista.Sphere(radius=KNOT_RADIUS), scale=False, orient=False)
    plotter.add_mesh(balls, color=THREAD, ambient=0.3, smooth_shading=True)


def _add_tool(plotter: Any, points: NDArray[np.float64], pressed: bool) -> None:
    import pyvista

    color = PRESSED if pressed else STEEL
    metal = {"specular": 0.7, "specular_power": 40, "ambient": 0.2, "smooth_shading": True}
    if len(points) == 3:
        tip, radius, end = points[0], float(points[1, 0]), points[2]
        ball = pyvista.Sphere(radius=radius, center=tip, theta_resolution=48, phi_resolution=48)
        plotter.add_mesh(ball, color=color, opacity=0.16, smooth_shading=True)
        plotter.add_mesh(pyvista.Sphere(radius=0.0015, center=tip), color=color, **metal)
    else:
        corners, end = points[:-1], points[-1]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal *= 0.00015 / max(float(np.linalg.norm(normal)), 1e-12)
        count = len(corners)
        both = np.concatenate([corners - normal, corners + normal])
        faces = [[count, *range(count)], [count, *range(2 * count - 1, count - 1, -1)]]
        faces += [[4, k, (k + 1) % count, count + (k + 1) % count, count + k] for k in range(count)]
        blade = pyvista.PolyData(both, np.concatenate(faces))
        plotter.add_mesh(blade, color=color, ambient=0.25, specular=0.8, specular_power=30)
        top = corners[2:] if count == 4 else corners[1:]
        tip = top.mean(axis=0)
    length = float(np.linalg.norm(end - tip))
    shaft = pyvista.Cylinder(
        center=(tip + end) / 2, direction=end - tip, radius=0.0009, height=length, resolution=32
    )
    plotter.add_mesh(shaft, color=SHAFT, **metal)


def main() -> int:
    """Draw what the command line names."""
    names = sys.argv[1:]
    for file, picture in zip(names[::2], names[1::2], strict=True):
        draw(file, picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
