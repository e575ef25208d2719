"""Springs of tissue made of triangles: their ends and categories.

Every triangle of area A_t and thickness h_t gives each of its edges the volume A_t h_t, as every
tetrahedron gives its edges V_t; a spring that is an element has the volume of its own tissue. The
stiffness of a spring is E V / l0^2 for all of them, times its category's factor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import SURFACE, Sheet, edge_keys, edges_of_keys, sides


def sheet_edges(sheet: Sheet) -> NDArray[np.int32]:
    """Ends of all springs of a sheet, lower row first, each pair once, ascending, shape (s, 2)."""
    keys = np.concatenate([edge_keys(sides(sheet.triangles)), edge_keys(sheet.springs)])
    return edges_of_keys(np.unique(keys))


def categories_of(mesh: Mesh, edges: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Category of springs between nodes of a sheet: `SURFACE` where a triangle has both.

    Time proportional to the springs asked for.

    Args:
        mesh: A mesh that is a sheet.
        edges: Ends of the springs, shape (s, 2).
    """
    categories = np.full(len(edges), SURFACE, dtype=np.uint8)
    if mesh.sheet_rows is None or not len(edges):
        return categories
    items = mesh.incident.of_all(np.unique(edges))
    springs = items[mesh.tets[items, 2] < 0]
    solid = mesh.tets[items[mesh.sheet_rows.carries(items)], :3]
    own, order = np.unique(edge_keys(mesh.tets[springs, :2]), return_index=True)
    keys = edge_keys(edges)
    place = np.minimum(np.searchsorted(own, keys), max(len(own) - 1, 0))
    is_own = np.zeros(len(keys), dtype=np.bool_) if not len(own) else own[place] == keys
    is_own &= ~np.isin(keys, edge_keys(sides(solid)))
    categories[is_own] = mesh.sheet_rows.kinds[springs[order[place[is_own]]]]
    return categories
