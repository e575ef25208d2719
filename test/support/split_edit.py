"""An edit that splits a block of tissue along one of its grid planes."""

from __future__ import annotations

import numpy as np

from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh


def split_at(mesh: Mesh, x: float, top: float = np.inf, request_id: str = "") -> TopologyEdit:
    """Split at the grid plane of this x, for elements with centres below y = top."""
    rows = mesh.element_rows
    tets, alive = mesh.tets[:rows], mesh.element_alive[:rows]
    centres = mesh.rest[tets].mean(axis=1)
    beyond = alive & (centres[:, 0] > x) & (centres[:, 1] < top)
    before = alive & (centres[:, 0] < x) & (centres[:, 1] < top)
    on_plane = np.abs(mesh.rest[: mesh.node_rows, 0] - x) < 1e-9
    used_before = np.zeros(mesh.node_rows, dtype=bool)
    used_before[tets[before]] = True
    used_beyond = np.zeros(mesh.node_rows, dtype=bool)
    used_beyond[tets[beyond]] = True
    parents = np.flatnonzero(on_plane & used_before & used_beyond)
    new = np.arange(mesh.node_rows, dtype=np.int64)
    new[parents] = PROVISIONAL + np.arange(len(parents))
    changed = np.flatnonzero(beyond & np.isin(tets, parents).any(axis=1))
    return TopologyEdit(
        base_version=mesh.version,
        read_nodes=parents.astype(np.uint32),
        read_elements=changed.astype(np.uint32),
        copied_nodes=(PROVISIONAL + np.arange(len(parents))).astype(np.uint32),
        copy_parents=parents.astype(np.uint32),
        rewritten_elements=changed.astype(np.uint32),
        rewritten_nodes=new[tets[changed]].astype(np.uint32),
        request_id=request_id,
    )
