"""The box that a source of motion may move its tool in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Workspace:
    """A box along the axes of the organ.

    Attributes:
        low: Its lowest corner [m], shape (3,).
        high: Its highest corner [m], shape (3,).
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @classmethod
    def between(cls, low: ArrayLike, high: ArrayLike) -> Workspace:
        """A box from its corners [m].

        Raises:
            ValueError: It is empty along an axis.
        """
        box = cls(np.array(low, dtype=np.float64), np.array(high, dtype=np.float64))
        if not (box.low < box.high).all():
            raise ValueError(
                f"workspace_min = {box.low.tolist()} must be less than workspace_max = "
                f"{box.high.tolist()} along each axis"
            )
        return box

    def nearest(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """The point of the box nearest to a point [m], shape (3,)."""
        return np.clip(point, self.low, self.high)

    def limited(
        self, before: NDArray[np.float64], after: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Where a step ends that must not leave the box.

        A tool that begins outside may come in and slide along, never go farther out; it does not
        jump to the box.

        Args:
            before: Where the step begins [m], shape (3,).
            after: Where it would end [m], shape (3,).
        """
        low, high = np.minimum(self.low, before), np.maximum(self.high, before)
        return np.clip(after, low, high)
