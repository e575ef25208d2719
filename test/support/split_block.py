"""A plan that splits a block half way through, without cut_service."""

from __future__ import annotations

import numpy as np

from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh


def split_plan(mesh: Mesh, through: float = 0.5) -> TopologyEdit:
    """Split the block across x along its middle plane, from the side of greatest y half way."""
    rest = mesh.rest[: mesh.node_rows]
    low, high = rest.min(axis=0), rest.max(axis=0)
    planes = np.unique(np.round(rest[:, 0], 9))
    middle = planes[len(planes) // 2]
    depth = low[1] + through * (high[1] - low[1])
    on_cut = (np.abs(rest[:, 0] - middle) < 1e-9) & (rest[:, 1] > depth + 1e-9)
    on_cut = np.flatnonzero(on_cut & mesh.node_alive[: mesh.node_rows])
    copies = np.full(mesh.node_rows, -1, dtype=np.int64)
    copies[on_cut] = PROVISIONAL + np.arange(len(on_cut))
    tets = mesh.tets[: mesh.element_rows].astype(np.int64)
    right = rest[tets].mean(axis=1)[:, 0] > middle
    living = mesh.element_alive[: mesh.element_rows]
    rows = np.flatnonzero(living & right & (copies[tets] >= 0).any(axis=1))
    renamed = np.where(copies[tets[rows]] >= 0, copies[tets[rows]], tets[rows])
    return TopologyEdit(
        base_version=mesh.version,
        copied_nodes=copies[on_cut].astype(np.uint32),
        copy_parents=on_cut.astype(np.uint32),
        rewritten_elements=rows.astype(np.uint32),
        rewritten_nodes=renamed.astype(np.uint32),
        author="fake",
        request_id="cut-1",
    )
