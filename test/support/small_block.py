"""A small block of tissue, fixed at its lowest y, and a simulation of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

CORNER = (0.06, 0.06, 0.06)


def block_mesh(nodes: int = 5) -> Mesh:
    """A cube of 6 cm with `nodes` nodes along each edge."""
    raw = block(nodes, nodes, nodes)
    return Mesh(raw, raw.points[:, 1] < 1e-9)


def tool_at(position: tuple[float, float, float], tool: str = "grasper", **more: Any) -> ToolSpec:
    """A grasper that reaches 2 cm."""
    more.setdefault("size", (0.02,))
    return ToolSpec(tool, pose=(*position, 0.0, 0.0, 0.0, 1.0), **more).checked()


def block_simulation(*tools: ToolSpec, nodes: int = 5, **scene: Any) -> Simulation:
    """A simulation of the block with these tools, or with one grasper at its free corner."""
    chosen = tools or (tool_at(CORNER),)
    return Simulation(block_mesh(nodes), Scene(tools=chosen, **scene))


def pose_of(position: Any, turn: Any = (0.0, 0.0, 0.0, 1.0)) -> np.ndarray:
    """A pose from a position [m] and a quaternion."""
    return np.array([*position, *turn], dtype=np.float64)
