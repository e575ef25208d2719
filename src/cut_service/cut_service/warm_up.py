"""Compiling the kernels before the first cut, or loading them from numba's cache."""

from __future__ import annotations

import time

import numpy as np

from cut_service.planner import METHODS, SHEET_METHOD, plan
from cut_service.sweep import Sweep
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.geometry.sheet_geometry import CONNECTED, SheetSettings, surface_of, with_sheet


def warm_up() -> float:
    """Plan and apply two crossing cuts of a small block by every method, and of its surface.

    Returns the seconds it took.
    """
    begin = time.perf_counter()
    tissue = block(6, 5, 5)
    sheet = with_sheet(surface_of(tissue), SheetSettings(CONNECTED), [])
    for raw, method in (*((tissue, method) for method in METHODS), (sheet, SHEET_METHOD)):
        mesh = Mesh(raw)
        rest = mesh.rest[: mesh.node_rows]
        lower, upper = rest.min(axis=0), rest.max(axis=0)
        for axis in range(2):
            low, high = 2 * lower - upper, 2 * upper - lower
            low[axis] = high[axis] = 0.6 * lower[axis] + 0.4 * upper[axis]
            middle = low.copy()
            middle[2] = high[2]
            far = high.copy()
            far[2] = low[2]
            sweep = Sweep.between(np.array([low, middle]), np.array([far, high]))
            mesh.apply(plan(mesh, mesh.rest[: mesh.node_rows], sweep, method).edit)
    return time.perf_counter() - begin


if __name__ == "__main__":
    warm_up()
