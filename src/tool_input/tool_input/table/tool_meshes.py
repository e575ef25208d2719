"""The shapes of tools as meshes, in the tool's own axes about its tip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viz_bridge.tool_shapes import DrawnTool, blade_corners

AROUND, UP = 24, 6
"""Corners around a sphere or a capsule, and from its equator to its pole."""

Mesh = tuple[NDArray[np.float64], NDArray[np.uint32]]
"""Vertices [m], shape (n, 3), and triangles, outward by the right hand, shape (m, 3)."""

_BOX_SIDES = np.array(
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
)


def tool_mesh(shape: str, size: tuple[float, ...]) -> Mesh:
    """A tool's shape.

    Args:
        shape: "sphere", "box", "capsule", "rectangle" or "triangle".
        size: As in Tool.size [m].

    Raises:
        ValueError: The shape is none of these.
    """
    if shape == "sphere":
        return _capsule(size[0], 0.0)
    if shape == "capsule":
        return _capsule(size[0], size[1])
    if shape == "box":
        corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
        return corners * np.array(size) / 2, _quads(_BOX_SIDES)
    if shape in ("rectangle", "triangle"):
        outline = blade_corners(DrawnTool("", "", shape, size))
        return outline, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)[: len(outline) - 2]
    raise ValueError(
        f"there is no tool shape '{shape}'; allowed: sphere, box, capsule, rectangle, triangle"
    )


def _capsule(radius: float, length: float) -> Mesh:
    """Half a ball at the origin, half a ball `length` over it, and the tube between."""
    quarter = np.linspace(0.0, np.pi / 2, UP)
    heights = np.concatenate([-quarter[::-1], quarter])
    turns = np.linspace(0.0, 2 * np.pi, AROUND, endpoint=False)
    wide, high = radius * np.cos(heights), radius * np.sin(heights)
    high[UP:] += length
    rings = np.empty((len(heights), AROUND, 3))
    rings[..., 0] = wide[:, None] * np.cos(turns)
    rings[..., 1] = wide[:, None] * np.sin(turns)
    rings[..., 2] = high[:, None]
    row, column = np.mgrid[0 : len(heights) - 1, 0:AROUND]
    beside = (column + 1) % AROUND
    sides = [row * AROUND + column, row * AROUND + beside]
    sides += [(row + 1) * AROUND + beside, (row + 1) * AROUND + column]
    return rings.reshape(-1, 3), _quads(np.stack([side.ravel() for side in sides], axis=1))


def _quads(corners: NDArray[np.integer]) -> NDArray[np.uint32]:
    """Two triangles for each four corners."""
    return corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.uint32)
