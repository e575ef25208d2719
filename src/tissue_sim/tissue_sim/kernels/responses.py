"""Loops over the responses of an organ to the motions of what is held."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def project(
    held: NDArray[np.int32],
    u: NDArray[np.floating],
    origin: NDArray[np.float64],
    patterns: NDArray[np.float64],
    used: int,
    shares: NDArray[np.float64],
    left: NDArray[np.float64],
) -> tuple[float, bool]:
    """Write the motion of held nodes as a sum of orthonormal patterns and of what is left.

    Args:
        held: Rows of the held nodes.
        u: Displacements [m].
        origin: Displacements that count as no motion [m], shape (len(held), 3).
        patterns: Orthonormal motions, shape (patterns, len(held), 3).
        used: How many there are.
        shares: Share of each [m]; written.
        left: What is left [m], shape (len(held), 3); written.

    Returns:
        The largest squared motion left of a node [m^2], and whether any share has changed.
    """
    for place in range(len(held)):
        for axis in range(3):
            left[place, axis] = np.float64(u[held[place], axis]) - origin[place, axis]
    changed = False
    for k in range(used):
        share = 0.0
        for place in range(len(held)):
            for axis in range(3):
                share += patterns[k, place, axis] * left[place, axis]
        for place in range(len(held)):
            for axis in range(3):
                left[place, axis] -= share * patterns[k, place, axis]
        changed = changed or share != shares[k]
        shares[k] = share
    largest = 0.0
    for place in range(len(held)):
        squared = left[place, 0] ** 2 + left[place, 1] ** 2 + left[place, 2] ** 2
        largest = max(largest, squared)
    return largest, changed


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_responses(
    count: int,
    base: NDArray[np.floating],
    shares: NDArray[np.float64],
    responses: NDArray[np.floating],
    used: int,
    out: NDArray[np.floating],
) -> None:
    """Out = base + sum_k shares_k responses_k. Writes `out`, shape (node_capacity, 3)."""
    for i in range(count):
        s0, s1, s2 = base[i, 0], base[i, 1], base[i, 2]
        for k in range(used):
            share = base.dtype.type(shares[k])
            s0 += share * responses[k, i, 0]
            s1 += share * responses[k, i, 1]
            s2 += share * responses[k, i, 2]
        out[i, 0], out[i, 1], out[i, 2] = s0, s1, s2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_share(
    count: int,
    prescribed: NDArray[np.bool_],
    base: NDArray[np.floating],
    share: float,
    x: NDArray[np.floating],
    u: NDArray[np.floating],
) -> None:
    """U = base + share x in free nodes. Writes `u`."""
    s = x.dtype.type(share)
    for i in range(count):
        if not prescribed[i]:
            for k in range(3):
                u[i, k] = base[i, k] + s * x[i, k]
