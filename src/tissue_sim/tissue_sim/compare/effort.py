"""How much a model may do in a frame."""

from __future__ import annotations

import re
from dataclasses import dataclass

MOST_STEPS = 20_000
"""Steps of a frame after which a model counts as not coming to rest."""


@dataclass(frozen=True)
class Effort:
    """Steps in every frame, time in every frame, or as many steps as equilibrium takes.

    None of them given: a model in time makes the steps that its time step asks for, any other one
    step a frame.

    Attributes:
        steps: Steps a frame; fractions are carried over to the next one. Reproducible.
        seconds: Time a frame on this machine [s]; at least one step is made.
        to_rest: Steps until nothing moves by more than `to_rest` [m] in one of them.
    """

    steps: float | None = None
    seconds: float | None = None
    to_rest: float | None = None

    @classmethod
    def parse(cls, text: str) -> Effort:
        """The effort that a person means: "2.9" steps, "4ms", "rest", or "time" for 1 x real time.

        Raises:
            ValueError: It is none of these, or out of range.
        """
        text = text.strip()
        allowed = (
            'allowed: steps a frame such as 2.9 (0.01 to 10000), milliseconds a frame such as 4ms '
            '(0.01ms to 10000ms), "rest" (to equilibrium in every frame), "time" (as many steps as '
            "the model's time step asks for)"
        )  # fmt: skip
        if text == "rest":
            return cls(to_rest=1e-9)
        if text == "time":
            return cls()
        match = re.fullmatch(r"([0-9.]+(?:e-?[0-9]+)?)\s*(ms)?", text)
        try:
            value = float(match[1]) if match else 0.0
        except ValueError:
            value = 0.0
        if not 0.01 <= value <= 10_000:
            raise ValueError(f"effort {text!r} is not possible; {allowed}")
        return cls(seconds=1e-3 * value) if match and match[2] else cls(steps=value)

    def __str__(self) -> str:
        if self.steps is not None:
            return f"{self.steps:g} steps a frame"
        if self.seconds is not None:
            return f"{1e3 * self.seconds:g} ms a frame"
        return "to rest" if self.to_rest is not None else "as its time step asks"

    @property
    def text(self) -> str:
        """The effort as `parse` reads it; "rest" forgets how still that is."""
        if self.steps is not None:
            return shortest(self.steps)
        if self.seconds is not None:
            return f"{shortest(1e3 * self.seconds)}ms"
        return "rest" if self.to_rest is not None else "time"

    @property
    def reproducible(self) -> bool:
        """Whether another run makes the same steps."""
        return self.seconds is None


def shortest(value: float) -> str:
    """The shortest text that is read as the same number."""
    return repr(float(value)).removesuffix(".0")
