"""An infant's heart as a signed-distance function.

Blood pools are unions of ellipsoids and tubes. The tissue is what lies within a wall's thickness of
a pool and in no pool. Where two pools come close, the one of lower rank (aorta, left
ventricle, left atrium, then the right heart) is pushed back so that a wall remains between them;
the septal defects are bored last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissue_sim.geometry.heart_anatomy import (
    AORTA,
    ARCH_BRANCHES,
    ATRIUM_WALL,
    BETWEEN_POOLS,
    CONNECTIVE_TISSUE,
    INFERIOR_VENA_CAVA,
    LEFT_PULMONARY_ARTERY,
    LEFT_VENTRICLE_AXES,
    LEFT_VENTRICLE_CENTRE,
    LEFT_VENTRICLE_RADII,
    LEFT_VENTRICLE_WALL,
    PULMONARY_VEINS,
    RIGHT_PULMONARY_ARTERY,
    RIGHT_VENTRICLE_AXES,
    RIGHT_VENTRICLE_CENTRE,
    RIGHT_VENTRICLE_RADII,
    RIGHT_VENTRICLE_WALL,
    ROUNDING,
    SEPTUM,
    SUPERIOR_VENA_CAVA,
    VALVE_PLANE,
    VESSELS,
)
from tissue_sim.geometry.implicit import (
    Distances,
    Points,
    capsule,
    carve,
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


@dataclass(frozen=True)
class Blood:
    """Signed distances of the blood pools at some points [mm], each of shape (n,).

    Attributes:
        left: Blood of "left ventricle", "left atrium" and "aorta", defects not included.
        right: Blood of "right ventricle", "right atrium" and "pulmonary artery".
        veins: Blood in the venae cavae and pulmonary veins, which is also in the atria's.
        drawn: Chambers before they give way to each other.
        openings: The mitral and the tricuspid opening.
    """

    left: dict[str, Distances]
    right: dict[str, Distances]
    veins: Distances
    drawn: dict[str, Distances]
    openings: Distances


def _left_ventricle(points: Points) -> Distances:
    body = ellipsoid(points, LEFT_VENTRICLE_CENTRE, LEFT_VENTRICLE_RADII, LEFT_VENTRICLE_AXES)
    outflow = capsule(points, (2.5, 5.0, -3.0), (1.5, 2.0, 1.0), 4.0)
    return smooth_min(body, outflow, 3.0)


def _right_ventricle(points: Points, left_ventricle: Distances) -> Distances:
    body = ellipsoid(points, RIGHT_VENTRICLE_CENTRE, RIGHT_VENTRICLE_RADII, RIGHT_VENTRICLE_AXES)
    outflow = capsule(points, (11.0, -5.0, -4.0), (12.5, -1.5, 6.0), (5.6, 4.4))
    return carve(smooth_min(body, outflow, 4.0), left_ventricle - SEPTUM, 2.0)


def _left_atrium(points: Points) -> Distances:
    body = ellipsoid(points, (-10.4, 7.2, 11.2), (7.4, 11.0, 7.4))
    appendage = spline(
        (
            (-8.0, 14.0, 12.5, 3.6),
            (-2.0, 18.0, 12.0, 3.2),
            (3.5, 17.0, 10.5, 2.6),
            (7.5, 13.6, 10.5, 1.6),
        ),
        5,
    )
    tip = capsule(points, (1.5, 17.6, 11.5), (4.5, 15.8, 15.0), (2.6, 1.5))
    finger = tube(points, appendage[:, :3], appendage[:, 3])
    return smooth_min(body, smooth_min(finger, tip, 1.5), 2.5)


def _right_atrium(points: Points) -> Distances:
    body = ellipsoid(points, (-4.2, -12.0, 10.0), (9.4, 9.6, 10.5))
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


def _left_pool(
    drawn: dict[str, Distances], vessels: dict[str, Distances], mitral: Distances
) -> dict[str, Distances]:
    """Blood of the left heart; the atrium gives way to the aorta and the ventricle."""
    atrium = smooth_min(drawn["left atrium"], vessels["pulmonary veins"], 2.0)
    atrium = carve(atrium, vessels["aorta"] - BETWEEN_POOLS, ROUNDING)
    atrium = carve(atrium, drawn["left ventricle"] - VALVE_PLANE, ROUNDING)
    return {
        "left ventricle": drawn["left ventricle"],
        "left atrium": smooth_min(atrium, mitral, 1.0),
        "aorta": vessels["aorta"],
    }


def _right_pool(
    drawn: dict[str, Distances],
    vessels: dict[str, Distances],
    tricuspid: Distances,
    left: dict[str, Distances],
) -> dict[str, Distances]:
    """Blood of the right heart, which gives way to the left heart everywhere."""
    pulmonary = vessels["pulmonary artery"]
    ventricle = drawn["right ventricle"]
    atrium = smooth_min(drawn["right atrium"], vessels["venae cavae"], 2.5)
    atrium = carve(atrium, pulmonary - BETWEEN_POOLS, ROUNDING)
    atrium = carve(atrium, ventricle - VALVE_PLANE, ROUNDING)
    right = {
        "right ventricle": ventricle,
        "right atrium": smooth_min(atrium, tricuspid, 1.0),
        "pulmonary artery": pulmonary,
    }
    for name, pool in right.items():
        for other in left.values():
            pool = carve(pool, other - BETWEEN_POOLS, ROUNDING)
        right[name] = pool
    return right


def _outer_surface(points: Points, drawn: dict[str, Distances], openings: Distances) -> Distances:
    """Outer surface with its grooves, the coronary vessels in them, and the stubs."""
    left = drawn["left ventricle"] - LEFT_VENTRICLE_WALL
    right = drawn["right ventricle"] - RIGHT_VENTRICLE_WALL
    ventricles = smooth_min(left, right, 5.0)
    atria = smooth_min(drawn["left atrium"] - ATRIUM_WALL, drawn["right atrium"] - ATRIUM_WALL, 1.5)
    muscle = smooth_min(ventricles, atria, 2.0)
    # A groove is where two envelopes are equally far; a coronary artery is a tube around the
    # curve in which the groove meets the surface.
    between = 0.7 * (left - right)
    descending = np.sqrt(muscle * muscle + between * between) - 1.0
    descending = smooth_max(descending, half_space(points, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)), 1.0)
    around = 0.7 * (ventricles - atria)
    ring = np.sqrt(muscle * muscle + around * around) - 1.1
    muscle = union([muscle, descending, ring], 1.2)
    rings = openings - BETWEEN_POOLS
    fat = [capsule(points, start, end, radius) for start, end, radius in CONNECTIVE_TISSUE]
    return union([muscle, rings, *fat, *(v.envelope(points) for v in VESSELS)], 1.6)


def _defects(points: Points, asd_radius: float, vsd_radius: float) -> list[Distances]:
    """Septal defects, through holes between the left and the right heart. Radii [mm]."""
    defects = []
    if asd_radius > 0.0:
        defects.append(capsule(points, (-5.5, -9.0, 12.0), (-10.5, 3.0, 12.5), asd_radius))
    if vsd_radius > 0.0:
        defects.append(capsule(points, (2.0, 4.5, -3.0), (6.0, -5.5, -1.0), vsd_radius))
    return defects


def heart_blood(points: Points) -> Blood:
    """Evaluate the signed distances of the blood pools, septal defects not included.

    Args:
        points: Places [m], shape (n, 3).

    Returns:
        Distances in millimetres.
    """
    place = np.asarray(points, dtype=np.float64) / MILLIMETRE
    vessels = _vessel_pools(place)
    left_ventricle = _left_ventricle(place)
    drawn = {
        "left ventricle": left_ventricle,
        "right ventricle": _right_ventricle(place, left_ventricle),
        "left atrium": _left_atrium(place),
        "right atrium": _right_atrium(place),
    }
    mitral = capsule(place, (-8.0, 8.5, 8.0), (1.0, 7.5, -5.0), 4.4)
    tricuspid = capsule(place, (-1.0, -11.0, 7.0), (6.0, -6.0, -5.0), 4.8)
    left = _left_pool(drawn, vessels, mitral)
    right = _right_pool(drawn, vessels, tricuspid, left)
    veins = np.minimum(vessels["pulmonary veins"], vessels["venae cavae"])
    return Blood(left, right, veins, drawn, np.minimum(mitral, tricuspid))


def heart_tissue(
    points: Points, asd_radius: float = ASD_RADIUS, vsd_radius: float = VSD_RADIUS
) -> Distances:
    """Evaluate the signed distance of the heart itself.

    Args:
        points: Places [m], shape (n, 3).
        asd_radius: Radius of the atrial septal defect [m], zero for an intact septum.
        vsd_radius: Radius of the ventricular septal defect [m], zero for an intact septum.

    Returns:
        Distances in millimetres, shape (n,).
    """
    place = np.asarray(points, dtype=np.float64) / MILLIMETRE
    pools = heart_blood(points)
    outer = _outer_surface(place, pools.drawn, pools.openings)
    blood = np.minimum(union(pools.left.values(), 0.8), union(pools.right.values(), 0.8))
    blood = union([blood, *_defects(place, asd_radius / MILLIMETRE, vsd_radius / MILLIMETRE)], 1.0)
    blood = carve(blood, _papillary_muscles(place), 1.0)
    return carve(outer, blood, 0.8)
