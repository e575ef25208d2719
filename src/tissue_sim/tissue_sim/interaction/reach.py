"""What tools reach: spheres and capsules, and the nodes that a grab takes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction import rigid
from tissue_sim.interaction.tools import BOX, CAPSULE, ToolSpec
from tissue_sim.kernels.contact import Capsule, nodes_near_axis
from tissue_sim.kernels.positions import nodes_within

Rows = NDArray[np.int32]


def capsule_of(tool: ToolSpec, pose: NDArray[np.float64]) -> Capsule:
    """Where a sphere or a capsule is at a pose, shape (7,)."""
    length = tool.size[1] if tool.shape == CAPSULE else 0.0
    shaft = np.ascontiguousarray(rigid.matrix(pose[3:])[:, 2])
    return Capsule(pose[:3], shaft, length, tool.size[0])


def nodes_in_sphere(
    mesh: Mesh, displacement: NDArray[np.floating], centre: NDArray[np.float64], radius: float
) -> Rows:
    """Rows of the nodes within a sphere that are not fixed, ascending."""
    found = np.empty(mesh.node_rows, dtype=np.int32)
    count = nodes_within(
        mesh.rest, displacement, mesh.node_alive, mesh.fixed, mesh.node_rows, centre, radius,
        found,
    )  # fmt: skip
    return found[:count].copy()


def nodes_inside(
    mesh: Mesh, displacement: NDArray[np.floating], tool: ToolSpec, pose: NDArray[np.float64]
) -> Rows:
    """Rows of the nodes inside a tool's shape that are not fixed, ascending.

    Args:
        mesh: The organ.
        displacement: Of its nodes from rest [m], shape (n, 3).
        tool: A tool that grabs.
        pose: Of the tool, shape (7,).
    """
    if tool.shape == CAPSULE:
        free = _free(mesh)
        found = np.empty(len(free), dtype=np.int32)
        capsule = capsule_of(tool, pose)
        count = nodes_near_axis(free, mesh.rest, displacement, capsule, capsule.radius, found)
        return found[:count].copy()
    if tool.shape != BOX:
        return nodes_in_sphere(mesh, displacement, pose[:3], tool.size[0])
    half = 0.5 * np.array(tool.size)
    # Only what is within the box's diagonal can be inside.
    near = nodes_in_sphere(mesh, displacement, pose[:3], float(np.linalg.norm(half)))
    local = rigid.to_local(pose, mesh.rest[near] + displacement[near])
    return near[(np.abs(local) <= half).all(axis=1)]


def _free(mesh: Mesh) -> Rows:
    rows = mesh.node_rows
    return np.flatnonzero(mesh.node_alive[:rows] & ~mesh.fixed[:rows]).astype(np.int32)
