"""What a probe presses with: pressure by depth and speed of penetration, and Coulomb friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from tissue_sim.elastic.model import Parameter
from tissue_sim.interaction.tool_numbers import ToolNumbers

PARAMETERS = (
    Parameter(
        "contact_stiffness", 2e7, 1e3, 1e12, "Pa/m", "pressure on tissue per depth of penetration"
    ),
    Parameter(
        "contact_damping", 2e4, 0.0, 1e9, "Pa s/m", "pressure on tissue per speed of penetration"
    ),
    Parameter("contact_friction", 0.2, 0.0, 10.0, "", "Coulomb's coefficient of friction"),
)  # fmt: skip
"""What can be set for each tool that probes."""


@dataclass(frozen=True)
class Contact(ToolNumbers):
    """A penalty contact, p = max(0, kappa d + delta dd/dt) at the depth d of penetration.

    Attributes:
        contact_stiffness: kappa [Pa/m].
        contact_damping: delta [Pa s/m].
        contact_friction: Largest friction over normal force.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = PARAMETERS

    contact_stiffness: float = 2e7
    contact_damping: float = 2e4
    contact_friction: float = 0.2
