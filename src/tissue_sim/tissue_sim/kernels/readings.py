"""Loops over elements that add up what they tell at their nodes."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.strain import STRAIN_FAST, left_cauchy_green, principal_stretches

Reals = NDArray[np.float64]
Rows = NDArray[np.int32]

MISES, LARGEST, SMALLEST, STRAIN = range(4)
"""Columns of what is known of each element: three stresses [Pa] and the largest strain."""


@njit(cache=True, nogil=True, error_model="numpy", fastmath=STRAIN_FAST)
def add_up_tetrahedra(
    rest: Reals,
    places: NDArray[np.floating],
    tets: Rows,
    alive: NDArray[np.bool_],
    kinds: NDArray[np.uint8],
    lame: Reals,
    sums: Reals,
    weights: Reals,
) -> None:
    """Add stress and strain of tetrahedra, times their volumes, at their nodes.

    Args:
        rest: Rest positions [m], shape (n, 3).
        places: Current positions [m], shape (n, 3).
        tets: Nodes of each element, shape (e, 4).
        alive: Elements that there are, shape (e,).
        kinds: Row of `lame` of each, shape (e,) at least.
        lame: Lame's constants lambda and mu [Pa], shape (kinds, 2).
        sums: Sums at each node, by column; added to, shape (n, 4).
        weights: Six volumes of the elements at each node [m^3]; added to, shape (n,).
    """
    for e in range(tets.shape[0]):
        if not alive[e]:
            continue
        i, j, k, m = tets[e, 0], tets[e, 1], tets[e, 2], tets[e, 3]
        xx, yy, zz, yz, xz, xy, turned, weight = left_cauchy_green(rest, places, i, j, k, m)
        s0, s1, s2 = principal_stretches(xx, yy, zz, yz, xz, xy, turned)
        first, twice = lame[kinds[e], 0], 2.0 * lame[kinds[e], 1]
        volumetric = first * (s0 + s1 + s2 - 3.0)
        a, b, c = s0 - s1, s1 - s2, s0 - s2
        mises = twice * np.sqrt(0.5 * (a * a + b * b + c * c))
        largest, smallest = twice * (s0 - 1.0) + volumetric, twice * (s2 - 1.0) + volumetric
        for corner in range(4):
            node = tets[e, corner]
            weights[node] += weight
            sums[node, MISES] += weight * mises
            sums[node, LARGEST] += weight * largest
            sums[node, SMALLEST] += weight * smallest
            sums[node, STRAIN] += weight * (s0 - 1.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=STRAIN_FAST)
def add_up_edges(
    rest: Reals,
    places: NDArray[np.floating],
    items: Rows,
    alive: NDArray[np.bool_],
    volumes: Reals,
    sums: Reals,
    weights: Reals,
) -> None:
    """Add how much springs are stretched or squeezed, times their tissue, at their ends.

    Args:
        rest: Rest positions [m], shape (n, 3).
        places: Current positions [m], shape (n, 3).
        items: Nodes of each element, every pair of which a spring joins; -1: none, shape (e, 4).
        alive: Elements that there are, shape (e,).
        volumes: Tissue that each stands for [m^3], shape (e,).
        sums: Sums of |l / l0 - 1| times volume at each node; added to, shape (n,).
        weights: Sums of volumes; added to, shape (n,).
    """
    for e in range(items.shape[0]):
        if not alive[e]:
            continue
        weight = volumes[e]
        for one in range(3):
            for other in range(one + 1, 4):
                a, b = items[e, one], items[e, other]
                if b < 0:
                    break
                before, now = 0.0, 0.0
                for axis in range(3):
                    before += (rest[b, axis] - rest[a, axis]) ** 2
                    now += (places[b, axis] - places[a, axis]) ** 2
                strain = weight * abs(np.sqrt(now / before) - 1.0)
                sums[a] += strain
                sums[b] += strain
                weights[a] += weight
                weights[b] += weight
