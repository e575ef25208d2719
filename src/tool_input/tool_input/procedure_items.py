"""Poses, rotations, sweeps and stitches as a procedure file writes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tool_input.located_yaml import Item
from tool_input.motion import Pose

SIZES = {"sphere": 1, "box": 3, "capsule": 2, "rectangle": 2, "triangle": 2}
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
        corners = points_of(keys["triangle"], scale)
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
    first, second = points_of(keys["from"], scale), points_of(keys["to"], scale)
    if len(first) != len(second) or len(first) < 2:
        raise item.error("from and to must have the same number of points, at least 2")
    count = len(first)
    rows = np.arange(count - 1)
    lower = np.stack([rows, rows + 1, rows + count], axis=1)
    upper = np.stack([rows + 1, rows + 1 + count, rows + count], axis=1)
    return np.concatenate([first, second]), np.concatenate([lower, upper])


@dataclass(frozen=True)
class Stitching:
    """What a `suture` or a `sew_rim` step sews.

    Attributes:
        positions: Pairs, or two lines one after the other [m], shape (n, 3); of a rim: the edge of
            the hole, or none.
        spacing: Distance of stitches along the lines [m]; 0: every pair is a stitch.
        running: Whether one thread makes all stitches.
        reach: Longest way from a position to a node [m]; 0: the service's default.
        stiffness: Of each stitch [N/m]; 0: the service's default.
        patch: Patch whose rim it is; "": it is none.
        hole: Hole whose edge a rim is sewn to; "": that in `positions`, or the closest tissue.
    """

    positions: NDArray[np.float64]
    spacing: float
    running: bool
    reach: float
    stiffness: float
    patch: str = ""
    hole: str = ""


def stitching_of(item: Item, keys: dict[str, Item], scale: float) -> Stitching:
    """What a `suture` step sews: pairs of points, or two edges with a spacing.

    Args:
        item: `{pairs: [[a, b], ...]}` or `{from: [points], to: [points]}`, the edges in the same
            direction.
        keys: The step's `spacing`, `running`, `reach` and `stiffness` [N/m].
        scale: Metres per unit of length of the file.
    """
    subject = item.mapping(("pairs", "from", "to"))
    if set(subject) == {"pairs"}:
        if "spacing" in keys:
            raise keys["spacing"].error("goes with from and to: pairs are stitches as they are")
        pairs = [points_of(pair, scale) for pair in subject["pairs"].list()]
        if not pairs or any(len(pair) != 2 for pair in pairs):
            raise subject["pairs"].error("must be pairs of points, at least one")
        points = np.concatenate(pairs)
    elif set(subject) == {"from", "to"}:
        if "spacing" not in keys:
            raise item.error("from and to need the key 'spacing'")
        lines = [points_of(subject[name], scale) for name in ("from", "to")]
        if len(lines[0]) != len(lines[1]) or len(lines[0]) < 2:
            raise item.error("from and to must have the same number of points, at least 2")
        points = np.concatenate(lines)
    else:
        raise item.error("must have either pairs, or from and to")

    def number(name: str, unit: float) -> float:
        return keys[name].number(above=0.0) * unit if name in keys else 0.0

    running = keys["running"].flag() if "running" in keys else False
    spacing, reach = number("spacing", scale), number("reach", scale)
    return Stitching(points, spacing, running, reach, number("stiffness", 1.0))


def rest_length_of(item: Item, keys: dict[str, Item], scale: float) -> float:
    """A step's `length` [m], or minus its `share` of the present length; -1 for neither."""
    if {"length", "share"} <= set(keys):
        raise item.error("either length or share")
    if "length" in keys:
        return keys["length"].number(minimum=0.0) * scale
    return -keys["share"].number(above=0.0) if "share" in keys else -1.0


def points_of(item: Item, scale: float) -> NDArray[np.float64]:
    """Points written as lists of three numbers [m], shape (n, 3)."""
    return np.array([point.vector(3) for point in item.list()]) * scale
