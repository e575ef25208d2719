"""How smooth a movement is, from its speed.

References:
    S. Balasubramanian, A. Melendez-Calderon, E. Burdet: A Robust and Sensitive Metric for
    Quantifying Movement Smoothness. IEEE Trans. Biomed. Eng. 59(8), 2012, 2126-2136,
    doi:10.1109/TBME.2011.2179545.
    S. Balasubramanian, A. Melendez-Calderon, A. Roby-Brami, E. Burdet: On the analysis of movement
    smoothness. J. NeuroEng. Rehab. 12:112, 2015, doi:10.1186/s12984-015-0090-9.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

HIGHEST_HZ = 10.0
"""Highest frequency looked at: faster motion is not a hand's."""
LEAST_SHARE = 0.05
"""The spectrum ends where it stays below this share of its value at frequency 0."""
PADDING = 4
"""The spectrum is sampled 2^4 times as finely as the movement's length asks for."""
FEWEST = 8
"""Samples a movement needs at least."""


def spectral_arc_length(
    speed: NDArray[np.float64], rate_hz: float, share: float = LEAST_SHARE
) -> float:
    """Spectral arc length of a movement (SPARC); dimensionless, the closer to 0 the smoother.

    Minus the length of the curve of the speed's amplitude spectrum, which is divided by its value
    at frequency 0, over frequencies divided by the cut-off. That is the last frequency up to
    `HIGHEST_HZ` at which the spectrum reaches a share (the adaptive cut-off of 2015).

    It does not depend on how fast or how far the movement goes, and hardly on noise. A minimum jerk
    movement has -1.41; each further submovement or pause makes it more negative.

    Args:
        speed: Of the movement, evenly sampled, shape (n,), n at least `FEWEST`.
        rate_hz: Samples per second [1/s].
        share: Share of the spectrum's value at frequency 0.

    Returns:
        The arc length; nan where nothing moves or samples are too few.
    """
    if len(speed) < FEWEST or not speed.any():
        return float("nan")
    count = 2 ** (int(np.ceil(np.log2(len(speed)))) + PADDING)
    frequencies = np.fft.rfftfreq(count, 1.0 / rate_hz)
    spectrum = np.abs(np.fft.rfft(speed, count))
    spectrum /= spectrum[0]
    reached = np.flatnonzero((frequencies <= HIGHEST_HZ) & (spectrum >= share))
    last = reached[-1]
    if last == 0:
        return float("nan")
    across = np.diff(frequencies[: last + 1]) / frequencies[last]
    return -float(np.hypot(across, np.diff(spectrum[: last + 1])).sum())


def log_dimensionless_jerk(speed: NDArray[np.float64], rate_hz: float) -> float:
    """Log dimensionless jerk of a movement (LDLJ); the closer to 0 the smoother.

    -ln(T^3 / v_peak^2 * integral of (d2v/dt2)^2 dt) of the speed v over the duration T. A minimum
    jerk movement has -ln(204.8) = -5.32. It uses two differences of the speed, so it grows with
    noise and with the rate of sampling: compare it only among sessions recorded in one way.

    Args:
        speed: Of the movement, evenly sampled, shape (n,), n at least `FEWEST`.
        rate_hz: Samples per second [1/s].

    Returns:
        The value; nan where nothing moves evenly or samples are too few.
    """
    if len(speed) < FEWEST or not speed.any():
        return float("nan")
    jerk = np.diff(speed, 2) * rate_hz**2
    duration = (len(speed) - 1) / rate_hz
    # The two ends, where there is no second difference, count like their neighbours.
    squared = float((jerk * jerk).mean()) * duration
    dimensionless = duration**3 / float(speed.max()) ** 2 * squared
    return -float(np.log(dimensionless)) if dimensionless > 0.0 else float("nan")
