"""What plans that follow no sweep start from: tears and burns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import CutCode, CutError
from cut_service.neighbours import links_of
from cut_service.sweep import Sweep
from cut_service.work import Settings, Work
from tissue_sim.geometry.mesh import Mesh

_NOTHING = Sweep(np.empty((0, 3)), np.empty((0, 3), dtype=np.int32))


def work_without_sweep(
    mesh: Mesh,
    positions: NDArray[np.floating],
    held: NDArray[np.uint32] | None = None,
    settings: Settings | None = None,
) -> Work:
    """What a plan needs to know of a mesh.

    Args:
        mesh: The mesh, at the version that `positions` belong to.
        positions: Current node positions [m], shape (node_rows, 3).
        held: Ids of nodes held by tools.
        settings: How to cut; default: `Settings()`.

    Raises:
        CutError: The mesh is none of tetrahedra, or the positions do not fit or are not finite.
    """
    if mesh.sheet_rows is not None:
        raise CutError(CutCode.REFUSED, f"{mesh.name} is made of triangles, not of tetrahedra")
    places = np.ascontiguousarray(positions, dtype=np.float64)
    if places.shape != (mesh.node_rows, 3):
        raise CutError(
            CutCode.NO_TISSUE, f"positions of {mesh.node_rows} nodes wanted, got {places.shape}"
        )
    if not np.isfinite(places[mesh.node_alive[: mesh.node_rows]]).all():
        raise CutError(CutCode.NO_TISSUE, "the positions are not finite")
    still = mesh.fixed[: mesh.node_rows].copy()
    if held is not None and len(held):
        rows = mesh.node_rows_of(held)
        still[rows[rows >= 0]] = True
    alive = mesh.element_alive[: mesh.element_rows]
    return Work(mesh, links_of(mesh), alive, places, _NOTHING, settings or Settings(), still)
