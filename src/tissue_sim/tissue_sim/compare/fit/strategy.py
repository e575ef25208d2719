"""How a search decides where to look next."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

LARGEST = 2**31
"""Largest seed and population."""


@runtime_checkable
class Strategy(Protocol):
    """Asked for candidates, told their errors, generation after generation.

    Candidates are points of the unit cube. The same seed and the same errors give the same
    candidates bit for bit, and so does a strategy whose state was restored.

    Attributes:
        settings: What it was made with, as plain JSON values by name: its kind, its seed, ...
    """

    settings: dict[str, Any]

    @property
    def finished(self) -> bool:
        """Whether it sees no sense in going on."""

    def ask(self) -> NDArray[np.float64]:
        """The candidates of the next generation, shape (count, size)."""

    def tell(self, candidates: NDArray[np.float64], errors: NDArray[np.float64]) -> None:
        """Learn how good the candidates are that it was asked for.

        Args:
            candidates: As `ask` gave them, shape (count, size).
            errors: Their errors, shape (count,).
        """

    def state(self) -> dict[str, Any]:
        """All that `restore` needs, as plain JSON values; between `tell` and `ask`."""

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from where a strategy with the same settings was.

        Raises:
            ValueError: This is no state of such a strategy.
        """


def check_settings(**settings: tuple[float, float, float]) -> None:
    """Refuse settings that are out of range.

    Args:
        settings: Value, smallest and largest value allowed, by name.

    Raises:
        ValueError: One is out of range.
    """
    for name, (value, low, high) in settings.items():
        if not low <= value <= high:
            raise ValueError(f"{name} = {value:g} is out of range; allowed: {low:g} to {high:g}")
