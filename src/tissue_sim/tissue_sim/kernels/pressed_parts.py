"""Wrench, stiffness and damping of the nodes that a probe presses."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Reals = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def add_pressed(
    arms: Reals,
    normal: Reals,
    depth: Reals,
    slip: Reals,
    area: Reals,
    numbers: tuple[float, float, float],
    velocity: Reals,
    slides_at: float,
    wrench: Reals,
    stiffness: Reals,
    damping: Reals,
) -> None:
    """Add up J^T M J over the nodes, J = [1, -[r]x] being the motion of the probe at each.

    Args:
        arms: From the tip to each node [m], shape (k, 3).
        normal: Out of the probe, shape (k, 3).
        depth: [m], shape (k,).
        slip: Along the probe since the anchor [m], shape (k, 3).
        area: Surface of each [m^2], shape (k,).
        numbers: kappa [Pa/m], delta [Pa s/m] and Coulomb's coefficient.
        velocity: Of the probe [m/s], [rad/s], shape (6,).
        slides_at: Least speed that friction is divided by [m/s].
        wrench: Added to, shape (6,).
        stiffness: Added to, shape (6, 6).
        damping: Added to, shape (6, 6).
    """
    kappa, delta, coefficient = numbers
    J = np.zeros((3, 6))
    J[0, 0] = J[1, 1] = J[2, 2] = 1.0
    K, D = np.empty((3, 3)), np.empty((3, 3))
    force, along = np.empty(3), np.empty(3)
    for node in range(len(depth)):
        r, n, s = arms[node], normal[node], slip[node]
        J[0, 4], J[0, 5], J[1, 3], J[1, 5], J[2, 3], J[2, 4] = r[2], -r[1], -r[2], r[0], r[1], -r[0]
        pressing = kappa * area[node]
        push = pressing * depth[node]
        sticks = pressing * math.sqrt(s[0] ** 2 + s[1] ** 2 + s[2] ** 2) < coefficient * push
        speed, out = 0.0, 0.0
        for a in range(3):
            along[a] = 0.0
            for b in range(6):
                along[a] += J[a, b] * velocity[b]
            out += along[a] * n[a]
        for a in range(3):
            speed += (along[a] - out * n[a]) ** 2
        held = pressing if sticks else 0.0
        rubbing = 0.0 if sticks else coefficient * push / max(math.sqrt(speed), slides_at)
        for a in range(3):
            force[a] = -push * n[a] + held * s[a]
            for b in range(3):
                outward = n[a] * n[b]
                across = (1.0 if a == b else 0.0) - outward
                K[a, b] = pressing * outward + held * across
                D[a, b] = delta * area[node] * outward + rubbing * across
        for i in range(6):
            for a in range(3):
                wrench[i] += J[a, i] * force[a]
                for b in range(3):
                    for j in range(6):
                        stiffness[i, j] += J[a, i] * K[a, b] * J[b, j]
                        damping[i, j] += J[a, i] * D[a, b] * J[b, j]
