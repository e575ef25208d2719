"""Numbers of a tool that people can set, with their limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import ClassVar, Self

from tissue_sim.elastic.model import Parameter


@dataclass(frozen=True)
class ToolNumbers:
    """Numbers with a parameter for each, of the same name.

    Attributes:
        parameters: Their limits and units.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = ()

    def checked(self) -> Self:
        """These numbers, if they are allowed.

        Raises:
            ValueError: One is out of range; the message names the limits.
        """
        for parameter in self.parameters:
            parameter.checked(getattr(self, parameter.name))
        return self

    def as_arguments(self) -> dict[str, float]:
        """The numbers by name; plain JSON values."""
        return asdict(self)

    @classmethod
    def from_arguments(cls, arguments: Mapping[str, float]) -> Self:
        """Checked numbers by name; defaults for those left out.

        Raises:
            ValueError: A name is unknown or a number out of range.
        """
        known = [field.name for field in fields(cls)]
        unknown = sorted(set(arguments) - set(known))
        if unknown:
            raise ValueError(f"unknown {', '.join(unknown)}; allowed: {', '.join(known)}")
        return cls(**{name: float(value) for name, value in arguments.items()}).checked()
