"""What a probe presses with: pressure by depth and speed of penetration, and Coulomb friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields

from tissue_sim.elastic.model import Parameter

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
class Contact:
    """A penalty contact, p = max(0, -kappa g - delta dg/dt) with the gap g < 0 inside the probe.

    Attributes:
        contact_stiffness: kappa [Pa/m].
        contact_damping: delta [Pa s/m].
        contact_friction: Largest friction over normal force.
    """

    contact_stiffness: float = 2e7
    contact_damping: float = 2e4
    contact_friction: float = 0.2

    def checked(self) -> Contact:
        """This contact, if it is allowed.

        Raises:
            ValueError: A parameter is out of range; the message names the limits.
        """
        for parameter in PARAMETERS:
            parameter.checked(getattr(self, parameter.name))
        return self

    def as_arguments(self) -> dict[str, float]:
        """Its parameters by name; plain JSON values."""
        return asdict(self)

    @classmethod
    def from_arguments(cls, arguments: Mapping[str, float]) -> Contact:
        """A checked contact from parameters by name; defaults for those left out.

        Raises:
            ValueError: A parameter is unknown or out of range.
        """
        known = [field.name for field in fields(cls)]
        unknown = sorted(set(arguments) - set(known))
        if unknown:
            raise ValueError(f"unknown {', '.join(unknown)}; allowed: {', '.join(known)}")
        return cls(**{name: float(value) for name, value in arguments.items()}).checked()
