"""A hole as it is after the last frame of a session."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.closure import Closure
from tissue_sim.geometry.holes import Hole, HoleLostError
from tissue_sim.geometry.mesh import Mesh


@dataclass
class HoleReport:
    """One hole as it is after the last frame.

    Attributes:
        hole: As it was named.
        closure: How far it is closed; None: its edge is no more.
    """

    hole: Hole
    closure: Closure | None

    def document(self) -> dict[str, Any]:
        """As in summary.json; lengths in millimetres."""
        told: dict[str, Any] = {
            "name": self.hole.name,
            "first_area_mm2": 1e6 * self.hole.first_area,
        }
        found = self.closure
        if found is None:
            return {**told, "problem": "its edge is no more"}
        near = bool(np.isfinite(found.edge_gap))
        return {
            **told,
            "area_mm2": 1e6 * found.area,
            "open_area_mm2": 1e6 * found.open_area,
            "covered": found.covered,
            "by_patches": found.by_patches,
            "gap_mm": 1e3 * found.gap,
            "edge_gap_mm": 1e3 * found.edge_gap if near else None,
            "patches": list(found.shares),
        }

    def __str__(self) -> str:
        found = self.closure
        if found is None:
            return "its edge is no more"
        return (
            f"{100.0 * found.covered:.1f} % of {1e6 * found.area:.0f} mm^2 covered "
            f"({1e6 * self.hole.first_area:.0f} mm^2 when it was named), "
            f"widest gap {1e3 * found.gap:.2f} mm"
        )


def measured(hole: Hole, mesh: Mesh, shape: NDArray[np.floating]) -> HoleReport:
    """Measure a hole at a shape [m], shape (node_rows, 3)."""
    try:
        return HoleReport(hole, hole.closure(mesh, shape))
    except HoleLostError:
        return HoleReport(hole, None)
