"""Springs of tissue made of triangles: their ends and the tissue they stand for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.sheet import CATEGORIES, SURFACE, Sheet, edge_keys, edges_of_keys, sides


def sheet_springs(
    sheet: Sheet, points: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.uint8]]:
    """All springs of a sheet, ordered by their ends.

    Every triangle of area A_t and thickness h_t gives each of its edges the volume A_t h_t, as
    every tetrahedron gives its edges V_t; the stiffness of a spring is E V / l0^2 for all of them.

    Args:
        sheet: The sheet.
        points: Node positions at rest [m], shape (n, 3).

    Returns:
        Ends, lower row first, shape (s, 2); volume times the category's factor of stiffness [m^3],
        shape (s,); category of each, shape (s,).
    """
    edges, edge = np.unique(edge_keys(sides(sheet.triangles)), return_inverse=True)
    tissue = np.repeat(sheet.triangle_volumes(points), 3)
    volumes = np.bincount(edge.ravel(), weights=tissue, minlength=len(edges))
    factors = np.array([getattr(sheet.stiffness, name) for name in CATEGORIES])
    keys = np.concatenate([edges, edge_keys(sheet.springs)])
    categories = np.concatenate([np.full(len(edges), SURFACE, np.uint8), sheet.categories])
    volumes = np.concatenate([volumes, sheet.volumes]) * factors[categories]
    order = np.argsort(keys, kind="stable")
    return edges_of_keys(keys[order]), volumes[order], categories[order]
