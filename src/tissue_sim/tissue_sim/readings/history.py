"""What a quantity is now, and what it has been."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Reading:
    """One quantity in one frame, and what it has been; numbers in the quantity's unit.

    Attributes:
        name: Of the quantity.
        peak: Largest at a node.
        peak_row: Row of that node.
        mean: Over the nodes where it has a meaning.
        highest: Largest peak since the history began.
        highest_at: When that was [s].
        integrated: Time integral of the peak since then, in unit seconds.
    """

    name: str
    peak: float
    peak_row: int
    mean: float
    highest: float
    highest_at: float
    integrated: float


@dataclass
class _Past:
    time: float
    peak: float
    highest: float
    highest_at: float
    integrated: float = 0.0


class Histories:
    """Histories of quantities by name."""

    def __init__(self) -> None:
        """Begin with none."""
        self._past: dict[str, _Past] = {}

    def clear(self) -> None:
        """Begin anew."""
        self._past.clear()

    def take(self, name: str, values: NDArray[np.floating], time: float) -> Reading | None:
        """Take a quantity's values at the nodes at a time.

        Between two times the peak is taken to run straight (trapezoidal rule). A time that is not
        later than the last adds nothing to the integral.

        Args:
            name: Of the quantity.
            values: At each node, nan where it has no meaning, shape (n,).
            time: [s].

        Returns:
            What it is and has been; None: it has a meaning nowhere.
        """
        meant = np.isfinite(values)
        if not meant.any():
            return None
        row = int(np.argmax(np.where(meant, values, -np.inf)))
        peak = float(values[row])
        past = self._past.setdefault(name, _Past(time, peak, peak, time))
        past.integrated += 0.5 * (peak + past.peak) * max(time - past.time, 0.0)
        if peak > past.highest:
            past.highest, past.highest_at = peak, time
        past.time, past.peak = time, peak
        mean = float(np.mean(values, where=meant))
        return Reading(name, peak, row, mean, past.highest, past.highest_at, past.integrated)
