"""The spring and damper between a tool and the tissue it holds by force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Parameter
from tissue_sim.interaction import rigid
from tissue_sim.interaction.reaction import shortened
from tissue_sim.interaction.tool_numbers import ToolNumbers
from tissue_sim.kernels.patches import PatchNumbers

POSITION, FORCE = "position", "force"
HOLDS = (POSITION, FORCE)
"""How a tool holds: nodes are where it puts them, or are pulled there."""

PARAMETERS = (
    Parameter("stiffness", 500.0, 0.01, 1e8, "N/m", "force per distance between tool and tissue"),
    Parameter("damping", 5.0, 0.0, 1e6, "N s/m", "force per speed of the tissue held"),
    Parameter(
        "angular_stiffness", 0.05, 1e-6, 1e6, "N m/rad",
        "torque per angle between tool and tissue",
    ),
    Parameter(
        "angular_damping", 5e-4, 0.0, 1e4, "N m s/rad",
        "torque per angular speed of the tissue held",
    ),
    Parameter("force_limit", 20.0, 1e-4, 1e6, "N", "largest force of the coupling"),
    Parameter("torque_limit", 2.0, 1e-6, 1e6, "N m", "largest torque of the coupling"),
)  # fmt: skip
"""What can be set for each tool that grabs."""


@dataclass(frozen=True)
class Coupling(ToolNumbers):
    """A virtual coupling: a spring that gives way at its limit, and a damper; see `PARAMETERS`.

    Attributes:
        stiffness: Of the spring between the tool's tip and the patch's [N/m].
        damping: Of the patch's motion [N s/m].
        angular_stiffness: Of the spring between their orientations [N m/rad].
        angular_damping: Of the patch's turning [N m s/rad].
        force_limit: Largest force of the spring [N]; beyond it the force stays the same.
        torque_limit: Largest torque of the spring [N m].
    """

    parameters: ClassVar[tuple[Parameter, ...]] = PARAMETERS

    stiffness: float = 500.0
    damping: float = 5.0
    angular_stiffness: float = 0.05
    angular_damping: float = 5e-4
    force_limit: float = 20.0
    torque_limit: float = 2.0

    def numbers(self, seconds: float) -> PatchNumbers:
        """What the kernels want of it for a time step [s]."""
        return PatchNumbers(
            self.stiffness, self.angular_stiffness,
            self.damping / seconds, self.angular_damping / seconds,
            self.force_limit, self.torque_limit,
        )  # fmt: skip

    def tangent(self, tool: NDArray[np.float64], patch: NDArray[np.float64]) -> NDArray[np.float64]:
        """The spring's stiffness there, shape (6, 6): none along a force that is at its limit.

        Args:
            tool: Pose of the tool, shape (7,).
            patch: Pose of the patch, shape (7,).
        """
        way = rigid.motion(tool, patch)
        tangent = np.zeros((6, 6))
        for part, stiffness, limit in (
            (slice(0, 3), self.stiffness, self.force_limit),
            (slice(3, 6), self.angular_stiffness, self.torque_limit),
        ):
            length = float(np.linalg.norm(way[part]))
            tangent[part, part] = stiffness * np.eye(3)
            if stiffness * length > limit:
                along = way[part] / length
                tangent[part, part] = limit / length * (np.eye(3) - np.outer(along, along))
        return tangent

    def wrench_on_tool(
        self, tool: NDArray[np.float64], patch: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Force [N] and torque about the tip [N m] that the spring puts on the tool, shape (6,).

        Args:
            tool: Pose of the tool, shape (7,).
            patch: Pose of the patch, shape (7,).
        """
        way = rigid.motion(tool, patch)
        pull, twist = self.stiffness * way[:3], self.angular_stiffness * way[3:]
        return np.concatenate(
            [shortened(pull, self.force_limit), shortened(twist, self.torque_limit)]
        )
