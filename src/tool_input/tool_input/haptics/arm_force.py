"""What an arm displays of the wrench on a tool, and what its limits are in forces on the tool."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tissue_sim.interaction.reaction import ForceLimits
from tool_input.arm_mapping import ArmBase


@dataclass(frozen=True)
class ArmForce:
    """The wrench on the tool, scaled, in the axes of the arm's base.

    The arm's metres are `base.scale` of the tool's, so that the power of a force at the arm is
    force_scale / base.scale of its power at the tool. Torques are scaled by that: then it holds for
    all six coordinates, and what takes energy at the tool takes energy at the arm.

    Attributes:
        base: How the arm's frame lies in the organ's.
        force_scale: Newtons at the arm per newton on the tool.
    """

    base: ArmBase
    force_scale: float = 1.0

    @property
    def torque_scale(self) -> float:
        """Newton metres at the arm per newton metre on the tool."""
        return self.force_scale / self.base.scale

    def at_arm(self, wrench: NDArray[np.float64]) -> NDArray[np.float64]:
        """A wrench on the tool, in the organ's axes, as one on the arm, shape (6,)."""
        parts = wrench.reshape(2, 3) @ self._rotation
        parts *= ((self.force_scale,), (self.torque_scale,))
        return parts.reshape(6)

    @cached_property
    def _rotation(self) -> NDArray[np.float64]:
        rotation: NDArray[np.float64] = self.base.rotation.as_matrix()
        return rotation

    def on_tool(self, limits: ForceLimits) -> ForceLimits:
        """The arm's limits as limits of the wrench on the tool."""
        return ForceLimits(
            limits.max_force / self.force_scale,
            limits.max_torque / self.torque_scale,
            limits.max_force_rate / self.force_scale,
            limits.max_torque_rate / self.torque_scale,
        )

    def per_length(self, most: float) -> float:
        """The arm's largest stiffness or damping as one of the tool's: force per the tool's way."""
        return most / (self.force_scale * self.base.scale)
