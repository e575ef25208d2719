"""Where a blade touches tissue."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import State
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction import rigid
from tissue_sim.interaction.strokes import Stroke
from tissue_sim.kernels.blades import nodes_at_blade

SAMPLES = 16
"""Points along a side that are looked at."""

LOOKED_AT = 4096
"""Elements whose edges make the mean edge."""


def mean_edge(mesh: Mesh) -> float:
    """Mean length of the edges of the organ's elements at rest [m], from a sample of them."""
    tets = mesh.tets[: mesh.element_rows]
    # Springs of sheets have two nodes and go right through the tissue.
    rows = np.flatnonzero(mesh.element_alive[: mesh.element_rows] & (tets[:, 2] >= 0))
    if not len(rows):
        return 1e-3
    corners = mesh.rest[tets[rows[:: len(rows) // LOOKED_AT + 1], :3]]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())


def touched_nodes(
    mesh: Mesh, state: State, stroke: Stroke, pose: NDArray[np.float64], reach: float
) -> NDArray[np.int32]:
    """Rows of the nodes at most `reach` [m] off a blade, ascending."""
    found = np.empty(mesh.node_rows, dtype=np.int32)
    count = nodes_at_blade(
        mesh.rest, state.displacement, mesh.node_alive, mesh.node_rows, pose[:3],
        rigid.matrix(pose[3:]), stroke.corners, stroke.outwards, reach, found,
    )  # fmt: skip
    return found[:count].copy()


def sides_in_tissue(
    places: NDArray[np.float64], stroke: Stroke, pose: NDArray[np.float64], reach: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How much of each side of a blade is in tissue: the share of it that has a node near.

    Args:
        places: Positions of the nodes at the blade [m], shape (n, 3).
        stroke: The blade.
        pose: Of the tool, shape (7,).
        reach: A node is near within this distance [m].

    Returns:
        Lengths in tissue [m], shape (k,), and the middles of those parts in the tool's axes [m],
        shape (k, 3).
    """
    share = ((np.arange(SAMPLES) + 0.5) / SAMPLES)[:, None]
    ends = np.roll(stroke.corners, -1, axis=0)
    along = stroke.corners[:, None] * (1.0 - share) + ends[:, None] * share
    local = rigid.to_local(pose, places)
    far = np.linalg.norm(along.reshape(-1, 1, 3) - local, axis=2).min(axis=1, initial=np.inf)
    inside = far.reshape(along.shape[:2]) <= reach
    lengths = np.linalg.norm(ends - stroke.corners, axis=1) * inside.mean(axis=1)
    weights = np.where(inside.any(axis=1, keepdims=True), inside, 1.0)
    middles = np.einsum("ij,ijk->ik", weights, along) / weights.sum(axis=1, keepdims=True)
    return lengths, middles
