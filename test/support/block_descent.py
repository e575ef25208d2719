"""Vertex block descent on a block, for tests."""

from __future__ import annotations

import numpy as np

from support.elastic_scenes import MATERIAL, block_mesh
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.vertex_block_descent import VertexBlockDescent
from tissue_sim.geometry.mesh import Mesh

NAME = "vertex_block_descent"
PULL = np.array([0.002, 0.0, 0.006])
"""Of the block's top [m]."""


def scene(
    nodes: int = 5,
    fixed: bool = True,
    dtype: type[np.floating] = np.float64,
    material: Material = MATERIAL,
    **parameters: float,
) -> tuple[Mesh, VertexBlockDescent, State]:
    """A block, the model on all of it and its state, nothing held."""
    mesh = block_mesh(nodes, fixed)
    springs, state = SpringNetwork(mesh, material, dtype), State(mesh, dtype)
    values: dict[str, float] = {"levels": WHOLE_ORGAN} | parameters
    model = registry.build(NAME, mesh, material, values, springs)
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    assert isinstance(model, VertexBlockDescent)
    return mesh, model, state
