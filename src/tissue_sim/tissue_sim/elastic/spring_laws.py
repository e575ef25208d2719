"""Laws of springs: how the force grows with the elongation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissue_sim.elastic.model import Parameter
from tissue_sim.kernels.spring_laws import Law

LINEAR, BIPHASIC, CUBIC = 0, 1, 2

NEVER = 1e30
"""An elongation that no spring reaches, and that single precision can hold."""

PARAMETERS = (
    Parameter(
        "spring_law", LINEAR, LINEAR, CUBIC, "",
        "force of a spring against its elongation: 0: linear, 1: biphasic, 2: cubic polynomial",
        integer=True,
    ),
    Parameter(
        "critical_elongation", 0.1, 0.0, 10.0, "",
        "biphasic: elongation over rest length at which the stiffness changes",
    ),
    Parameter(
        "stiffness_ratio", 4.0, 0.0, 1000.0, "",
        "biphasic: stiffness beyond the critical elongation over that below it",
    ),
    Parameter("quadratic", 0.0, -100.0, 100.0, "", "cubic: coefficient of the squared elongation"),
    Parameter("cubic", 5.0, -100.0, 100.0, "", "cubic: coefficient of the cubed elongation"),
    Parameter(
        "polynomial_up_to", 0.5, 0.01, 10.0, "",
        "cubic: largest elongation or compression over rest length for which the polynomial holds; "
        "the force goes on straight beyond it",
    ),
)  # fmt: skip


@dataclass(frozen=True)
class SpringLaw:
    """f(e): a spring of stiffness k and rest length l0 pulls with k l0 f((l - l0) / l0).

    A polynomial e (1 + quadratic e + cubic e^2) for below <= e <= above, straight beyond.

    Attributes:
        quadratic, cubic: Coefficients.
        below, above: Where the polynomial ends.
        slope_below, slope_above: df/de beyond.
    """

    quadratic: float = 0.0
    cubic: float = 0.0
    below: float = -NEVER
    above: float = NEVER
    slope_below: float = 1.0
    slope_above: float = 1.0

    @property
    def linear(self) -> bool:
        """Whether it is f(e) = e."""
        return self == SpringLaw()

    def polynomial(self, e: float) -> float:
        """The polynomial's value."""
        return e * (1.0 + e * (self.quadratic + self.cubic * e))

    def slope(self, e: float) -> float:
        """The polynomial's slope."""
        return 1.0 + e * (2.0 * self.quadratic + 3.0 * self.cubic * e)

    def slopes(self) -> tuple[float, float]:
        """Smallest and largest df/de at any elongation."""
        ends = [e for e in (self.below, self.above) if abs(e) < NEVER]
        turn = -self.quadratic / (3.0 * self.cubic) if self.cubic else 0.0
        if self.below < turn < self.above:
            ends.append(turn)
        slopes = [1.0, self.slope_below, self.slope_above, *(self.slope(e) for e in ends)]
        return min(slopes), max(slopes)

    def for_kernels(self, dtype: type[np.floating]) -> Law:
        """The law in a kernel's precision."""
        below = self.polynomial(self.below) if self.below > -NEVER else -NEVER
        above = self.polynomial(self.above) if self.above < NEVER else NEVER
        numbers = (
            1.0, self.quadratic, self.cubic, self.above, above, self.slope_above,
            self.below, below, self.slope_below,
        )  # fmt: skip
        return Law(*(dtype(number) for number in numbers))


def spring_law(values: dict[str, float]) -> SpringLaw:
    """The law that parameters describe.

    Raises:
        ValueError: A polynomial whose force falls somewhere while the elongation grows.
    """
    if values["spring_law"] == BIPHASIC:
        return SpringLaw(above=values["critical_elongation"], slope_above=values["stiffness_ratio"])
    if values["spring_law"] != CUBIC:
        return SpringLaw()
    end = values["polynomial_up_to"]
    # No spring is compressed by more than its length.
    start = max(-end, -1.0)
    law = SpringLaw(values["quadratic"], values["cubic"], start, end)
    law = SpringLaw(law.quadratic, law.cubic, start, end, law.slope(start), law.slope(end))
    least = law.slopes()[0]
    if least < 0.0:
        raise ValueError(
            f"quadratic = {law.quadratic:g} and cubic = {law.cubic:g} make springs of negative "
            f"stiffness ({least:.3g} times that at rest) between elongations {start:g} and {end:g};"
            " allowed: 1 + 2 quadratic e + 3 cubic e^2 >= 0 there, or a smaller polynomial_up_to"
        )
    return law
