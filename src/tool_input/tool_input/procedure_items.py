"""Poses, rotations and sweeps as a procedure file writes them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tool_input.located_yaml import Item
from tool_input.motion import Pose

SIZES = {"sphere": 1, "rectangle": 2, "triangle": 2}
"""Numbers in a tool's size, by shape."""

SMALLEST_AREA = 1e-12
"""Area [m^2] below which a sweep's triangle is degenerate."""


def pose_of(item: Item, scale: float) -> Pose:
    """A pose written as `{position: [x, y, z], orientation: ...}`.

    Args:
        item: The mapping.
        scale: Metres per unit of length of the file.
    """
    keys = item.mapping(("position", "orientation"), ("position",))
    rotation = rotation_of(keys["orientation"]) if "orientation" in keys else Rotation.identity()
    return Pose(keys["position"].vector(3) * scale, rotation.as_quat())


def rotation_of(item: Item) -> Rotation:
    """A rotation written as quaternion x y z w, rotation_vector [rad], or axis and angle_deg."""
    keys = item.mapping(("quaternion", "rotation_vector", "axis", "angle_deg"))
    if set(keys) == {"quaternion"}:
        quaternion = keys["quaternion"].vector(4)
        length = float(np.linalg.norm(quaternion))
        if not 0.99 < length < 1.01:
            raise keys["quaternion"].error(f"must have length 1, not {length:g}")
        return Rotation.from_quat(quaternion)
    if set(keys) == {"rotation_vector"}:
        return Rotation.from_rotvec(keys["rotation_vector"].vector(3))
    if set(keys) == {"axis", "angle_deg"}:
        axis = keys["axis"].vector(3)
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise keys["axis"].error("must not be zero")
        return Rotation.from_rotvec(axis / length * np.deg2rad(keys["angle_deg"].number()))
    raise item.error("must be either quaternion, or rotation_vector, or axis and angle_deg")


def sweep_of(item: Item, scale: float) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """A cut's sweep: a rectangle about a centre, a triangle, or a strip between two lines.

    Args:
        item: `{rectangle: {center, along, depth}}` with the two whole edges as vectors,
            `{triangle: [a, b, c]}`, or `{strip: {from: [points], to: [points]}}`.
        scale: Metres per unit of length of the file.

    Returns:
        Vertices [m], shape (n, 3), and triangles, shape (m, 3).
    """
    keys = item.mapping(("rectangle", "triangle", "strip"))
    if len(keys) != 1:
        raise item.error("must be exactly one of rectangle, triangle and strip")
    if "triangle" in keys:
        corners = _points(keys["triangle"], scale)
        if len(corners) != 3:
            raise keys["triangle"].error(f"must have 3 points, not {len(corners)}")
        vertices, triangles = corners, np.array([[0, 1, 2]])
    elif "rectangle" in keys:
        vertices, triangles = _rectangle(keys["rectangle"], scale)
    else:
        vertices, triangles = _strip(keys["strip"], scale)
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if (areas < SMALLEST_AREA).any():
        raise item.error("the sweep has a triangle without area")
    return vertices, triangles.astype(np.uint32)


def _rectangle(item: Item, scale: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    names = ("center", "along", "depth")
    keys = item.mapping(names, names)
    centre, along, depth = (keys[name].vector(3) * scale for name in names)
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    return centre + signs @ np.array([along, depth]), np.array([[0, 1, 2], [0, 2, 3]])


def _strip(item: Item, scale: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    keys = item.mapping(("from", "to"), ("from", "to"))
    first, second = _points(keys["from"], scale), _points(keys["to"], scale)
    if len(first) != len(second) or len(first) < 2:
        raise item.error("from and to must have the same number of points, at least 2")
    count = len(first)
    rows = np.arange(count - 1)
    lower = np.stack([rows, rows + 1, rows + count], axis=1)
    upper = np.stack([rows + 1, rows + 1 + count, rows + count], axis=1)
    return np.concatenate([first, second]), np.concatenate([lower, upper])


def _points(item: Item, scale: float) -> NDArray[np.float64]:
    return np.array([point.vector(3) for point in item.list()]) * scale
