"""Compiling the kernels before the first cut, or loading them from numba's cache."""

from __future__ import annotations

import time

import numpy as np

from cut_service.planner import plan
from cut_service.sweep import Sweep
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block


def warm_up() -> float:
    """Plan and apply two cuts of a small block, the second across the first.

    Returns the seconds it took.
    """
    begin = time.perf_counter()
    mesh = Mesh(block(5, 5, 5))
    lower, upper = mesh.rest[: mesh.node_rows].min(axis=0), mesh.rest[: mesh.node_rows].max(axis=0)
    for axis in range(2):
        low, high = 2 * lower - upper, 2 * upper - lower
        low[axis] = high[axis] = 0.6 * lower[axis] + 0.4 * upper[axis]
        middle = low.copy()
        middle[2] = high[2]
        far = high.copy()
        far[2] = low[2]
        sweep = Sweep.between(np.array([low, middle]), np.array([far, high]))
        mesh.apply(plan(mesh, mesh.rest[: mesh.node_rows], sweep).edit)
    return time.perf_counter() - begin


if __name__ == "__main__":
    warm_up()
