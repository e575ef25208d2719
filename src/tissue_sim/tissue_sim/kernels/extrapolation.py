"""Loops that carry nodes beyond where a sweep has put them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST, SpringArrays


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def remember(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    u: NDArray[np.floating],
    before: NDArray[np.floating],
    older: NDArray[np.floating],
) -> None:
    """Keep where nodes[begin:end] are, and where they were: older <- before <- u, in place."""
    for place in range(begin, end):
        i = nodes[place]
        for axis in range(3):
            older[i, axis] = before[i, axis]
            before[i, axis] = u[i, axis]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def compare(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    prescribed: NDArray[np.bool_],
    share: np.floating,
    older: NDArray[np.floating],
    before: NDArray[np.floating],
    u: NDArray[np.floating],
) -> tuple[float, float, float]:
    """Judge a sweep that has moved free nodes by d = u - before after v = before - older.

    Args:
        nodes: Rows of nodes.
        begin: First place.
        end: One past the last.
        prescribed: Nodes that do not move, shape (node_capacity,).
        share: Share of v that is part of d already, because the nodes repeated it first.
        older: Displacements two sweeps ago [m], shape (node_capacity, 3).
        before: Displacements before the sweep [m], same shape.
        u: Displacements now [m], same shape.

    Returns:
        Sum of |d - share v|^2 [m^2]; sum of (d - share v / 2) . v [m^2]; sum of |v|^2 over nodes
        that are prescribed [m^2]: how far they were moved between the sweeps.
    """
    residual = along = shifted = 0.0
    half = share / (u.dtype.type(1) + u.dtype.type(1))
    for place in range(begin, end):
        i = nodes[place]
        for axis in range(3):
            d = u[i, axis] - before[i, axis]
            v = before[i, axis] - older[i, axis]
            if prescribed[i]:
                shifted += v * v
                continue
            new = d - share * v
            residual += new * new
            along += (d - half * v) * v
    return residual, along, shifted


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def extrapolate(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    prescribed: NDArray[np.bool_],
    omega: np.floating,
    tiny: np.floating,
    older: NDArray[np.floating],
    before: NDArray[np.floating],
    u: NDArray[np.floating],
) -> float:
    """Carry free nodes on: u <- older + omega (u - older), in place.

    Returns:
        Largest squared distance from `before` [m^2].
    """
    largest = tiny - tiny
    for place in range(begin, end):
        i = nodes[place]
        if prescribed[i]:
            continue
        squared = tiny - tiny
        for axis in range(3):
            d = u[i, axis] - before[i, axis]
            v = before[i, axis] - older[i, axis]
            move = omega * (d + v) - v
            u[i, axis] = before[i, axis] + move
            squared += move * move
        largest = max(largest, squared)
    return float(largest)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def wake_around_moved(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    tolerance: np.floating,
    before: NDArray[np.floating],
    u: NDArray[np.floating],
    springs: SpringArrays,
    awake: NDArray[np.bool_],
) -> None:
    """Wake nodes of nodes[begin:end] that moved farther than sqrt(tolerance), and their neighbours.

    Modifies `awake`, shape (node_capacity,), in place.
    """
    for place in range(begin, end):
        i = nodes[place]
        d0, d1, d2 = u[i, 0] - before[i, 0], u[i, 1] - before[i, 1], u[i, 2] - before[i, 2]
        if d0 * d0 + d1 * d1 + d2 * d2 <= tolerance:
            continue
        awake[i] = True
        first = springs.start[i]
        for spring in range(first, first + springs.degree[i]):
            awake[springs.neighbour[spring]] = True


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_difference(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    prescribed: NDArray[np.bool_],
    before: NDArray[np.floating],
    after: NDArray[np.floating],
    u: NDArray[np.floating],
) -> None:
    """Move free nodes of nodes[begin:end] by after - before. Modifies `u` in place."""
    for place in range(begin, end):
        i = nodes[place]
        if not prescribed[i]:
            for axis in range(3):
                u[i, axis] += after[i, axis] - before[i, axis]
