"""The outline of a patch between two points of the tissue."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tool_input.patch_items import CORNERS_OF_ELLIPSE

Vec3 = NDArray[np.float64]

ELLIPSE, RECTANGLE = "ellipse", "rectangle"
_SMALLEST = 1e-3
"""A shorter drag is a slip of the hand, as a share of the tissue's extent."""


def outline(
    shape: str,
    first: Vec3,
    second: Vec3,
    normal: Vec3,
    width: float,
    tissue: NDArray[np.floating],
    above: float,
) -> NDArray[np.float64]:
    """Corners of a flat patch that lies on tissue from one point to another.

    Args:
        shape: ELLIPSE or RECTANGLE.
        first: Middle of one end [m], shape (3,).
        second: Middle of the other end [m], shape (3,).
        normal: Direction away from the tissue, shape (3,).
        width: Of the patch across that, as a share of its length.
        tissue: Points of the tissue's surface [m], shape (n, 3). The patch is raised to the highest
            of those under it, since it would lie in the tissue where that is vaulted.
        above: How far it is raised above that [m]: half of its thickness.

    Returns:
        Shape (k, 3), counterclockwise about the normal.

    Raises:
        ValueError: The points are next to each other.
    """
    long = second - first
    half = 0.5 * float(np.linalg.norm(long))
    if half <= _SMALLEST * float(np.ptp(tissue, axis=0).max()):
        raise ValueError("a patch needs a drag from one side of it to the other; drag further")
    x = long / (2.0 * half)
    across = normal - (normal @ x) * x
    if np.linalg.norm(across) < 1e-6 * np.linalg.norm(normal):
        across = np.cross(x, np.eye(3)[np.argmin(np.abs(x))])
    z = across / np.linalg.norm(across)
    axes = np.stack([x, np.cross(z, x), z])
    sides = half * np.array([1.0, width])
    local = (tissue - 0.5 * (first + second)) @ axes.T
    flat = local[:, :2] / sides
    near = np.abs(local[:, 2]) < half
    if shape == ELLIPSE:
        angle = np.arange(CORNERS_OF_ELLIPSE) * (2.0 * np.pi / CORNERS_OF_ELLIPSE)
        corners = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        under = near & ((flat**2).sum(axis=1) <= 1.0)
    else:
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        under = near & (np.abs(flat) <= 1.0).all(axis=1)
    height = float(local[under, 2].max(initial=0.0)) + above
    return 0.5 * (first + second) + height * z + (corners * sides) @ axes[:2]
