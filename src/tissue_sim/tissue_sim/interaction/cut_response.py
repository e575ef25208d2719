"""What tissue does to a blade that cuts it: the numbers, and the force along its sides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Parameter
from tissue_sim.interaction.tool_numbers import ToolNumbers

PARAMETERS = (
    Parameter("toughness", 0.0, 0.0, 1e6, "J/m^2", "work per area cut that resists the blade"),
    Parameter("friction", 0.0, 0.0, 1e4, "N/m", "friction per length of blade in tissue"),
    Parameter(
        "puncture_force", 0.0, 0.0, 1e4, "N",
        "force on the blade at which the tissue opens; 0: at once",
    ),
    Parameter(
        "puncture_depth", 0.005, 1e-6, 1.0, "m",
        "way the blade pushes tissue before it opens, however weak the force",
    ),
)  # fmt: skip
"""What can be set for each tool that cuts."""

SLOW = 1e-3
"""Speed at which resistance reaches half of its size [m/s]: at rest a blade feels none."""


@dataclass(frozen=True)
class CutResponse(ToolNumbers):
    """How tissue resists a blade; all off by default. See `PARAMETERS`.

    Attributes:
        toughness: Work that cutting an area takes [J/m^2].
        friction: Of the blade's sides, per length of blade in tissue [N/m].
        puncture_force: Until it is reached the blade pushes the tissue [N]; 0: it opens at once.
        puncture_depth: Nor does the blade push it farther than this [m].
    """

    parameters: ClassVar[tuple[Parameter, ...]] = PARAMETERS

    toughness: float = 0.0
    friction: float = 0.0
    puncture_force: float = 0.0
    puncture_depth: float = 0.005

    @property
    def resists(self) -> bool:
        """Whether a blade feels what it cuts."""
        return self.toughness > 0.0 or self.friction > 0.0


def resistance(
    response: CutResponse,
    before: NDArray[np.float64],
    now: NDArray[np.float64],
    outwards: NDArray[np.float64],
    inside: NDArray[np.float64],
    tip: NDArray[np.float64],
    period: float,
) -> NDArray[np.float64]:
    """Force [N] and torque about the tip [N m] on a blade that cuts, shape (6,).

    A side of which the length b is in tissue and that moves with velocity v cuts the area
    b max(0, v . n) in a second, n being the outside's direction. Its power is toughness times that,
    so that the force against the motion is toughness b max(0, v . n) / |v|. Friction is against the
    motion as well; a blade of length b in tissue has two sides of that length.

    Args:
        response: Toughness and friction.
        before: Middles of the parts of the sides in tissue in the last frame [m], shape (k, 3).
        now: The same points of the blade in this frame [m], shape (k, 3).
        outwards: Unit vectors out of the blade in its plane, shape (k, 3).
        inside: Length of each side in tissue [m], shape (k,).
        tip: Position of the tip [m], shape (3,).
        period: Time between the frames [s].
    """
    velocity = (now - before) / period
    speed = np.linalg.norm(velocity, axis=1)
    direction = velocity / np.maximum(speed, 1e-300)[:, None]
    ahead = np.maximum(np.einsum("ij,ij->i", direction, outwards), 0.0)
    size = inside * (response.toughness * ahead + 0.5 * response.friction)
    forces = -direction * (size * speed / (speed + SLOW))[:, None]
    torque = np.cross(now - tip, forces).sum(axis=0)
    return np.concatenate([forces.sum(axis=0), torque])
