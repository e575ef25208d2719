"""Holes as messages, both ways."""

from __future__ import annotations

from typing import Any

import numpy as np
from tissue_interfaces.msg import Hole as HoleMsg

from tissue_sim import conversions
from tissue_sim.geometry.closure import Closure
from tissue_sim.geometry.holes import Hole

NO_PATCH = -1.0
"""Distance from the nearest patch where there is none."""


def hole_to_msg(hole: Hole, closure: Closure | None, lost: int, problem: str) -> HoleMsg:
    """A hole and how far it is closed.

    Args:
        hole: The hole.
        closure: What was measured; None: nothing could be.
        lost: Positions of its edge that are no more.
        problem: Why nothing could be measured.
    """
    message = HoleMsg(
        name=hole.name,
        depth=float(hole.depth),
        first_area=float(hole.first_area),
        lost=lost,
        problem=problem,
        edge_gap=NO_PATCH,
    )
    conversions.fill(message.nodes, hole.nodes)
    conversions.fill(message.weights, hole.weights)
    if closure is None:
        return message
    message.area, message.open_area = float(closure.area), float(closure.open_area)
    message.covered, message.by_patches = float(closure.covered), float(closure.by_patches)
    message.gap, message.sampling = float(closure.gap), float(closure.sampling)
    message.gap_at = np.nan_to_num(closure.gap_at)
    if np.isfinite(closure.edge_gap):
        message.edge_gap = float(closure.edge_gap)
        message.edge_gap_at = np.nan_to_num(closure.edge_gap_at)
    conversions.fill(message.patches, np.array(list(closure.shares)))
    conversions.fill(message.patch_shares, np.array(list(closure.shares.values())))
    return message


def hole_from_msg(message: Any) -> Hole:
    """A hole as it was named, from a message of rclpy or a bag's."""
    return Hole(
        str(message.name),
        conversions.array_of(message.nodes, np.uint32).reshape(-1, 3).copy(),
        conversions.array_of(message.weights, np.float64).reshape(-1, 3).copy(),
        float(message.depth),
        float(message.first_area),
    )
