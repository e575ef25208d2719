"""Loops of vertex block descent: sweeps and time steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.mixed_matter import mixed_sums
from tissue_sim.kernels.neo_hookean import Constants, node_response
from tissue_sim.kernels.springs import AHEAD, FAST, SpringArrays
from tissue_sim.kernels.vectors import prefetch
from tissue_sim.kernels.vertex_blocks import VertexBlocks
from tissue_sim.kernels.vertex_descent import (
    Inertia,
    minimise_at,
    solve,
    unfold_at,
)

LINE = 16
"""Numbers in a cache line."""


class Problem(NamedTuple):
    """What is minimised.

    Attributes:
        blocks: Elements by node.
        springs: Which nodes are neighbours.
        inertia: Inertia; zero in statics.
        material: Constants in the kernels' precision.
        exact: The same in double precision.
        exact_w: Scratch in double precision, nine times the most lanes of a node.
    """

    blocks: VertexBlocks
    springs: SpringArrays
    inertia: Inertia
    material: Constants
    exact: Constants
    exact_w: NDArray[np.float64]


class Motion(NamedTuple):
    """What a sweep changes.

    Attributes:
        u: Displacements [m], shape (node_capacity, 3).
        prescribed: Nodes that do not move, shape (node_capacity,).
        last_move: Last move of each node [m], shape (node_capacity, 3).
        seen: Where each prescribed node was last seen [m], shape (node_capacity, 3).
        awake: Whether a node may have to move, shape (node_capacity,).
    """

    u: NDArray[np.floating]
    prescribed: NDArray[np.bool_]
    last_move: NDArray[np.floating]
    seen: NDArray[np.floating]
    awake: NDArray[np.bool_]


class Controls(NamedTuple):
    """How far nodes go, in the kernels' precision.

    Attributes:
        step: Share of Newton's step, below 2.
        tolerance: Largest squared move that counts as rest [m^2].
        trusted: A step d against a force F is known to lower the energy if
            third |d|^3 <= trusted F . d.
        crushed: Share of `VertexBlocks.shear` that a node's stiffness has at least [Pa], unless its
            elements are crushed.
        singular: Smallest det K / tr^3 K that is inverted.
    """

    step: np.floating
    tolerance: np.floating
    trusted: np.floating
    crushed: np.floating
    singular: np.floating


@njit(inline="always")
def _wake_neighbours(i, start, degree, neighbour, awake):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    begin = start[i]
    for place in range(begin, begin + degree[i]):
        awake[neighbour[place]] = True


@njit(inline="always")
def _fetch_ahead(i, lanes, first, corners, gradients, start, neighbour):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Ask for a node's lists: they lie by row, not in the order of the sweep, and come late."""
    prefetch(neighbour, np.int64(start[i]))
    n, begin = np.int64(lanes[i]), np.int64(first[i])
    for at in range(10 * begin, 10 * (begin + n), LINE):
        prefetch(gradients, at)
    for at in range(3 * begin, 3 * (begin + n), LINE):
        prefetch(corners, at)


@njit(inline="always", error_model="numpy", fastmath=FAST)
def node_sums(i, lanes, first, corners, gradients, factor, target, material, u):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Force on a node and its Hessian, those of inertia included, and its folded elements."""
    F0, F1, F2, K00, K01, K02, K11, K12, K22, folded = node_response(
        i, lanes, first, corners, gradients, u, material
    )
    m = factor[i]
    F0 += m * (target[i, 0] - u[i, 0])
    F1 += m * (target[i, 1] - u[i, 1])
    F2 += m * (target[i, 2] - u[i, 2])
    return F0, F1, F2, K00 + m, K01, K02, K11 + m, K12, K22 + m, folded


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def repeat_moves(
    nodes: NDArray[np.uint32], begin: int, end: int, share: np.floating, tiny: np.floating,
    motion: Motion,
) -> None:  # fmt: skip
    """Every node of nodes[begin:end] repeats a share of its last move. Modifies `motion` in place.

    All move before any force is computed: a node that went ahead alone would be pulled back by
    neighbours that have yet to follow.
    """
    u, prescribed, last_move, _, awake = motion
    for place in range(begin, end):
        i = nodes[place]
        if prescribed[i] or not awake[i]:
            continue
        for axis in range(3):
            move = share * last_move[i, axis]
            # Denormal numbers are slow.
            last_move[i, axis] = move if move * move > tiny else tiny - tiny
            u[i, axis] += last_move[i, axis]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def sweep_blocks(
    nodes: NDArray[np.uint32],
    begin: int,
    end: int,
    problem: Problem,
    controls: Controls,
    unfolding: bool,
    motion: Motion,
) -> tuple[np.floating, np.floating, int]:
    """One Gauss-Seidel sweep of 3x3 Newton steps over nodes[begin:end]. Modifies `motion` in place.

    Along a step d = step K^-1 F the node's energy changes by at most -(1 - step/2) F.d + L |d|^3/6,
    L = 3/2 mu sum V |g|^3 being a bound of its third derivative (docs/vertex_block_descent.md);
    fibres add that of `mixed_matter`.
    Where that is not negative, or the elements are crushed so that K says little, the node's
    energy is minimised with care instead: no node's step raises it.

    Returns:
        Largest squared distance a node moved, repeated moves included [m^2]; sum of the new moves
        plus half of the repeated ones, times the latter [m^2]; nodes that needed care.
    """
    # Tuples are taken apart here: in the loop every part would be counted in and out again.
    u, prescribed, last_move, seen, awake = motion
    blocks, springs, inertia, material, exact, exact_w = problem
    first, lanes, _, corners, gradients, shear, third, matter = blocks
    _, start, degree, neighbour, _, _ = springs
    factor, target = inertia
    step, tolerance, trusted, crushed, singular = controls
    zero = material.tiny - material.tiny
    half = material.one / (material.one + material.one)
    fibres = half / material.quarter
    largest = along = zero
    careful = 0
    for place in range(begin, end):
        i = nodes[place]
        if place + AHEAD < end and awake[nodes[place + AHEAD]]:
            _fetch_ahead(nodes[place + AHEAD], lanes, first, corners, gradients, start, neighbour)
        if prescribed[i]:
            if seen[i, 0] != u[i, 0] or seen[i, 1] != u[i, 1] or seen[i, 2] != u[i, 2]:
                seen[i, 0], seen[i, 1], seen[i, 2] = u[i, 0], u[i, 1], u[i, 2]
                _wake_neighbours(i, start, degree, neighbour, awake)
            continue
        if not awake[i] or lanes[i] == 0:
            continue
        F0, F1, F2, K00, K01, K02, K11, K12, K22, folded = node_sums(
            i, lanes[i], first[i], corners, gradients, factor, target, material, u
        )
        trace, T1, T2 = K00 + K11 + K22, zero, zero
        if len(matter) > 0:
            f0, f1, f2, k00, k01, k02, k11, k12, k22, T1, T2 = mixed_sums(
                i, lanes[i], first[i], corners, gradients, matter, u, zero, half
            )
            F0, F1, F2 = F0 + f0, F1 + f1, F2 + f2
            K00, K01, K02 = K00 + k00, K01 + k01, K02 + k02
            K11, K12, K22 = K11 + k11, K12 + k12, K22 + k22
        d0, d1, d2, regular = solve(F0, F1, F2, K00, K01, K02, K11, K12, K22, zero)
        d0, d1, d2 = step * d0, step * d1, step * d2
        squared = d0 * d0 + d1 * d1 + d2 * d2
        stiff = crushed * shear[i] < trace
        stiff = stiff and regular > singular
        length = np.sqrt(squared)
        # The fibres' bound, over the 3/2 mu of the neo-Hookean one.
        bound = third[i] + (T1 + T2 * length) * fibres
        lowers = bound * squared * length <= trusted * (F0 * d0 + F1 * d1 + F2 * d2)
        if unfolding and folded:
            e0, e1, e2 = unfold_at(i, blocks, u, exact_w)
            d0, d1, d2 = zero + e0, zero + e1, zero + e2
            careful += 1
        elif not stiff or (squared > tolerance and not lowers):
            e0, e1, e2 = minimise_at(i, blocks, u, inertia, exact, exact_w)
            d0, d1, d2 = zero + e0, zero + e1, zero + e2
            careful += 1
        v0, v1, v2 = last_move[i, 0], last_move[i, 1], last_move[i, 2]
        # Below 1e-15 m nothing moves: the front of a disturbance would fill with denormal numbers,
        # which are slow.
        if d0 * d0 + d1 * d1 + d2 * d2 > material.tiny:
            along += v0 * (d0 + half * v0) + v1 * (d1 + half * v1) + v2 * (d2 + half * v2)
            u[i, 0] += d0
            u[i, 1] += d1
            u[i, 2] += d2
            v0, v1, v2 = v0 + d0, v1 + d1, v2 + d2
        squared = v0 * v0 + v1 * v1 + v2 * v2
        largest = max(largest, squared)
        if squared > tolerance:
            _wake_neighbours(i, start, degree, neighbour, awake)
        else:
            awake[i] = False
            v0 = v1 = v2 = zero
        last_move[i, 0], last_move[i, 1], last_move[i, 2] = v0, v1, v2
    return largest, along, careful


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def begin_time_step(
    rows: int,
    problem: Problem,
    keep: np.floating,
    tolerance: np.floating,
    motion: Motion,
    previous: NDArray[np.floating],
) -> None:
    """Put every free node where it goes without forces: u + keep (u - previous).

    Modifies `motion`, `previous` (which becomes the present displacement) and the target of
    `problem.inertia` in place. Moves of no more than the squared distance `tolerance` end there:
    rounding would keep them for ever. A prescribed node gets no velocity.
    """
    u, prescribed, last_move, _, awake = motion
    _, start, degree, neighbour, _, _ = problem.springs
    target = problem.inertia.target
    for i in range(rows):
        v0 = keep * (u[i, 0] - previous[i, 0])
        v1 = keep * (u[i, 1] - previous[i, 1])
        v2 = keep * (u[i, 2] - previous[i, 2])
        previous[i, 0], previous[i, 1], previous[i, 2] = u[i, 0], u[i, 1], u[i, 2]
        if not prescribed[i] and v0 * v0 + v1 * v1 + v2 * v2 > tolerance:
            u[i, 0] += v0
            u[i, 1] += v1
            u[i, 2] += v2
            awake[i] = True
            _wake_neighbours(i, start, degree, neighbour, awake)
        target[i, 0], target[i, 1], target[i, 2] = u[i, 0], u[i, 1], u[i, 2]
        for axis in range(3):
            last_move[i, axis] = keep - keep
