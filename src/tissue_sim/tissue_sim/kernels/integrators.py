"""Loops over nodes of the integrators that need the forces of all nodes first.

Symbols: u displacement [m], p = h v the move of a time step at the present velocity v [m],
A(u) = h^2 F(u)/m the move that the forces add to it [m], d the damping weight. Counted in time
steps, the equation of motion is

    u' = p,    p' = A(u) - d p.

Prescribed nodes and nodes without springs stay and have p = 0.

Tuples are taken apart before a loop: in it every part would be counted in and out again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.kernels.springs import FAST


class Nodes(NamedTuple):
    """What a time step needs to know of the nodes.

    Attributes:
        rows: Nodes [0, rows) take part.
        degree: Springs at each node, shape (node_capacity,), uint32.
        prescribed: Nodes that do not move, shape (node_capacity,).
        scale: h^2 / m per node [m/N], shape (node_capacity,).
        damping: d.
        tiny: Squared length [m^2] that counts as none.
    """

    rows: int
    degree: NDArray[np.uint32]
    prescribed: NDArray[np.bool_]
    scale: NDArray[np.floating]
    damping: np.floating
    tiny: np.floating


class Stages(NamedTuple):
    """What a Runge-Kutta step works with, shape (node_capacity, 3) each [m].

    Attributes:
        u: Displacements of the stage, at which forces are computed.
        p: Moves of the stage.
        sum_u: Weighted sum of the slopes of u so far.
        sum_p: Weighted sum of the slopes of p so far.
    """

    u: NDArray[np.floating]
    p: NDArray[np.floating]
    sum_u: NDArray[np.floating]
    sum_p: NDArray[np.floating]


@njit(cache=True, nogil=True, error_model="numpy")
def begin_stages(
    nodes: Nodes,
    u: NDArray[np.floating],
    previous: NDArray[np.floating],
    p: NDArray[np.floating],
    stages: Stages,
) -> None:
    """Take the state as the first stage. Modifies `p` and `stages`.

    `previous` says where nodes come from; `p` is the same to more digits as long as nobody else has
    written `u` or `previous`. No fastmath: the comparison is of bits.
    """
    rows, degree, prescribed, _, _, tiny = nodes
    stage_u, stage_p, sum_u, sum_p = stages
    none = tiny - tiny
    for i in range(rows):
        stays = prescribed[i] or degree[i] == 0
        known = True
        for axis in range(3):
            known &= u[i, axis] - p[i, axis] == previous[i, axis]
        for axis in range(3):
            if stays:
                p[i, axis] = none
            elif not known:
                p[i, axis] = u[i, axis] - previous[i, axis]
            stage_u[i, axis] = u[i, axis]
            stage_p[i, axis] = p[i, axis]
            sum_u[i, axis] = sum_p[i, axis] = none


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def add_stage(
    nodes: Nodes,
    F: NDArray[np.floating],
    weight: np.floating,
    ahead: np.floating,
    u: NDArray[np.floating],
    p: NDArray[np.floating],
    stages: Stages,
) -> None:
    """Add the slopes of a stage to the sums and go `ahead` along them to the next stage.

    Modifies `stages` in place.
    """
    rows, degree, prescribed, scale, damping, _ = nodes
    stage_u, stage_p, sum_u, sum_p = stages
    for i in range(rows):
        if prescribed[i] or degree[i] == 0:
            continue
        for axis in range(3):
            slope_u = stage_p[i, axis]
            slope_p = scale[i] * F[i, axis] - damping * slope_u
            sum_u[i, axis] += weight * slope_u
            sum_p[i, axis] += weight * slope_p
            stage_u[i, axis] = u[i, axis] + ahead * slope_u
            stage_p[i, axis] = p[i, axis] + ahead * slope_p


@njit(cache=True, nogil=True, error_model="numpy")
def end_stages(
    nodes: Nodes,
    stages: Stages,
    u: NDArray[np.floating],
    previous: NDArray[np.floating],
    p: NDArray[np.floating],
) -> None:
    """Go on by the sums; previous = u - p. Modifies `u`, `previous` and `p` in place.

    Below 1e-15 m displacements and moves become 0: denormal numbers are slow.
    """
    tiny, (_, _, sum_u, sum_p) = nodes.tiny, stages
    none = tiny - tiny
    for i in range(nodes.rows):
        for axis in range(3):
            move = p[i, axis] + sum_p[i, axis]
            place = u[i, axis] + sum_u[i, axis]
            p[i, axis] = move if move * move > tiny else none
            u[i, axis] = place if place * place > tiny else none
            previous[i, axis] = u[i, axis] - p[i, axis]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def verlet_move(
    nodes: Nodes,
    sticks: np.floating,
    F: NDArray[np.floating],
    u: NDArray[np.floating],
    previous: NDArray[np.floating],
) -> None:
    """One Verlet step u(t+h) = u + (1 - d) (u - u(t-h)) + h^2 F/m.

    Modifies `u` and `previous` in place. A node that moves, without forces, by less than the share
    `sticks` of its displacement stops: rounding would keep the last bit of its velocity for ever.
    Below 1e-15 m displacements become 0: the front of a wave would fill with denormal numbers,
    which are slow.
    """
    rows, degree, prescribed, scale, damping, tiny = nodes
    none = tiny - tiny
    keep = none + np.float32(1.0) - damping
    for i in range(rows):
        weight, stays = scale[i], prescribed[i] | (degree[i] == 0)
        for axis in range(3):  # Without a branch: how a node moves is hard to foresee.
            now = u[i, axis]
            move = keep * (now - previous[i, axis])
            move = none if abs(move) < sticks * abs(now) else move
            following = now + (move + weight * F[i, axis])
            following = following if following * following > tiny else none
            previous[i, axis] = now
            u[i, axis] = now if stays else following
