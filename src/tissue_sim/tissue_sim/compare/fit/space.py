"""What a fit may change: values of a subject, each with bounds and a scale."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.subject import Subject, allowed_names
from tissue_sim.elastic import registry

WHOLE_NUMBERS = frozenset({"springs.per_element"})
"""Values that are whole numbers besides the models' own parameters that say so themselves."""

HOW = (
    "write NAME=LOW..HIGH, or NAME=LOW..HIGH:log for a logarithmic scale, for example "
    "springs.stiffness=0.1..100:log"
)


@dataclass(frozen=True)
class FitParameter:
    """A value that a fit may change.

    Attributes:
        name: Name as in `Subject.values`.
        low, high: Bounds, in the value's own unit.
        log: Whether equal ratios, not equal differences, are equally far apart.
        integer: Whether only whole numbers are allowed.
    """

    name: str
    low: float
    high: float
    log: bool = False
    integer: bool = False

    def __post_init__(self) -> None:
        """Refuse bounds between which there is nothing.

        Raises:
            ValueError: They are not finite, not in order, or not positive on a logarithmic scale.
        """
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(
                f"{self.name} from {self.low:g} to {self.high:g} is no range; allowed: two "
                "finite numbers, the lower one first"
            )
        if self.log and self.low <= 0.0:
            raise ValueError(
                f"{self.name} from {self.low:g} cannot have a logarithmic scale; allowed: bounds "
                "above 0"
            )

    def value(self, unit: float) -> float:
        """The value at a place from 0 (low) to 1 (high); places outside count as the nearest."""
        place = min(max(float(unit), 0.0), 1.0)
        if self.log:
            value = self.low * (self.high / self.low) ** place
        else:
            value = self.low + (self.high - self.low) * place
        if self.integer:
            value = round(value)
        return float(min(max(value, self.low), self.high))

    def place(self, value: float) -> float:
        """The place of a value; the inverse of `value`.

        Raises:
            ValueError: The value is out of bounds.
        """
        if not self.low <= value <= self.high:
            raise ValueError(
                f"{self.name} = {value:g} is out of bounds; allowed: {self.low:g} to {self.high:g}"
            )
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


@dataclass(frozen=True)
class Space:
    """The values that a fit may change, as a unit cube: all strategies search in [0, 1]^n.

    Attributes:
        parameters: One for each side of the cube.
    """

    parameters: tuple[FitParameter, ...]

    def __post_init__(self) -> None:
        """Refuse a cube that has no sides, or two of one name.

        Raises:
            ValueError: It is one of these.
        """
        if not self.parameters:
            raise ValueError(f"there is nothing to fit; {HOW}")
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise ValueError(f"{twice[0]} is there twice; allowed: one range for each value")

    @classmethod
    def parse(cls, *ranges: str) -> Space:
        """The space of ranges as `parse_range` reads them."""
        return cls(tuple(parse_range(text) for text in ranges))

    @property
    def size(self) -> int:
        """Number of values."""
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(parameter.name for parameter in self.parameters)

    def decode(self, unit: NDArray[np.float64]) -> dict[str, float]:
        """The values at a point of the unit cube, shape (size,)."""
        places = zip(self.parameters, unit, strict=True)
        return {parameter.name: parameter.value(place) for parameter, place in places}

    def encode(self, values: Mapping[str, float]) -> NDArray[np.float64]:
        """The point of the unit cube at which values are, shape (size,).

        Raises:
            ValueError: A value is missing or out of bounds.
        """
        missing = [name for name in self.names if name not in values]
        if missing:
            raise ValueError(f"{missing[0]} has no value; needed: {', '.join(self.names)}")
        return np.array([entry.place(values[entry.name]) for entry in self.parameters])

    def checked(self, subject: Subject) -> Space:
        """This space, its whole numbers marked, if a subject can have the values at its bounds.

        Raises:
            ValueError: The subject's model has no such value, or not in this range.
        """
        whole = WHOLE_NUMBERS | {
            entry.name for entry in registry.parameters_of(subject.model) if entry.integer
        }
        allowed = allowed_names(subject.model)
        for entry in self.parameters:
            if entry.name not in allowed:
                raise ValueError(
                    f"model {subject.model} has no value {entry.name!r}; allowed: "
                    f"{', '.join(allowed)}"
                )
            for bound in (entry.low, entry.high):
                _check_bound(subject, entry.name, bound)
        return Space(
            tuple(replace(entry, integer=entry.name in whole) for entry in self.parameters)
        )


def parse_range(text: str) -> FitParameter:
    """The parameter of NAME=LOW..HIGH[:log], such as "step=0.1..1.9".

    Raises:
        ValueError: It cannot be read.
    """
    name, equals, bounds = text.partition("=")
    bounds, colon, scale = bounds.partition(":")
    low, dots, high = bounds.partition("..")
    if not (name.strip() and equals and dots) or (colon and scale.strip() != "log"):
        raise ValueError(f"range {text!r} is not understood; {HOW}")
    try:
        return FitParameter(name.strip(), float(low), float(high), bool(colon))
    except ValueError as error:
        raise ValueError(f"range {text!r} is not understood: {error}; {HOW}") from error


def _check_bound(subject: Subject, name: str, bound: float) -> None:
    try:
        subject.with_values({name: bound}).checked()
    except ValueError as error:
        raise ValueError(f"bound {bound:g} of {name}: {error}") from error
