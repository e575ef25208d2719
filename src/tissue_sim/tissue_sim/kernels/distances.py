"""How far two trajectories are apart, without arrays in between."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def mean_distance(
    ours: NDArray[np.floating], theirs: NDArray[np.floating], rows: NDArray[np.intp]
) -> float:
    """Mean over frames and rows of |ours - theirs|, summed in double precision.

    Args:
        ours: Places or displacements by frame and row [m], shape (frames, n, 3).
        theirs: The same of the other one.
        rows: Rows that count, shape (m,).
    """
    total = 0.0
    for frame in range(len(ours)):
        frame_total = 0.0
        for row in rows:
            x = np.float64(ours[frame, row, 0]) - np.float64(theirs[frame, row, 0])
            y = np.float64(ours[frame, row, 1]) - np.float64(theirs[frame, row, 1])
            z = np.float64(ours[frame, row, 2]) - np.float64(theirs[frame, row, 2])
            frame_total += math.sqrt(x * x + y * y + z * z)
        total += frame_total / len(rows)
    return total / len(ours)
