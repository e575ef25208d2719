"""Renumbering for locality: what is near in the tissue lies near in memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee

from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sheet import sides

_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])


def neighbour_distance(tets: NDArray[np.integer]) -> float:
    """Mean difference of the rows of two nodes of an edge, each edge counted once per element."""
    edges = tets[:, _EDGES].astype(np.int64)
    return float(np.abs(edges[..., 1] - edges[..., 0]).mean()) if len(tets) else 0.0


def renumber(raw: RawMesh) -> RawMesh:
    """Order nodes by reverse Cuthill-McKee and elements by their lowest node.

    File ids, regions, fibres and node sets follow. The same mesh always gets the same order.
    """
    count = len(raw.points)
    pairs = sides(raw.triangles)
    if len(raw.tetrahedra):
        pairs = raw.tetrahedra[:, _EDGES].reshape(-1, 2)
    ones = np.ones(len(pairs), dtype=np.int8)
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    old_of_new = reverse_cuthill_mckee(graph + graph.T, symmetric_mode=True).astype(np.int64)
    new_of_old = np.empty(count, dtype=np.int64)
    new_of_old[old_of_new] = np.arange(count)

    tetrahedra = new_of_old[raw.tetrahedra]
    corners = np.sort(tetrahedra, axis=1)
    order = np.lexsort((corners[:, 3], corners[:, 2], corners[:, 1], corners[:, 0]))
    node_ids = raw.node_file_ids if len(raw.node_file_ids) else np.arange(count)
    element_ids = raw.element_file_ids if len(raw.element_file_ids) else np.arange(len(order))
    return replace(
        raw,
        points=raw.points[old_of_new],
        tetrahedra=tetrahedra[order],
        triangles=new_of_old[raw.triangles],
        regions=raw.regions[order] if len(raw.regions) else raw.regions,
        element_vectors={name: rows[order] for name, rows in raw.element_vectors.items()},
        fibres=raw.fibres[order] if len(raw.fibres) else raw.fibres,
        node_sets={name: np.sort(new_of_old[rows]) for name, rows in raw.node_sets.items()},
        node_file_ids=node_ids[old_of_new],
        element_file_ids=element_ids[order],
    )
