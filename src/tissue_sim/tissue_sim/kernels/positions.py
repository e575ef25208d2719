"""Positions from rest and displacement, checked on the way."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


# No fastmath: it would let the compiler drop the test that finds a nan.
@njit(cache=True, nogil=True, error_model="numpy")
def place_nodes(
    rest: NDArray[np.float64],
    displacement: NDArray[np.floating],
    limit: float,
    positions: NDArray[np.float32],
) -> int:
    """Write positions and count the nodes that are not finite or farther from rest than `limit`.

    Args:
        rest: Rest positions [m], shape (n, 3).
        displacement: Displacements from rest [m], shape (n, 3).
        limit: Largest displacement along an axis that is believed [m].
        positions: Result [m], shape (n, 3).
    """
    bad = 0
    for node in range(rest.shape[0]):
        good = True
        for axis in range(3):
            u = displacement[node, axis]
            positions[node, axis] = np.float32(rest[node, axis] + u)
            if not abs(u) <= limit:
                good = False
        if not good:
            bad += 1
    return bad
