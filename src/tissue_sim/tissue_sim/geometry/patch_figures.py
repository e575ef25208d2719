"""Figures of the patch that an edit adds."""

from __future__ import annotations

import numpy as np

from tissue_sim.geometry.edit import NO_PARENT, TopologyEdit
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.geometry.sheet import SURFACE, triangle_areas


def patch_area(edit: TopologyEdit) -> float:
    """Area of one side of the patch that an edit adds [m^2]: its volume over its thickness."""
    if not edit.added_patches:
        return 0.0
    order = np.argsort(edit.born_nodes)
    points = edit.born_rest[order]
    elements = edit.added_nodes[edit.added_parents == NO_PARENT]
    places = np.searchsorted(edit.born_nodes[order], elements)
    if len(edit.born_kinds):
        is_triangle = edit.born_kinds == SURFACE
        areas = triangle_areas(points, places[is_triangle][:, :3])
        volume = float(areas @ edit.born_tissue[is_triangle])
    else:
        volume = float(signed_volumes(points, places).sum())
    return volume / edit.added_patches[0].thickness
