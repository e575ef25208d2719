"""How large the organ is without the patches that lie on it or beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.mesh import Mesh

Reals = NDArray[np.float64]

SPARSE = 64
"""One element in so many tells enough of an organ for most questions."""


def tissue_box(mesh: Mesh, places: Reals, every: int = 1) -> tuple[Reals, Reals]:
    """Lower and upper corner of the box around living tissue that is of no patch [m], (3,) each.

    Where only patches are left, around these.

    Args:
        mesh: The mesh, with a living node.
        places: Current node positions [m], shape (node_rows, 3).
        every: Look at one element in so many only: the box is then too small rather than too large.
    """
    living = mesh.node_alive[: mesh.node_rows]
    if not len(mesh.patches):
        return _box(places[living])
    rows = slice(0, mesh.element_rows, every)
    tissue = mesh.element_alive[rows] & ~np.isin(mesh.regions[rows], mesh.patches.labels)
    nodes = mesh.tets[rows][tissue]
    own = places[nodes[nodes >= 0]]
    if not len(own):
        return tissue_box(mesh, places) if every > 1 else _box(places[living])
    return _box(own)


def _box(places: Reals) -> tuple[Reals, Reals]:
    return places.min(axis=0), places.max(axis=0)
