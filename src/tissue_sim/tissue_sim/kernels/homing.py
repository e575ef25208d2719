"""A loop that takes nodes towards their rest positions."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def draw_home(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    anchored: NDArray[np.bool_],
    keep: np.floating,
    tiny: np.floating,
    u: NDArray[np.floating],
    last_move: NDArray[np.floating],
) -> None:
    """Leave the anchored nodes of nodes[begin:end] a share of their displacement and last move.

    Args:
        nodes: Rows of nodes.
        begin: First place.
        end: One past the last.
        anchored: Nodes that are taken along, shape (node_capacity,).
        keep: The share.
        tiny: What is below the square root of it becomes zero [m^2].
        u: Displacements [m], shape (node_capacity, 3); modified in place.
        last_move: Last moves [m], same shape; modified in place.
    """
    for place in range(begin, end):
        i = nodes[place]
        if not anchored[i]:
            continue
        for axis in range(3):
            value = keep * u[i, axis]
            u[i, axis] = value if value * value > tiny else tiny - tiny
            last_move[i, axis] *= keep
