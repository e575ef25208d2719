"""Forces and energy of vertex block descent."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.block_sweeps import Problem, node_sums
from tissue_sim.kernels.mixed_matter import mixed_energy, mixed_sums
from tissue_sim.kernels.neo_hookean import node_response
from tissue_sim.kernels.springs import FAST
from tissue_sim.kernels.vertex_descent import gather, node_energy


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def block_forces(
    nodes: NDArray[np.int32], problem: Problem, u: NDArray[np.floating], out: NDArray[np.float64]
) -> None:
    """Internal elastic forces on nodes [N]. Writes `out`, shape (len(nodes), 3)."""
    blocks, _, _, material, _, _ = problem
    first, lanes, _, corners, gradients, _, _, matter = blocks
    zero, half = material.tiny - material.tiny, material.one / (material.one + material.one)
    for place in range(len(nodes)):
        i = nodes[place]
        F = node_response(i, lanes[i], first[i], corners, gradients, u, material)
        out[place, 0], out[place, 1], out[place, 2] = F[0], F[1], F[2]
        if len(matter) > 0:
            M = mixed_sums(i, lanes[i], first[i], corners, gradients, matter, u, zero, half)
            out[place, 0] += M[0]
            out[place, 1] += M[1]
            out[place, 2] += M[2]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def largest_block_force(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    problem: Problem,
    prescribed: NDArray[np.bool_],
    u: NDArray[np.floating],
) -> tuple[np.floating, np.floating]:
    """Largest squared F_i [N^2] and squared 3 F_i / tr K_i [m^2] of free nodes in nodes[begin:end].

    Forces are those of the energy that is minimised, inertia included.
    """
    blocks, _, inertia, material, _, _ = problem
    first, lanes, _, corners, gradients, _, _, matter = blocks
    factor, target = inertia
    zero, half = material.tiny - material.tiny, material.one / (material.one + material.one)
    largest = largest_step = zero
    three = material.four - material.one
    for place in range(begin, end):
        i = nodes[place]
        if not prescribed[i] and lanes[i] > 0:
            F0, F1, F2, K00, _, _, K11, _, K22, _ = node_sums(
                i, lanes[i], first[i], corners, gradients, factor, target, material, u
            )
            if len(matter) > 0:
                f0, f1, f2, k00, _, _, k11, _, k22, _, _ = mixed_sums(
                    i, lanes[i], first[i], corners, gradients, matter, u, zero, half
                )
                F0, F1, F2 = F0 + f0, F1 + f1, F2 + f2
                K00, K11, K22 = K00 + k00, K11 + k11, K22 + k22
            squared = F0 * F0 + F1 * F1 + F2 * F2
            largest = max(largest, squared)
            if squared > zero:
                stiffness = (K00 + K11 + K22) / three
                largest_step = max(largest_step, squared / (stiffness * stiffness))
    return largest, largest_step


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def total_energy(rows: int, problem: Problem, u: NDArray[np.floating]) -> float:
    """Elastic energy of all elements [J]: a quarter of the sum over nodes of their elements."""
    blocks, _, _, _, exact, w = problem
    first, lanes, _, corners, gradients, _, _, matter = blocks
    total = 0.0
    for i in range(rows):
        n, start = np.int64(lanes[i]), np.int64(first[i])
        gather(n, 3 * start, corners, u, i, w)
        total += node_energy(n, 10 * start, gradients, w, 0.0, 0.0, 0.0, exact)
        if len(matter) > 0:
            total += mixed_energy(n, start, gradients, matter, w, 0.0, 0.0, 0.0)
    return total / 4.0
