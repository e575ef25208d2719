"""Two blocks of tissue with a gap between them, and the edits that sew them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block
from tissue_sim.geometry.sutures import DEFAULT_STIFFNESS

SIZE = 0.012
"""Length of each block along x [m]; its nodes are 3 mm apart."""


def two_blocks(gap: float = 0.001) -> tuple[Mesh, NDArray[np.int32], NDArray[np.int32]]:
    """A mesh of two blocks, fixed at their far ends, and the rows of their lips.

    The nth nodes of the lips lie opposite each other, `gap` [m] apart along x.
    """
    raw = block(5, 4, 3, SIZE, 0.009, 0.006)
    there = raw.points + np.array([SIZE + gap, 0, 0])
    points = np.concatenate([raw.points, there])
    tets = np.concatenate([raw.tetrahedra, raw.tetrahedra + len(raw.points)])
    far = (points[:, 0] < 1e-9) | (points[:, 0] > 2 * SIZE + gap - 1e-9)
    lips = (np.flatnonzero(np.isclose(points[:, 0], x)) for x in (SIZE, SIZE + gap))
    left, right = (lip.astype(np.int32) for lip in lips)
    return Mesh(RawMesh(points, tets), far), left, right


def sew_edit(
    mesh: Mesh,
    left: NDArray[np.integer],
    right: NDArray[np.integer],
    length: float = 0.0,
    stiffness: float = DEFAULT_STIFFNESS,
    request_id: str = "",
) -> TopologyEdit:
    """A plan of single stitches between pairs of nodes."""
    ids = (PROVISIONAL + np.arange(len(left))).astype(np.uint32)
    return TopologyEdit(
        mesh.version,
        kind="suture",
        added_sutures=ids,
        suture_nodes=np.stack([left, right], axis=1).astype(np.uint32),
        suture_lengths=np.full(len(left), length),
        suture_stiffness=np.full(len(left), stiffness),
        suture_groups=ids,
        request_id=request_id,
    )


def tighten_edit(mesh: Mesh, length: float, request_id: str = "") -> TopologyEdit:
    """A plan of another rest length for all stitches there are."""
    ids = mesh.sutures.ids
    return TopologyEdit(
        mesh.version,
        kind="tighten",
        changed_sutures=ids,
        changed_lengths=np.full(len(ids), length),
        request_id=request_id,
    )
