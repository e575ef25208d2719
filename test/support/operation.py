"""Strokes in one process, for tests, and what they have opened."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cut_service.one_process import Operation, knife, line
from tissue_sim.geometry.mesh import Mesh

__all__ = ["Operation", "knife", "line", "split_nodes"]


def split_nodes(mesh: Mesh) -> NDArray[np.float64]:
    """Rest positions of the nodes that have copies [m], shape (n, 3)."""
    rows = np.flatnonzero(mesh.node_alive[: mesh.node_rows])
    parents = mesh.node_parents[rows]
    copies = rows[(parents != mesh.node_ids[rows]) & (parents < mesh.node_rows)]
    return mesh.rest[np.unique(mesh.node_parents[copies].astype(np.int64))]
