"""A wall with a square hole in its middle, and a patch that lies over it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from support.patches import SOFT, patch_edit
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.patches import Patch
from tissue_sim.geometry.shapes import block

SIDE = 0.030
"""Width and height of the wall [m]; nodes are 2.5 mm apart."""

HOLE = 0.010
"""Side of the hole [m]."""

TOP = 0.005
"""Height of the wall's upper side [m]; the lower one is at 0."""


def holed_wall(fixed: bool = False) -> Mesh:
    """The wall, from 0 to `SIDE`, with the hole around its middle; maybe fixed all around."""
    raw = block(13, 13, 3, SIDE, SIDE, TOP)
    flat = raw.points[:, :2]
    outer = np.asarray(((flat < 1e-6) | (flat > SIDE - 1e-6)).any(axis=1))
    mesh = Mesh(raw, outer & fixed)
    middles = mesh.rest[mesh.tets[: mesh.element_rows]].mean(axis=1)
    gone = (np.abs(middles[:, :2] - 0.5 * SIDE) < 0.5 * HOLE).all(axis=1)
    mesh.apply(TopologyEdit(mesh.version, removed_elements=np.flatnonzero(gone).astype(np.uint32)))
    return mesh


def edge(height: float = TOP, inset: float = 0.0) -> NDArray[np.float64]:
    """Corners and middles of the sides of the hole's edge, counterclockwise from above [m]."""
    corners = np.array([[-1, -1], [0, -1], [1, -1], [1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0]])
    flat = 0.5 * SIDE + (0.5 * HOLE - inset) * corners
    return np.column_stack([flat, np.full(8, height)])


def add_patch(
    mesh: Mesh, size: float = 0.014, above: float = 0.0005, patch: Patch = SOFT, count: int = 8
) -> None:
    """Put a square patch over the middle of the hole, its lower side so far above the wall [m]."""
    at = 0.5 * (SIDE - size)
    mesh.apply(patch_edit(mesh, (at, at, TOP + above), (count, count), (size, size), patch))
