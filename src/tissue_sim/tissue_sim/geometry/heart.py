"""An infant's heart as a signed-distance function, and the mesh made from it.

Four chambers, septa with an atrial and a ventricular septal defect, open valves, and hollow
stubs of the great vessels, all with thin walls. Blood pools are unions of ellipsoids and tubes; the
tissue is what lies within a wall's thickness of a pool and in no pool. Where two pools come close,
the one of lower rank is pushed back so that a wall remains between them.

Internally millimetres; axes x anterior, y left, z superior (REP 103 for a body). Meshes are in
metres. See docs/heart.md for the anatomy and its limits.
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
    capsule,
    carve,
    dot,
    ellipsoid,
    half_space,
    smooth_max,
    smooth_min,
    spline,
    tube,
    union,
    unit,
)

MILLIMETRE = 1e-3
ASD_RADIUS = 3.0e-3
VSD_RADIUS = 2.6e-3
"""Radii of the septal defects [m]."""

LOWER_CORNER = np.array([-31.0, -31.0, -37.0])
UPPER_CORNER = np.array([29.0, 34.0, 46.0])
"""A box around the heart [mm]."""

# Wall thickness [mm]. Vessel and vein walls of an infant are 1.0 to 1.3 mm; they are drawn
# thicker so that the default lattice resolves them.
LEFT_VENTRICLE_WALL = 4.2
RIGHT_VENTRICLE_WALL = 2.6
ATRIUM_WALL = 2.0
SEPTUM = 3.4
ATRIAL_SEPTUM = 2.3
BETWEEN_POOLS = 2.2

APEX_DIRECTION = unit((0.30, 0.44, -0.85))
LEFT_VENTRICLE_CENTRE = np.array([2.5, 8.0, -9.5])
LEFT_VENTRICLE_RADII = (8.0, 8.0, 17.5)
LEFT_VENTRICLE_AXES = axes_along(APEX_DIRECTION, (1.0, 0.0, 0.0))
RIGHT_VENTRICLE_CENTRE = np.array([8.0, -3.5, -7.0])
RIGHT_VENTRICLE_RADII = (10.5, 13.5, 16.5)
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
        """Distance to the blood in the vessel, which goes on a little beyond the open end."""
        beyond = self.end + 4.0 * self.end_direction
        line = np.concatenate([self.line, [[*beyond, self.line[-1, 3]]]])
        return tube(points, line[:, :3], line[:, 3])

    def envelope(self, points: Points) -> Distances:
        """Distance to lumen and wall together, cut flat at the open end."""
        radii = self.line[:, 3] + self.wall
        past_end = half_space(points, self.end, self.end_direction)
        reach = dot(self.line[:, :3] - self.end, self.end_direction)
        tail = len(reach) - 1
        while tail > 1 and reach[tail] > -1.2 * radii[-1]:
            tail -= 1
        stub = tube(points, self.line[tail - 1 :, :3], radii[tail - 1 :])
        stub = smooth_max(stub, past_end, 1.0)
        if tail <= 1:
            return stub
        return np.minimum(stub, tube(points, self.line[: tail + 1, :3], radii[: tail + 1]))


AORTA = Vessel(
    "aorta",
    "left",
    "aorta",
    (
        (1.5, 2.0, 0.0, 3.9),
        (2.0, -2.0, 8.0, 4.2),
        (2.6, -5.0, 16.0, 4.0),
        (1.0, -4.8, 24.5, 3.8),
        (-4.0, -0.8, 31.0, 3.6),
        (-10.5, 3.6, 31.0, 3.4),
        (-15.0, 6.4, 26.0, 3.2),
        (-16.4, 7.2, 20.5, 3.1),
    ),
    1.8,
)
ARCH_BRANCHES = (
    Vessel(
        "brachiocephalic artery",
        "left",
        "aorta",
        ((-1.2, -3.2, 29.0, 2.0), (-1.2, -5.2, 34.5, 1.9), (-1.2, -7.0, 39.0, 1.9)),
        1.6,
    ),
    Vessel(
        "left common carotid artery",
        "left",
        "aorta",
        ((-6.0, 0.6, 31.5, 1.7), (-6.2, 1.2, 36.5, 1.6), (-6.4, 1.6, 40.5, 1.6)),
        1.6,
    ),
    Vessel(
        "left subclavian artery",
        "left",
        "aorta",
        ((-11.0, 4.0, 30.6, 1.7), (-11.6, 6.4, 35.5, 1.6), (-11.8, 9.6, 39.0, 1.6)),
        1.6,
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
    1.7,
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
    1.7,
)
SUPERIOR_VENA_CAVA = Vessel(
    "superior vena cava",
    "right",
    "veins",
    ((-3.0, -14.5, 14.0, 3.4), (-2.6, -15.0, 24.0, 3.2), (-3.4, -14.2, 35.0, 3.1)),
    1.7,
)
INFERIOR_VENA_CAVA = Vessel(
    "inferior vena cava",
    "right",
    "veins",
    ((-7.0, -13.0, 7.0, 3.8), (-12.0, -13.6, -1.0, 3.6), (-13.5, -14.0, -9.0, 3.5)),
    1.7,
)
PULMONARY_VEINS = (
    Vessel(
        "right superior pulmonary vein",
        "left",
        "veins",
        ((-13.0, 3.0, 14.5, 2.2), (-17.5, -5.0, 16.0, 2.0), (-19.5, -14.0, 16.5, 1.9)),
        1.7,
    ),
    Vessel(
        "right inferior pulmonary vein",
        "left",
        "veins",
        ((-14.0, 3.0, 9.0, 2.2), (-19.0, -5.0, 6.6, 2.0), (-21.5, -13.0, 5.4, 1.9)),
        1.7,
    ),
    Vessel(
        "left superior pulmonary vein",
        "left",
        "veins",
        ((-13.0, 13.0, 14.5, 2.2), (-16.5, 21.0, 16.8, 2.0), (-17.5, 28.0, 18.0, 1.9)),
        1.7,
    ),
    Vessel(
        "left inferior pulmonary vein",
        "left",
        "veins",
        ((-13.5, 13.5, 9.5, 2.2), (-18.5, 21.0, 6.8, 2.0), (-20.5, 28.0, 5.6, 1.9)),
        1.7,
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


@dataclass(frozen=True)
class HeartParts:
    """Signed distances of the heart's parts at some points [mm], each of shape (n,).

    Attributes:
        pools: Blood of "left ventricle", "right ventricle", "left atrium", "right atrium",
            "aorta", "pulmonary artery", "veins", each with a wall kept from its neighbours.
        openings: Valves and septal defects between the pools.
        muscle: Papillary muscles, which stand in the pools.
        outer: Everything within the outer surface.
        tissue: The heart itself.
    """

    pools: dict[str, Distances]
    openings: Distances
    muscle: Distances
    outer: Distances
    tissue: Distances


def _left_ventricle(points: Points) -> Distances:
    body = ellipsoid(
        points, LEFT_VENTRICLE_CENTRE, LEFT_VENTRICLE_RADII, LEFT_VENTRICLE_AXES
    )
    outflow = capsule(points, (2.5, 5.0, -3.0), (1.5, 2.0, 1.0), 4.0)
    return smooth_min(body, outflow, 3.0)


def _right_ventricle(points: Points, left_ventricle: Distances) -> Distances:
    body = ellipsoid(
        points, RIGHT_VENTRICLE_CENTRE, RIGHT_VENTRICLE_RADII, RIGHT_VENTRICLE_AXES
    )
    outflow = capsule(points, (11.0, -5.0, -4.0), (12.5, -1.5, 6.0), (5.6, 4.4))
    return carve(smooth_min(body, outflow, 4.0), left_ventricle - SEPTUM, 2.0)


def _left_atrium(points: Points) -> Distances:
    body = ellipsoid(points, (-11.0, 8.0, 11.5), (7.2, 10.0, 7.6))
    appendage = spline(
        ((-7.0, 15.0, 12.5, 3.4), (-1.0, 19.0, 12.5, 3.2), (5.5, 17.0, 11.0, 2.8),
         (9.5, 12.6, 10.5, 1.7)), 5)
    tip = capsule(points, (4.5, 17.5, 11.0), (6.5, 16.0, 15.0), (2.4, 1.5))
    finger = tube(points, appendage[:, :3], appendage[:, 3])
    return smooth_min(body, smooth_min(finger, tip, 1.5), 2.5)


def _right_atrium(points: Points) -> Distances:
    body = ellipsoid(points, (-3.0, -12.5, 10.0), (9.0, 9.2, 10.5))
    root = capsule(points, (1.0, -14.0, 13.0), (7.5, -12.0, 15.5), (5.0, 3.6))
    tips = [
        capsule(points, (7.0, -12.0, 15.0), (11.5, -6.0, 17.5), (3.6, 1.7)),
        capsule(points, (6.5, -12.5, 14.0), (11.8, -9.5, 12.0), (3.2, 1.7)),
    ]
    return smooth_min(body, union([root, *tips], 2.0), 3.0)


def _papillary_muscles(points: Points) -> Distances:
    """Two cones from the left ventricle's free wall towards the mitral valve."""
    first, second, along = LEFT_VENTRICLE_AXES
    cones = []
    for direction in (unit(0.5 * first + 0.9 * second), unit(-0.9 * first - 0.1 * second)):
        base = LEFT_VENTRICLE_CENTRE + 6.0 * along + 8.0 * direction
        tip = LEFT_VENTRICLE_CENTRE - 1.5 * along + 4.6 * direction
        cones.append(capsule(points, base, tip, (2.6, 1.6)))
    return union(cones, 0.5)


def _vessel_pools(points: Points) -> dict[str, Distances]:
    pulmonary = (LEFT_PULMONARY_ARTERY, RIGHT_PULMONARY_ARTERY)
    left_veins = union([v.lumen(points) for v in PULMONARY_VEINS], 0.5)
    cavae = np.minimum(SUPERIOR_VENA_CAVA.lumen(points), INFERIOR_VENA_CAVA.lumen(points))
    return {
        "aorta": union([v.lumen(points) for v in (AORTA, *ARCH_BRANCHES)], 1.0),
        "pulmonary artery": union([v.lumen(points) for v in pulmonary], 1.5),
        "pulmonary veins": left_veins,
        "venae cavae": cavae,
    }


def _pools(points: Points) -> tuple[dict[str, Distances], dict[str, Distances]]:
    """Blood pools with walls between left and right, and the chambers as drawn."""
    vessels = _vessel_pools(points)
    aorta, wall, edge = vessels["aorta"], BETWEEN_POOLS, 1.5
    left_ventricle = _left_ventricle(points)
    right_ventricle = _right_ventricle(points, left_ventricle)
    drawn = {
        "left ventricle": left_ventricle,
        "right ventricle": right_ventricle,
        "left atrium": _left_atrium(points),
        "right atrium": _right_atrium(points),
    }
    pulmonary = carve(vessels["pulmonary artery"], aorta - wall, 1.0)
    left_atrium = smooth_min(drawn["left atrium"], vessels["pulmonary veins"], 2.0)
    for other, gap in ((aorta, wall), (pulmonary, wall), (left_ventricle, 2.8)):
        left_atrium = carve(left_atrium, other - gap, edge)
    right_ventricle = carve(right_ventricle, aorta - wall, edge)
    right_ventricle = carve(right_ventricle, left_atrium - 2.6, edge)
    right_atrium = smooth_min(drawn["right atrium"], vessels["venae cavae"], 2.5)
    barriers = (
        (aorta, wall),
        (pulmonary, wall),
        (left_ventricle, 2.8),
        (left_atrium, ATRIAL_SEPTUM),
        (right_ventricle, 2.6),
    )
    for other, gap in barriers:
        right_atrium = carve(right_atrium, other - gap, edge)
    pools = {
        "left ventricle": left_ventricle,
        "right ventricle": right_ventricle,
        "left atrium": left_atrium,
        "right atrium": right_atrium,
        "aorta": aorta,
        "pulmonary artery": pulmonary,
    }
    return pools, drawn


def _outer_surface(points: Points, drawn: dict[str, Distances]) -> Distances:
    """Outer surface with its grooves, the coronary vessels in them, and the stubs."""
    left = drawn["left ventricle"] - LEFT_VENTRICLE_WALL
    right = drawn["right ventricle"] - RIGHT_VENTRICLE_WALL
    ventricles = smooth_min(left, right, 2.0)
    atria = smooth_min(
        drawn["left atrium"] - ATRIUM_WALL, drawn["right atrium"] - ATRIUM_WALL, 1.5
    )
    muscle = smooth_min(ventricles, atria, 2.0)
    # A groove is where two envelopes are equally far; a coronary artery is a tube around the
    # curve in which the groove meets the surface.
    between = 0.7 * (left - right)
    descending = np.sqrt(muscle * muscle + between * between) - 1.0
    descending = smooth_max(descending, half_space(points, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)), 1.0)
    around = 0.7 * (ventricles - atria)
    ring = np.sqrt(muscle * muscle + around * around) - 1.1
    muscle = union([muscle, descending, ring], 1.2)
    return union([muscle, *(v.envelope(points) for v in VESSELS)], 1.6)


def _openings(points: Points, asd_radius: float, vsd_radius: float) -> Distances:
    """Valves and septal defects; a radius of zero leaves a defect out. Radii [mm]."""
    openings = [
        capsule(points, (-8.0, 8.5, 8.0), (1.0, 7.5, -5.0), 4.6),
        capsule(points, (-1.0, -11.0, 7.0), (6.0, -5.5, -5.0), 5.0),
    ]
    if asd_radius > 0.0:
        openings.append(capsule(points, (-5.5, -8.0, 12.0), (-10.5, 3.0, 12.5), asd_radius))
    if vsd_radius > 0.0:
        openings.append(capsule(points, (2.0, 4.5, -3.0), (5.5, -4.5, -1.0), vsd_radius))
    return union(openings, 0.0)


def heart_parts(
    points: Points, asd_radius: float = ASD_RADIUS, vsd_radius: float = VSD_RADIUS
) -> HeartParts:
    """Evaluate the heart's signed distances.

    Args:
        points: Places [m], shape (n, 3).
        asd_radius: Radius of the atrial septal defect [m], zero for an intact septum.
        vsd_radius: Radius of the ventricular septal defect [m], zero for an intact septum.

    Returns:
        Distances in millimetres.
    """
    place = np.asarray(points, dtype=np.float64) / MILLIMETRE
    pools, drawn = _pools(place)
    outer = _outer_surface(place, drawn)
    openings = _openings(place, asd_radius / MILLIMETRE, vsd_radius / MILLIMETRE)
    papillary = _papillary_muscles(place)
    blood = smooth_min(union(pools.values(), 0.8), openings, 1.0)
    blood = carve(blood, papillary, 1.0)
    return HeartParts(pools, openings, papillary, outer, carve(outer, blood, 0.8))
