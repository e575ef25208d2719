"""What is known of a session by those that join in its middle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.condition_topics import material_from_msg
from tissue_sim.conversions import array_of, epoch_of, tool_arguments
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene

TOOLS, MATERIAL, HELD = "tissue/tools", "tissue/material", "tissue/held_nodes"
NEEDED = (TOOLS, MATERIAL)


def scene_in_the_middle(
    latched: Mapping[str, Any], times: Sequence[float], displacement: NDArray[np.float32]
) -> Scene:
    """A scene that goes on from the shape of a session.

    Parameters of models, fibres and seeded releases are in the journal's first entry only: they are
    those of a scene that says nothing of them.

    Args:
        latched: Newest message of each latched topic; those `NEEDED` are there.
        times: Simulated times of successive frames [s].
        displacement: Displacement from rest now [m], shape (node_rows, 3).

    Raises:
        ValueError: A message makes no sense.
    """
    tools = [ToolSpec.from_arguments(tool_arguments(tool)) for tool in latched[TOOLS].tools]
    periods = [later - sooner for sooner, later in pairwise(times) if later > sooner]
    rate = float(np.clip(1.0 / np.median(periods), 1.0, 1000.0)) if periods else Scene.rate_hz
    return Scene(
        material=material_from_msg(latched[MATERIAL]), tools=tuple(tools), rate_hz=rate,
        displacement=displacement,
    )  # fmt: skip


def held_rows(latched: Mapping[str, Any], epoch: bytes, mesh: Mesh) -> NDArray[np.int32]:
    """Rows of the nodes that are held, ascending."""
    message = latched.get(HELD)
    if message is None or epoch_of(message) != epoch:
        return np.empty(0, dtype=np.int32)
    rows = mesh.node_rows_of(array_of(message.nodes, np.uint32))
    return np.sort(rows[rows >= 0])
