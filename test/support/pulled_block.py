"""A small block whose top is pulled aside: what models are compared on in tests."""

from __future__ import annotations

import numpy as np

from support.small_block import block_mesh
from tissue_sim.compare.interaction import Interaction, held_along
from tissue_sim.compare.organ import Organ

PULL = np.array([0.006, 0.008, 0.0])
"""Where the top is at the end, from rest [m]."""


def block_organ(nodes: int = 4) -> Organ:
    """A cube of 6 cm, fixed at its lowest y."""
    return Organ("block", block_mesh(nodes))


def top_of(organ: Organ) -> np.ndarray:
    """Rows of the nodes at the highest y."""
    return np.flatnonzero(organ.rest[:, 1] > organ.rest[:, 1].max() - 1e-9)


def pull_of(organ: Organ, frames: int = 6, name: str = "pull") -> Interaction:
    """The top moves by `PULL` at constant speed."""
    progress = np.arange(1, frames + 1)[:, None] / frames
    return held_along(organ, name, 30.0, top_of(organ), progress * PULL)
