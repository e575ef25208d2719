"""Patches as a procedure file writes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tool_input.located_yaml import Item
from tool_input.motion import Pose
from tool_input.procedure_items import pose_of

KEYS = (
    "outline", "ellipse", "pose", "at", "normal", "thickness", "young_modulus", "density", "edge",
    "carried_by", "name",
)  # fmt: skip
CORNERS_OF_ELLIPSE = 48


@dataclass(frozen=True)
class PatchItem:
    """What a `patch` step adds; zero and empty: as the service does by default.

    Attributes:
        name: Name of the patch.
        corners: Of its outline [m]: shape (n, 2) in the xy plane of `pose`, or (n, 3) in space.
        pose: Where that plane is.
        thickness: [m].
        young_modulus: [Pa].
        density: [kg/m^3].
        edge: Length of its edges [m].
        tool: Tool that carries it.
    """

    name: str
    corners: NDArray[np.float64]
    pose: Pose
    thickness: float
    young_modulus: float
    density: float
    edge: float
    tool: str


def patch_of(item: Item, scale: float) -> PatchItem:
    """What a `patch` step adds.

    Args:
        item: `{outline: [points]}` with x y of each corner in the plane of a `pose`, or of `at`
            (its origin) and `normal`; or with x y z; `{ellipse: [a, b]}`, the half axes, in place
            of it; and thickness, young_modulus, density, edge, carried_by and name.
        scale: Metres per unit of length of the file.
    """
    keys = item.mapping(KEYS)
    if ("outline" in keys) == ("ellipse" in keys):
        raise item.error("must have either outline or ellipse")
    corners = _ellipse(keys["ellipse"]) if "ellipse" in keys else _outline(keys["outline"])
    placed = {"pose", "at", "normal"} & set(keys)
    if corners.shape[1] == 3 and placed:
        raise keys[min(placed)].error("goes with corners of two numbers: these are in space")
    if corners.shape[1] == 2 and not {"pose", "at"} & placed:
        raise item.error("corners of two numbers need pose, or at and normal")
    if "pose" in placed and len(placed) > 1:
        raise item.error("either pose, or at and normal")

    def number(name: str, unit: float) -> float:
        return keys[name].number(above=0.0) * unit if name in keys else 0.0

    def text(name: str) -> str:
        return keys[name].text() if name in keys else ""

    return PatchItem(
        text("name"), corners * scale, _pose(keys, scale), number("thickness", scale),
        number("young_modulus", 1.0), number("density", 1.0), number("edge", scale),
        text("carried_by"),
    )  # fmt: skip


def _outline(item: Item) -> NDArray[np.float64]:
    points = item.list()
    if len(points) < 3:
        raise item.error(f"must have at least 3 corners, not {len(points)}")
    width = 3 if len(points[0].list()) == 3 else 2
    return np.array([point.vector(width) for point in points])


def _ellipse(item: Item) -> NDArray[np.float64]:
    half = item.vector(2)
    if not (half > 0.0).all():
        raise item.error("must be two half axes greater than 0")
    angle = np.arange(CORNERS_OF_ELLIPSE) * 2.0 * np.pi / CORNERS_OF_ELLIPSE
    return np.asarray(half * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def _pose(keys: dict[str, Item], scale: float) -> Pose:
    if "pose" in keys:
        return pose_of(keys["pose"], scale)
    position = keys["at"].vector(3) * scale if "at" in keys else np.zeros(3)
    rotation = Rotation.identity()
    if "normal" in keys:
        normal = keys["normal"].vector(3)
        if np.linalg.norm(normal) < 1e-9:
            raise keys["normal"].error("must not be zero")
        rotation = _upright_to(normal / np.linalg.norm(normal))
    return Pose(position, rotation.as_quat())


def _upright_to(normal: NDArray[np.float64]) -> Rotation:
    """The smallest rotation that turns z to a direction; half a turn about x to -z."""
    axis = np.cross([0.0, 0.0, 1.0], normal)
    sine, cosine = float(np.linalg.norm(axis)), float(normal[2])
    if sine < 1e-12:
        return Rotation.identity() if cosine > 0.0 else Rotation.from_rotvec([np.pi, 0.0, 0.0])
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine))
