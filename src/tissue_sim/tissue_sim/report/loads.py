"""What a quantity amounted to that was seen some times a second: forces on tools, stress."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LONGEST_GAP = 0.25
"""Samples farther apart than this have nothing between them [s]: nobody published meanwhile."""


@dataclass(frozen=True)
class Load:
    """What a quantity amounted to, in its unit.

    Attributes:
        peak: Its largest value.
        peak_at: When that was [s].
        mean: Its mean over the time in which it is not 0; nan: it always is.
        integral: Over time, by the trapezoidal rule, in unit seconds; nan for a single sample.
        loaded: Time in which it is not 0 [s].
    """

    peak: float
    peak_at: float
    mean: float
    integral: float
    loaded: float


def load_of(
    times: NDArray[np.float64], values: NDArray[np.float64], longest_gap: float = LONGEST_GAP
) -> Load | None:
    """What a quantity amounted to; None without samples.

    Args:
        times: Ascending [s], shape (n,).
        values: 0 or more, shape (n,).
        longest_gap: Samples farther apart have nothing between them [s].
    """
    if not len(times):
        return None
    gaps = np.diff(times)
    counted = np.where(gaps <= longest_gap, gaps, 0.0)
    pairs = 0.5 * (values[1:] + values[:-1])
    integral = float((pairs * counted).sum()) if len(times) > 1 else float("nan")
    loaded = float(counted[pairs > 0.0].sum())
    top = int(np.argmax(values))
    mean = integral / loaded if loaded > 0.0 else float("nan")
    return Load(float(values[top]), float(times[top]), mean, integral, loaded)
