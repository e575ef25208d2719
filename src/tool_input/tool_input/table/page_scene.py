"""The scene of one window, and how metres of the organ become its units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import ArrayLike, NDArray

ORGAN_SIZE = 2.0
"""The organ's largest extent on the page in its own units; viser's camera suits this size."""


@dataclass(frozen=True)
class Placement:
    """Where the organ is on the page, and how large.

    Attributes:
        centre: The point of the organ that is the page's origin [m], shape (3,).
        scale: The page's units per metre.
    """

    centre: NDArray[np.float64]
    scale: float

    @classmethod
    def around(cls, points: NDArray[np.floating]) -> Placement:
        """The placement that shows all of some points [m], shape (n, 3), n > 0."""
        low, high = points.min(axis=0), points.max(axis=0)
        extent = max(float((high - low).max()), 1e-9)
        return cls(((low + high) / 2).astype(np.float64), ORGAN_SIZE / extent)


class PageScene:
    """What is drawn in one window; the only place that knows the page's units.

    Attributes:
        api: viser's scene of the window. What is put there is in the page's units.
        placement: Where the organ is; another one after another organ was loaded.
    """

    def __init__(self, api: viser.SceneApi, placement: Placement) -> None:
        """Wrap a window's scene."""
        self.api = api
        self.placement = placement

    @property
    def organ_size(self) -> float:
        """The organ's largest extent at rest [m], to two digits: sizes of tools follow from it."""
        return float(f"{ORGAN_SIZE / self.placement.scale:.2g}")

    def to_page(self, points: ArrayLike) -> NDArray[np.float32]:
        """Points of the organ [m], shape (..., 3), in the page's units."""
        given = np.asarray(points)
        return ((given - self.placement.centre) * self.placement.scale).astype(np.float32)

    def to_organ(self, points: ArrayLike) -> NDArray[np.float64]:
        """Points of the page, shape (..., 3), in metres of the organ."""
        given = np.asarray(points, dtype=np.float64)
        return given / self.placement.scale + self.placement.centre

    def length(self, metres: float) -> float:
        """A length [m] in the page's units."""
        return metres * self.placement.scale
