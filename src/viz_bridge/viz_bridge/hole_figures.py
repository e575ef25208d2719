"""Figures of the holes that were named in a session, from `tissue/holes`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from viz_bridge.cdr import Message


@dataclass
class HoleFigures:
    """One hole; lengths in metres.

    Attributes:
        name: Its name.
        named_at: Time of the organ when it was first heard of [s].
        first_area: Area when it was named [m^2].
        first_covered: Share covered when it was first heard of.
        last: The newest of its messages that could be measured; None: none could.
        problem: Why the newest could not be; "" if it could.
    """

    name: str
    named_at: float
    first_area: float
    first_covered: float
    last: Message | None = None
    problem: str = ""

    def document(self) -> dict[str, Any]:
        """As in summary.json."""
        told: dict[str, Any] = {
            "name": self.name,
            "sim_time": round(self.named_at, 3),
            "first_area_mm2": round(1e6 * self.first_area, 3),
            "first_covered": round(self.first_covered, 4),
            "problem": self.problem,
        }
        if self.last is not None:
            told |= measured(self.last)
        return told


def take_holes(holes: dict[str, HoleFigures], message: Message, sim_time: float) -> None:
    """Take a message of `tissue/holes`. Modifies the figures by name in place.

    Args:
        holes: Figures so far.
        message: The message.
        sim_time: Time of the organ [s].
    """
    for hole in message.holes:
        name = str(hole.name)
        known = holes.get(name)
        if known is None or known.first_area != float(hole.first_area):
            # Named, or named anew.
            covered = float(hole.covered)
            known = holes[name] = HoleFigures(name, sim_time, float(hole.first_area), covered)
        known.problem = str(hole.problem)
        if not known.problem:
            known.last = hole


def measured(hole: Message) -> dict[str, Any]:
    """Figures of one message as in summary.json; no distance from patches where there are none."""
    edge = float(hole.edge_gap)
    return {
        "area_mm2": round(1e6 * float(hole.area), 3),
        "open_area_mm2": round(1e6 * float(hole.open_area), 3),
        "covered": round(float(hole.covered), 4),
        "by_patches": round(float(hole.by_patches), 4),
        "gap_mm": round(1e3 * float(hole.gap), 3),
        "edge_gap_mm": round(1e3 * edge, 3) if edge >= 0.0 else None,
        "patches": [int(patch) for patch in hole.patches],
    }
