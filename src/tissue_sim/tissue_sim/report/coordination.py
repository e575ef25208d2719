"""How two hands worked together.

References:
    E. F. Hofstad et al.: A study of psychomotor skills in minimally invasive surgery: what
    differentiates expert and nonexpert performance. Surg. Endosc. 27(3), 2013, 854-863,
    doi:10.1007/s00464-012-2524-9 (bimanual dexterity: simultaneous movement of both instruments).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.report.motion import IDLE_SPEED


@dataclass(frozen=True)
class Coordination:
    """How two hands worked together; nan where a figure has no meaning.

    Attributes:
        correlation: Pearson's correlation of their speeds, -1 to 1.
        together: Time in which both move over time in which any does, 0 to 1.
        balance: Way of the hand that goes less over that of the other, 0 to 1.
    """

    correlation: float
    together: float
    balance: float


def coordination_of(
    one: NDArray[np.float64], other: NDArray[np.float64], idle_speed: float = IDLE_SPEED
) -> Coordination:
    """How two hands worked together, from the first to the last movement of either.

    Args:
        one: Speed of a hand [m/s], evenly sampled, shape (n,).
        other: Speed of the other at the same times [m/s], shape (n,).
        idle_speed: A hand slower than this does not move [m/s].
    """
    moves = np.stack([one, other]) >= idle_speed
    any_moves = np.flatnonzero(moves.any(axis=0))
    nan = float("nan")
    if not len(any_moves):
        return Coordination(nan, nan, nan)
    part = slice(any_moves[0], any_moves[-1] + 1)
    a, b = one[part], other[part]
    varies = min(float(np.ptp(a)), float(np.ptp(b))) > 1e-9
    ways = sorted((float(a.sum()), float(b.sum())))
    return Coordination(
        correlation=float(np.corrcoef(a, b)[0, 1]) if varies and len(a) > 2 else nan,
        together=float(moves.all(axis=0).sum()) / len(any_moves),
        balance=ways[0] / ways[1] if ways[1] > 0.0 else nan,
    )
