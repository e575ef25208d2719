"""The force that tissue puts on a tool."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NOTHING = np.zeros(6)
NOTHING.flags.writeable = False


def wrench_on_tool(
    forces: NDArray[np.float64], points: NDArray[np.float64], tip: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Force and torque about the tip that tissue puts on the tool that holds it, shape (6,).

    Minus the sum of the internal forces f_int = dE/dx of the held nodes (E the elastic energy).
    `Model.forces` gives the forces that springs or elements put on nodes, which are -f_int: held
    nodes pass them on to the tool. Tissue pulled along +x pulls the tool along -x.

    Args:
        forces: What `Model.forces` gives for the held nodes [N], shape (n, 3).
        points: Their positions [m], shape (n, 3).
        tip: Position of the tool's tip [m], shape (3,).
    """
    torque = np.cross(points - tip, forces).sum(axis=0)
    return np.concatenate([forces.sum(axis=0), torque])


@dataclass(frozen=True)
class ForceLimits:
    """What a force display can bear.

    Attributes:
        max_force: Largest force [N].
        max_torque: Largest torque [N m].
        max_force_rate: Fastest change of force [N/s].
        max_torque_rate: Fastest change of torque [N m/s].
    """

    max_force: float = 20.0
    max_torque: float = 2.0
    max_force_rate: float = 200.0
    max_torque_rate: float = 20.0


class ForceLimiter:
    """Bounds the force on one tool and how fast it changes.

    Attributes:
        wrench: What was published last, shape (6,).
    """

    def __init__(self, limits: ForceLimits) -> None:
        self.limits = limits
        self.wrench = np.zeros(6)

    def next(self, wanted: NDArray[np.float64] | None, period: float) -> NDArray[np.float64]:
        """The force to publish.

        Args:
            wanted: Force and torque of the model, shape (6,); None: there must be none at once.
            period: Time since the last one [s].
        """
        if wanted is None or not np.isfinite(wanted).all():
            self.wrench = np.zeros(6)
            return self.wrench
        limits = self.limits
        parts = (
            (slice(0, 3), limits.max_force, limits.max_force_rate),
            (slice(3, 6), limits.max_torque, limits.max_torque_rate),
        )
        wrench = np.empty(6)
        for part, largest, rate in parts:
            bounded = shortened(wanted[part], largest)
            change = shortened(bounded - self.wrench[part], rate * period)
            wrench[part] = self.wrench[part] + change
        self.wrench = wrench
        return wrench


def shortened(vector: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
    """The vector, or one of the longest length allowed in its direction."""
    length = math.sqrt(vector.dot(vector))
    return vector if length <= longest else vector * (longest / length)
