"""Compiling the kernels before the first cut, or loading them from numba's cache."""

from __future__ import annotations

import time

import numpy as np

from cut_service.burning import Burns, BurnSettings, Touch, plan_burn
from cut_service.planner import METHODS, SHEET_METHOD, plan
from cut_service.sweep import Sweep
from cut_service.tearing import TearSettings, plan_tear
from cut_service.unswept import work_without_sweep
from tissue_sim.elastic.material_field import MaterialField
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.stress import element_material
from tissue_sim.geometry.closure import Pieces, measure
from tissue_sim.geometry.holes import Surface, name_hole
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
            # Aslant, so that nodes are snapped far and there are degeneracies to remove.
            low[axis] = 0.8 * lower[axis] + 0.2 * upper[axis]
            high[axis] = 0.4 * lower[axis] + 0.6 * upper[axis]
            middle = low.copy()
            middle[2] = high[2]
            far = high.copy()
            far[2] = low[2]
            sweep = Sweep.between(np.array([low, middle]), np.array([far, high]))
            mesh.apply(plan(mesh, mesh.rest[: mesh.node_rows], sweep, method).edit)
    _tear_and_burn(Mesh(tissue))
    _measure_a_hole(Mesh(tissue))
    return time.perf_counter() - begin


def _tear_and_burn(mesh: Mesh) -> None:
    """Tear a block that is pulled along x, and burn a piece of it."""
    rest = mesh.rest[: mesh.node_rows]
    pulled = rest * [1.5, 1.0, 1.0]
    material = element_material(MaterialField(mesh, Material()))
    work = work_without_sweep(mesh, pulled)
    tear = plan_tear(work, material, TearSettings(threshold=1.0))
    if tear.edit is not None:
        mesh.apply(tear.edit)
    places = mesh.rest[: mesh.node_rows]
    middle = places.mean(axis=0)
    size = float(np.ptp(places, axis=0).max())
    touch = Touch(middle, 0.3 * size, 1e6)
    gone = Burns().heat(mesh, places, [touch], BurnSettings(energy_density=1.0))
    mesh.apply(plan_burn(work_without_sweep(mesh, places), gone))


def _measure_a_hole(mesh: Mesh) -> None:
    """Name a face of a block a hole, and measure how a triangle closes it."""
    places = mesh.rest[: mesh.node_rows]
    low, high = places.min(axis=0), places.max(axis=0)
    corners = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    hole = name_hole(mesh, places, "face", low + corners * (high - low))
    loop = hole.loop(mesh, places)
    triangle = Pieces(loop[None, :3].copy(), np.ones(1, dtype=np.int32), np.ones(1) * 1e-3)
    measure(loop, 1.0, triangle, places[Surface.of(mesh).tissue])


if __name__ == "__main__":
    warm_up()
