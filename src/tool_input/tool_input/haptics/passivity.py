"""Energy through a haptic port, and the damper that keeps the loop from creating any."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.interaction.reaction import shortened

Reals = NDArray[np.float64]

LEAST_SQUARE = 1e-16
"""A shorter square of a motion [m^2] gives a damper nothing to work with."""


class PassivityController:
    """Time-domain passivity observer and controller of one port of six coordinates.

    Between two ticks the device holds a wrench f while the hand moves by d: the loop takes the
    energy -f . d from it. What it has taken in all and not given back is `energy`. A wrench that
    would give back more over the next tick is changed along the motion by a damper of just the
    strength that the energy stays at zero. That can only be off by what the hand's motion differs
    from the one predicted; what is missing then is taken in the next ticks, by a damper no stronger
    than `damping`, since a sampled damper must not be stronger than a device bears.

    References:
        Hannaford, B. and Ryu, J.-H. (2002): Time-domain passivity control of haptic interfaces.
        IEEE Trans. Robotics and Automation 18(1), 1-10.

    Attributes:
        energy: Taken from the hand and not given back [J].
        lowest: The least it ever was [J].
        dissipated: What the dampers took, as predicted [J].
        corrections: Ticks in which they acted.
    """

    def __init__(self, arm: float, damping: float, period: float) -> None:
        """Begin with no energy.

        Args:
            arm: Way that counts as a radian [m].
            damping: Of the strongest damper that takes back energy [N s/m].
            period: Time of a tick [s].
        """
        self.energy = self.lowest = self.dissipated = 0.0
        self.corrections = 0
        self._metric = np.array([1.0, 1.0, 1.0, arm**2, arm**2, arm**2])
        self._strongest = damping / period

    def observe(self, wrench: Reals, motion: Reals) -> None:
        """Count the energy of a wrench that was held while the hand moved, shapes (6,)."""
        self.energy -= float(wrench @ motion)
        self.lowest = min(self.lowest, self.energy)

    def correct(self, wrench: Reals, motion: Reals) -> Reals:
        """The wrench that may be held next, shape (6,).

        Args:
            wrench: That is wanted, shape (6,).
            motion: That the hand is expected to make while it is held, shape (6,).
        """
        given = float(wrench @ motion)
        square = float(motion @ (self._metric * motion))
        if given <= self.energy or square < LEAST_SQUARE:
            return wrench
        # Down to no power at all the force is only taken away; beyond that it is a damper's.
        harmless = max(given, 0.0) / square
        strength = min((given - self.energy) / square, harmless + self._strongest)
        self.corrections += 1
        self.dissipated += strength * square
        corrected: Reals = wrench - strength * self._metric * motion
        return corrected

    def forget(self) -> None:
        """Nothing touches the hand any more: what it has put in is lost, what it is owed is not."""
        self.energy = min(self.energy, 0.0)


def bounded(wrench: Reals, force: float, torque: float) -> Reals:
    """A wrench no longer than these limits [N], [N m], shape (6,)."""
    return np.concatenate([shortened(wrench[:3], force), shortened(wrench[3:], torque)])
