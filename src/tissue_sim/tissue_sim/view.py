"""What can be seen from a place: rays against triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def share_in_view(
    eye: NDArray[np.float64],
    places: NDArray[np.float64],
    corners: NDArray[np.float64],
    shorter: float = 0.0,
) -> float:
    """Share of some places that no triangle hides.

    By the test of Moeller and Trumbore (1997), doi 10.1080/10867651.1997.10487468.

    Args:
        eye: Where they are looked at from [m], shape (3,).
        places: The places [m], shape (n, 3).
        corners: Corners of the triangles [m], shape (t, 3, 3).
        shorter: What is nearer to a place than this [m] does not hide it.
    """
    first = corners[:, 0]
    one, two = corners[:, 1] - first, corners[:, 2] - first
    seen = 0
    for place in places:
        way = place - eye
        length = float(np.linalg.norm(way))
        way = way / length
        across = np.cross(way, two)
        area = np.einsum("ij,ij->i", one, across)
        # Triangles seen edge on hide nothing.
        flat = np.abs(area) < 1e-30
        scale = 1.0 / np.where(flat, 1.0, area)
        away = eye - first
        u = np.einsum("ij,ij->i", away, across) * scale
        turn = np.cross(away, one)
        v = turn @ way * scale
        at = np.einsum("ij,ij->i", two, turn) * scale
        inside = ~flat & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
        seen += not (inside & (at > 0.0) & (at < length - shorter)).any()
    return seen / len(places)
