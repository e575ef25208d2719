"""Where a point of the page's scene is in the window, and what a pixel of it sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Camera:
    """A pinhole camera that looks along its z axis, x to the right and y down.

    Attributes:
        position: Where it is, in the page's units, shape (3,).
        axes: Columns: its x, y and z axis in the page's frame, shape (3, 3).
        focal: Focal length [pixels].
        middle: Pixel that its z axis goes through, shape (2,).
    """

    position: NDArray[np.float64]
    axes: NDArray[np.float64]
    focal: float
    middle: NDArray[np.float64]

    @classmethod
    def told(cls, message: dict[str, Any]) -> Camera:
        """The camera of a `ViewerCameraMessage`, as viser's page sends it."""
        width, height = float(message["image_width"]), float(message["image_height"])
        return cls(
            np.array(message["position"], dtype=np.float64),
            Rotation.from_quat(message["wxyz"], scalar_first=True).as_matrix(),
            height / 2 / float(np.tan(message["fov"] / 2)),
            np.array([width / 2, height / 2]),
        )

    def pixels(self, points: ArrayLike) -> NDArray[np.float64]:
        """Where points are seen.

        Args:
            points: In front of the camera, in the page's units, shape (n, 3).

        Returns:
            Pixels from the upper left corner, shape (n, 2).
        """
        seen = (np.asarray(points, dtype=np.float64) - self.position) @ self.axes
        return self.middle + self.focal * seen[:, :2] / seen[:, 2:]

    def ray(self, pixel: ArrayLike) -> NDArray[np.float64]:
        """Unit direction in which a pixel, shape (2,), looks, shape (3,)."""
        aside = (np.asarray(pixel, dtype=np.float64) - self.middle) / self.focal
        along = self.axes @ np.array([*aside, 1.0])
        return np.asarray(along / np.linalg.norm(along))
