"""What lies along a line of sight: the tissue's surface, and the wall of tissue behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.rays import crossings
from tissue_sim.geometry.sheet import CONNECTING
from tool_input.table.tissue_frame import TissueFrame

Vec3 = NDArray[np.float64]


class Wall(NamedTuple):
    """The first layer of tissue along a ray, as distances from the eye [m].

    Attributes:
        near: Where the ray comes in.
        far: Where it goes out; `near` for tissue without thickness.
        next: Where it meets the next layer; infinite if there is none.
    """

    near: float
    far: float
    next: float


class Hit(NamedTuple):
    """A point of the surface.

    Attributes:
        point: Where it is [m], shape (3,).
        rest: Where it is when the tissue is at rest [m], shape (3,).
        normal: Outward unit normal there, shape (3,).
    """

    point: Vec3
    rest: Vec3
    normal: Vec3


@dataclass(frozen=True)
class Sight:
    """The surface of the tissue in one shape.

    Attributes:
        positions: Of its nodes [m], shape (n, 3).
        rest: Of its nodes at rest [m], shape (n, 3).
        triangles: Rows of nodes, outward normals, shape (m, 3).
        thin: Whether the triangles themselves are the tissue, so that a wall has no other side.
    """

    positions: NDArray[np.floating]
    rest: NDArray[np.float64]
    triangles: NDArray[np.integer]
    thin: bool = False

    @classmethod
    def of(cls, frame: TissueFrame) -> Sight:
        """The surface in the shape of one frame."""
        nodes, sheet = frame.surface.nodes, frame.mesh.sheet
        thin = sheet is not None and not bool((sheet.categories == CONNECTING).any())
        return cls(frame.positions[nodes], frame.mesh.rest[nodes], frame.surface.triangles, thin)

    @property
    def edge(self) -> float:
        """Mean length of the surface's edges at rest [m]."""
        first, second = self.rest[self.triangles[:, 0]], self.rest[self.triangles[:, 1]]
        return float(np.linalg.norm(second - first, axis=1).mean())

    def hit(self, eye: Vec3, direction: Vec3) -> Hit | None:
        """Where a ray meets the surface first; None if it does not.

        Args:
            eye: Its origin [m], shape (3,).
            direction: Unit vector, shape (3,).
        """
        found = crossings(self.positions, self.triangles, eye, direction)
        if not len(found.distance):
            return None
        point = eye + found.distance[0] * direction
        nodes = self.triangles[found.triangle[0]]
        corners = self.positions[nodes].astype(np.float64)
        u, v = corners[1] - corners[0], corners[2] - corners[0]
        across = np.cross(u, v)
        square = max(float(across @ across), np.finfo(float).tiny)
        offset = point - corners[0]
        second = float(np.cross(offset, v) @ across) / square
        third = float(np.cross(u, offset) @ across) / square
        weights = np.array([1.0 - second - third, second, third])
        return Hit(point, weights @ self.rest[nodes], across / np.sqrt(square))

    def wall(self, eye: Vec3, direction: Vec3, gap: float) -> Wall | None:
        """The first layer of tissue along a ray; None if it meets none.

        Args:
            eye: Its origin [m], shape (3,).
            direction: Unit vector, shape (3,).
            gap: Layers that are nearer to each other than this count as one, such as a patch and
                what it lies on [m].
        """
        found = crossings(self.positions, self.triangles, eye, direction)
        if self.thin:
            distances = [(float(distance), float(distance)) for distance in found.distance]
        else:
            distances = _layers(found.distance, found.leaving)
        if not distances:
            return None
        near, far = distances[0]
        for begin, end in distances[1:]:
            if begin - far > gap:
                return Wall(near, far, begin)
            far = end
        return Wall(near, far, np.inf)


def _layers(distance: NDArray[np.float64], leaving: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Where a ray comes in and goes out, layer by layer.

    A ray through an edge may meet it twice, and parts may overlap. So what goes out once more
    belongs to the layer before, and what comes in once more to the layer it is in.
    """
    layers: list[tuple[float, float]] = []
    begun: float | None = None
    for at, out in zip(distance.tolist(), leaving.tolist(), strict=True):
        if not out:
            begun = at if begun is None else begun
        elif begun is not None:
            layers.append((begun, at))
            begun = None
        elif layers:
            layers[-1] = (layers[-1][0], at)
        else:
            layers.append((0.0, at))
    return layers


def warm_up() -> None:
    """Compile what a hit needs, or load it from numba's cache, before somebody drags."""
    corners = np.eye(3)
    triangle = np.array([[0, 1, 2]], dtype=np.uint32)
    Sight(corners.astype(np.float32), corners, triangle).hit(np.zeros(3), np.ones(3) / np.sqrt(3))
