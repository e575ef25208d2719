"""Loops over nodes of the integrators that need the forces of all nodes first.

Symbols: u displacement [m], p = h v the move of a time step at the present velocity v [m],
A(u) = h^2 F(u)/m the move that the forces add to it [m], d the damping weight. Counted in time
steps, the equation of motion is

    u' = p,    p' = A(u) - d p.

Prescribed nodes and nodes without springs stay and have p = 0.
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


@njit(inline="always", error_model="numpy")
def _stays(nodes, i):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    return nodes.prescribed[i] or nodes.degree[i] == 0


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
    for i in range(nodes.rows):
        stays = _stays(nodes, i)
        known = True
        for axis in range(3):
            known &= u[i, axis] - p[i, axis] == previous[i, axis]
        for axis in range(3):
            if stays:
                p[i, axis] = nodes.tiny - nodes.tiny
            elif not known:
                p[i, axis] = u[i, axis] - previous[i, axis]
            stages.u[i, axis] = u[i, axis]
            stages.p[i, axis] = p[i, axis]
            stages.sum_u[i, axis] = stages.sum_p[i, axis] = nodes.tiny - nodes.tiny


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
    for i in range(nodes.rows):
        if _stays(nodes, i):
            continue
        for axis in range(3):
            slope_u = stages.p[i, axis]
            slope_p = nodes.scale[i] * F[i, axis] - nodes.damping * slope_u
            stages.sum_u[i, axis] += weight * slope_u
            stages.sum_p[i, axis] += weight * slope_p
            stages.u[i, axis] = u[i, axis] + ahead * slope_u
            stages.p[i, axis] = p[i, axis] + ahead * slope_p


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
    none = nodes.tiny - nodes.tiny
    for i in range(nodes.rows):
        for axis in range(3):
            move = p[i, axis] + stages.sum_p[i, axis]
            place = u[i, axis] + stages.sum_u[i, axis]
            p[i, axis] = move if move * move > nodes.tiny else none
            u[i, axis] = place if place * place > nodes.tiny else none
            previous[i, axis] = u[i, axis] - p[i, axis]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def verlet_move(
    nodes: Nodes,
    sticks: np.floating,
    F: NDArray[np.floating],
    u: NDArray[np.floating],
    previous: NDArray[np.floating],
) -> None:
    """The step of `kernels.springs.verlet_step` for forces computed before.

    Modifies `u` and `previous` in place.
    """
    none = nodes.tiny - nodes.tiny
    for i in range(nodes.rows):
        stays = _stays(nodes, i)
        for axis in range(3):
            now, move = u[i, axis], none
            if not stays:
                move = (now - previous[i, axis]) - nodes.damping * (now - previous[i, axis])
                if abs(move) < sticks * abs(now):
                    move = none
                move += nodes.scale[i] * F[i, axis]
            following = now + move
            previous[i, axis] = now
            u[i, axis] = following if following * following > nodes.tiny else none
