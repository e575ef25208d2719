"""Anatomy of an infant's heart in numbers: chambers, walls and the courses of the great vessels.

Millimetres; axes x anterior, y left, z superior (REP 103 for a body).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.implicit import (
    Distances,
    Points,
    axes_along,
    dot,
    half_space,
    smooth_max,
    spline,
    tube,
    unit,
)

LOWER_CORNER = np.array([-31.0, -31.0, -37.0])
UPPER_CORNER = np.array([27.0, 34.0, 48.0])
"""A box around the heart [mm]."""

# Wall thickness [mm]. Vessel and vein walls of an infant are 1.0 to 1.3 mm; they are drawn
# thicker so that the default lattice resolves them.
LEFT_VENTRICLE_WALL = 4.2
RIGHT_VENTRICLE_WALL = 2.5
ATRIUM_WALL = 2.1
SEPTUM = 3.4
VESSEL_WALL = 2.1
BETWEEN_POOLS = 2.3
VALVE_PLANE = 2.7
ROUNDING = 1.2

APEX_DIRECTION = unit((0.30, 0.44, -0.85))
LEFT_VENTRICLE_CENTRE = np.array([2.5, 8.0, -9.5])
LEFT_VENTRICLE_RADII = (8.0, 8.0, 17.5)
LEFT_VENTRICLE_AXES = axes_along(APEX_DIRECTION, (1.0, 0.0, 0.0))
RIGHT_VENTRICLE_CENTRE = np.array([7.5, -3.0, -6.0])
RIGHT_VENTRICLE_RADII = (10.5, 13.0, 15.5)
RIGHT_VENTRICLE_AXES = axes_along((0.32, 0.30, -0.90), (1.0, -0.4, 0.0))


@dataclass(frozen=True)
class Vessel:
    """A hollow tube with a flat, open, rounded end.

    Attributes:
        name: What the surgeon calls it.
        side: "left" or "right", the blood pool it belongs to.
        region: Name of the region its wall belongs to.
        course: Control points of the centre line with the inner radius, rows (x, y, z, r) [mm];
            the last one is the open end.
        wall: Wall thickness [mm].
    """

    name: str
    side: str
    region: str
    course: tuple[tuple[float, float, float, float], ...]
    wall: float

    @cached_property
    def line(self) -> NDArray[np.float64]:
        """Smooth centre line with radii, shape (k, 4) [mm]."""
        return spline(self.course, per_span=6)

    @property
    def end(self) -> NDArray[np.float64]:
        """Middle of the open end [mm]."""
        return np.array(self.line[-1, :3])

    @property
    def end_direction(self) -> NDArray[np.float64]:
        """Outward normal of the open end."""
        return unit(self.line[-1, :3] - self.line[-2, :3])

    def lumen(self, points: Points) -> Distances:
        """Distance to the blood in the vessel, which ends just beyond the open end."""
        beyond = np.append(self.end + 4.0 * self.end_direction, self.line[-1, 3])
        return self._cut_tube(points, np.vstack([self.line, beyond]), 1.0, 0.0)

    def envelope(self, points: Points) -> Distances:
        """Distance to lumen and wall together, cut flat at the open end."""
        return self._cut_tube(points, self.line + np.array([0.0, 0.0, 0.0, self.wall]), 0.0, 1.0)

    def _cut_tube(
        self, points: Points, line: NDArray[np.float64], beyond: float, rounding: float
    ) -> Distances:
        """Tube cut flat; only its last part is cut, since an arch may cross the plane twice.

        Args:
            points: Places [mm], shape (n, 3).
            line: Centre line with radii, shape (k, 4) [mm].
            beyond: How far past the open end the cut lies [mm].
            rounding: Width of the cut's rounded edge [mm].
        """
        past_end = half_space(points, self.end, self.end_direction) - beyond
        reach = dot(line[:, :3] - self.end, self.end_direction)
        tail = len(line) - 1
        while tail > 1 and reach[tail] > -1.2 * line[-1, 3]:
            tail -= 1
        last = tube(points, line[tail - 1 :, :3], line[tail - 1 :, 3])
        last = smooth_max(last, past_end, rounding)
        if tail <= 1:
            return last
        return np.minimum(last, tube(points, line[: tail + 1, :3], line[: tail + 1, 3]))


AORTA = Vessel(
    "aorta",
    "left",
    "aorta",
    (
        (1.5, 2.0, 0.0, 3.9),
        (2.0, -2.0, 8.0, 4.2),
        (2.6, -5.0, 16.0, 4.0),
        (1.2, -4.9, 25.5, 3.8),
        (-4.0, -0.8, 32.6, 3.6),
        (-11.0, 3.8, 32.8, 3.4),
        (-16.2, 6.8, 29.6, 3.2),
        (-17.8, 7.6, 25.0, 3.1),
    ),
    VESSEL_WALL,
)
ARCH_BRANCHES = (
    Vessel(
        "brachiocephalic artery",
        "left",
        "aorta",
        ((-1.2, -3.2, 30.5, 2.0), (-1.0, -4.4, 36.0, 1.9), (-0.8, -5.6, 40.5, 1.9)),
        VESSEL_WALL,
    ),
    Vessel(
        "left common carotid artery",
        "left",
        "aorta",
        ((-6.0, 0.6, 33.0, 1.7), (-6.2, 1.2, 38.0, 1.6), (-6.4, 1.6, 42.0, 1.6)),
        VESSEL_WALL,
    ),
    Vessel(
        "left subclavian artery",
        "left",
        "aorta",
        ((-11.2, 4.2, 32.4, 1.7), (-11.6, 6.4, 37.0, 1.6), (-11.8, 9.4, 40.6, 1.6)),
        VESSEL_WALL,
    ),
)
PULMONARY_TRUNK_LINE = (
    (11.0, -3.5, 2.0, 4.6),
    (13.0, 0.0, 8.5, 4.2),
    (11.5, 4.6, 15.5, 4.1),
    (6.0, 7.8, 20.5, 3.9),
)
LEFT_PULMONARY_ARTERY = Vessel(
    "left pulmonary artery",
    "right",
    "pulmonary artery",
    (*PULMONARY_TRUNK_LINE, (-1.0, 12.0, 23.0, 2.8), (-7.0, 17.0, 23.0, 2.5)),
    VESSEL_WALL,
)
RIGHT_PULMONARY_ARTERY = Vessel(
    "right pulmonary artery",
    "right",
    "pulmonary artery",
    (
        (6.5, 7.4, 20.0, 3.4),
        (-0.5, 5.6, 21.8, 2.8),
        (-6.0, 0.5, 21.8, 2.6),
        (-9.5, -8.0, 21.6, 2.5),
        (-10.0, -20.0, 21.2, 2.4),
    ),
    VESSEL_WALL,
)
SUPERIOR_VENA_CAVA = Vessel(
    "superior vena cava",
    "right",
    "veins",
    ((-3.0, -14.5, 14.0, 3.4), (-2.8, -16.0, 24.0, 3.2), (-3.2, -16.8, 33.5, 3.1)),
    VESSEL_WALL,
)
INFERIOR_VENA_CAVA = Vessel(
    "inferior vena cava",
    "right",
    "veins",
    ((-7.0, -13.0, 7.0, 3.8), (-12.0, -13.6, -1.0, 3.6), (-13.5, -14.0, -9.0, 3.5)),
    VESSEL_WALL,
)
PULMONARY_VEINS = (
    Vessel(
        "right superior pulmonary vein",
        "left",
        "veins",
        ((-13.0, 3.0, 14.5, 2.2), (-17.5, -5.0, 16.0, 2.0), (-19.5, -14.0, 16.5, 1.9)),
        VESSEL_WALL,
    ),
    Vessel(
        "right inferior pulmonary vein",
        "left",
        "veins",
        ((-14.0, 3.0, 9.0, 2.2), (-19.0, -5.0, 6.6, 2.0), (-21.5, -13.0, 5.4, 1.9)),
        VESSEL_WALL,
    ),
    Vessel(
        "left superior pulmonary vein",
        "left",
        "veins",
        ((-13.0, 13.0, 14.5, 2.2), (-16.5, 21.0, 16.8, 2.0), (-17.5, 28.0, 18.0, 1.9)),
        VESSEL_WALL,
    ),
    Vessel(
        "left inferior pulmonary vein",
        "left",
        "veins",
        ((-13.5, 13.5, 9.5, 2.2), (-18.5, 21.0, 6.8, 2.0), (-20.5, 28.0, 5.6, 1.9)),
        VESSEL_WALL,
    ),
)
VESSELS = (
    AORTA,
    *ARCH_BRANCHES,
    LEFT_PULMONARY_ARTERY,
    RIGHT_PULMONARY_ARTERY,
    SUPERIOR_VENA_CAVA,
    INFERIOR_VENA_CAVA,
    *PULMONARY_VEINS,
)


CONNECTIVE_TISSUE = (
    ((2.0, 9.0, 7.0), (4.5, 9.5, 13.0), 6.0),
    ((-6.0, 8.0, 19.0), (-9.0, -9.0, 17.0), 3.5),
    ((1.0, 2.0, 17.0), (7.0, 0.5, 19.0), 3.2),
    ((-3.0, 15.0, 17.5), (1.0, 15.5, 17.0), 2.6),
    ((2.0, 4.0, 14.0), (3.0, 8.0, 14.0), 4.0),
    ((-2.0, 10.5, 16.5), (-2.0, 0.0, 15.5), 4.5),
)
"""Fat between the great vessels and the atria: start, end, radius. It fills the clefts behind the
great vessels (transverse sinus), so that the outer surface has no handle."""
