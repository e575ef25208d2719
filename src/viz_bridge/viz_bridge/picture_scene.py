"""What a picture shows, in plain arrays: computed here, drawn by `picture_process`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viz_bridge.moments import Moment
from viz_bridge.tool_shapes import DrawnTool, blade_corners, rotated

VIEW_ANGLE = 28.0
"""Of the camera, from top to bottom [degrees]."""


@dataclass(frozen=True)
class Camera:
    """Where pictures are taken from; lengths in metres."""

    position: NDArray[np.float64]
    target: NDArray[np.float64]
    up: NDArray[np.float64]


def camera_of(moments: list[Moment]) -> Camera:
    """One camera for all pictures of a session, so that they can be compared.

    It looks at the place of the operation from outside, a little from the side, and has the whole
    organ in view.
    """
    operated = moments[-1]
    for moment in moments:
        if moment.name in ("pulled", "cut_open"):
            operated = moment
    everything = np.concatenate([m.positions[m.surface.outside.nodes] for m in moments])
    low, high = everything.min(axis=0), everything.max(axis=0)
    middle = (low + high).astype(np.float64) / 2
    radius = float(np.linalg.norm(everything - middle, axis=1).max())
    outward = _outward(moments[0], operated.focus, middle)
    up = np.array([0.0, 0.0, 1.0])
    if abs(outward @ up) > 0.9:
        up = np.array([0.0, 1.0, 0.0])
    side = np.cross(up, outward)
    side /= np.linalg.norm(side)
    above = np.cross(outward, side)
    direction = outward + 0.38 * side + 0.30 * above
    direction /= np.linalg.norm(direction)
    target = middle + 0.35 * (operated.focus - middle)
    distance = 0.92 * radius / np.sin(np.radians(VIEW_ANGLE / 2))
    return Camera(target + distance * direction, target, up)


def _outward(
    moment: Moment, focus: NDArray[np.float64], middle: NDArray[np.float64]
) -> NDArray[np.float64]:
    part = moment.surface.outside
    vertices = part.vertices(moment.positions)
    normals = part.normals(vertices).astype(np.float64)
    size = float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0)))
    away = np.linalg.norm(vertices - focus, axis=1)
    near = away < max(0.15 * size, 1.001 * float(away.min()))
    # A hollow organ also has a surface inside: what faces the middle is not looked at.
    centre = focus - middle
    facing = normals[near] @ centre > 0
    chosen = normals[near][facing] if facing.any() else normals[near]
    mean = chosen.mean(axis=0) + 0.5 * centre / max(float(np.linalg.norm(centre)), 1e-9)
    length = float(np.linalg.norm(mean))
    return mean / length if length > 1e-6 else np.array([0.0, -1.0, 0.0])


def arrays_of(moment: Moment, camera: Camera) -> dict[str, NDArray]:
    """All that a picture needs."""
    arrays: dict[str, NDArray] = {
        "camera": np.stack([camera.position, camera.target, camera.up]),
        "words": np.array([moment.caption, f"t = {moment.sim_time:.2f} s, frame {moment.frame}"]),
        "threads": moment.threads,
    }
    for name in ("outside", "inside"):
        part = getattr(moment.surface, name)
        vertices = part.vertices(moment.positions)
        arrays |= {
            f"{name}_points": vertices,
            f"{name}_triangles": part.triangles,
            f"{name}_normals": part.normals(vertices),
            f"{name}_colors": part.colors,
        }
    handle = handle_direction(camera)
    drawn = [tool for tool in moment.tools if tool.state != "free"]
    for number, tool in enumerate(drawn):
        arrays[f"tool{number}"] = tool_outline(tool, handle)
        arrays[f"tool{number}_pressed"] = np.array(tool.use)
    return arrays


def handle_direction(camera: Camera) -> NDArray[np.float64]:
    """Where a tool without a direction of its own is held from: beside the view, not across it."""
    toward = camera.position - camera.target
    toward = toward / np.linalg.norm(toward)
    right = np.cross(camera.up, toward)
    right /= np.linalg.norm(right)
    direction: NDArray[np.float64] = 0.8 * right - 0.35 * np.cross(toward, right) + 0.55 * toward
    return direction / float(np.linalg.norm(direction))


def tool_outline(tool: DrawnTool, handle: NDArray[np.float64]) -> NDArray[np.float64]:
    """A tool as points [m]: tip, radius and shaft end for a sphere; corners for a blade.

    Args:
        tool: The tool.
        handle: Unit vector along which a sphere's shaft runs, shape (3,).

    Returns:
        Shape (3, 3) for a sphere: tip, (radius, 0, 0), end of the shaft; for a blade its corners,
        shape (4 or 5, 3), the last one being the end of its shaft.
    """
    if tool.shape in ("sphere", "capsule", "box"):
        radius = tool.size[0] if tool.size else 0.005
        radius = 0.5 * radius if tool.shape == "box" else radius
        return np.stack([tool.tip, [radius, 0.0, 0.0], tool.tip + 0.09 * handle])
    corners = blade_corners(tool)
    top = corners[corners[:, 2] >= corners[:, 2].max() - 1e-9].mean(axis=0)
    local = np.concatenate([corners, [top + np.array([0.0, 0.0, 0.06])]])
    return tool.tip + rotated(tool.pose[3:], local)
