"""What the thesis' text leaves open about its experiment, and what we take for it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

PULLS = ("in_plane", "normal", "oblique")
"""Directions of the pull, which the text does not tell."""

AMPLITUDES = (0.004, 0.008, 0.012)
"""Amplitudes of the pull [m]: one, two and three times the distance of two nodes.

Chosen before any result. Below one distance strains at the hold are small and springs nearly
linear, so that a smaller amplitude would be the same case again; beyond three the hold, five nodes
wide, would be pulled farther than it is wide, and the thesis observes small deformations.
"""


@dataclass(frozen=True)
class Conditions:
    """One way to fill in what the text leaves open.

    Attributes:
        pulls: Directions.
        amplitudes: How far the held nodes get [m].
        per_element: Whether springs are repeated for each element: 0, 1 or both.
        poisson_ratio: Of the reference; its Young's modulus does not matter where displacements are
            prescribed.
        corotated: 1: the reference measures strain in turned elements.
        speed: Speed of the machine over that of the thesis' frame rates.
        hold: Width of what is held over that of the wall.
        tremor: Jerks of the pulling hand over the way it goes in a frame; 0: a steady hand.
        levels: Cut-off level of the sweeps; 0: the whole wall.
        full_excess: 1: relaxation moves both ends by the whole excess, as the thesis lists it.
    """

    pulls: tuple[str, ...] = PULLS
    amplitudes: tuple[float, ...] = AMPLITUDES
    per_element: tuple[float, ...] = (0.0, 1.0)
    poisson_ratio: float = 0.45
    corotated: float = 0.0
    speed: float = 1.0
    hold: float = 1.0 / 3.0
    tremor: float = 0.0
    levels: int = 0
    full_excess: float = 0.0

    def values(self, model: str) -> dict[str, float]:
        """What they say to a model."""
        values: dict[str, float] = {}
        if self.levels and model in ("quasi_static", "lr"):
            values["levels"] = float(self.levels)
        if self.full_excess and model in ("relaxation", "lr"):
            values["full_excess"] = self.full_excess
        return values

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return asdict(self)
