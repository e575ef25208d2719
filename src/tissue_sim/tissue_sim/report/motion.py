"""How a tool was moved: way, time, rest, movements and the space it worked in.

References:
    I. Oropesa et al.: EVA: laparoscopic instrument tracking based on endoscopic video analysis for
    psychomotor skills assessment. Surg. Endosc. 27(3), 2013, 1029-1039,
    doi:10.1007/s00464-012-2513-z (path length, economy of volume).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt
from scipy.spatial import ConvexHull

from tissue_sim.report.smoothness import HIGHEST_HZ, log_dimensionless_jerk, spectral_arc_length

IDLE_SPEED = 0.005
"""A tip slower than this is idle [m/s], where nobody says otherwise."""
SHORTEST_MOVEMENT = 0.2
"""What is above the idle speed for less time than this is no movement [s]."""
FILTER_NEEDS = 12
"""Fewer samples than this are not filtered."""
FLAT = 1e-6
"""A cloud of points is flat in a direction in which it is this share of its size."""

Reals = NDArray[np.float64]


@dataclass(frozen=True)
class WorkingSpace:
    """The space that a tip worked in.

    Attributes:
        box: Edges of the box along the organ's axes [m], shape (3,).
        hull_volume: Volume of the convex hull [m^3]; 0 for motion in a plane.
        hull_area: Area of the hull's surface [m^2]; of the plane hull for motion in a plane.
    """

    box: Reals
    hull_volume: float
    hull_area: float


@dataclass(frozen=True)
class Motion:
    """How a tip moved; nan where a figure has no meaning.

    Attributes:
        path: Length of its way [m].
        seconds: From its first to its last movement [s].
        moving: Time of that at or above the idle speed [s].
        movements: How many movements: stretches at or above the idle speed of at least
            `SHORTEST_MOVEMENT`.
        mean_speed: Way over time while it moves [m/s].
        straightness: Distances between the ends of the movements over their ways, 0 to 1.
        sparc: Median spectral arc length of the movements.
        sparc_whole: Spectral arc length from the first to the last movement, pauses included.
        jerk: Median log dimensionless jerk of the movements.
        space: Where it worked; None: it did not move.
        economy_of_volume: Cube root of the box' volume over the way.
    """

    path: float
    seconds: float
    moving: float
    movements: int
    mean_speed: float
    straightness: float
    sparc: float
    sparc_whole: float
    jerk: float
    space: WorkingSpace | None
    economy_of_volume: float

    @property
    def idle(self) -> float:
        """Time below the idle speed between its first and its last movement [s]."""
        return self.seconds - self.moving


def speeds_of(positions: Reals, rate_hz: float) -> Reals:
    """Speed of a tip [m/s], shape (n,), by central differences.

    Positions pass a low-pass at `HIGHEST_HZ` first (Butterworth, second order, forwards and
    backwards, so without delay): what is faster is the device's noise, not the hand's motion.

    Args:
        positions: Of the tip, evenly sampled [m], shape (n, 3).
        rate_hz: Samples per second [1/s].
    """
    if len(positions) < 2:
        return np.zeros(len(positions))
    if len(positions) > FILTER_NEEDS and rate_hz > 2.5 * HIGHEST_HZ:
        sections = butter(2, HIGHEST_HZ, fs=rate_hz, output="sos")
        positions = sosfiltfilt(sections, positions, axis=0)
    speed: Reals = np.linalg.norm(np.gradient(positions, 1.0 / rate_hz, axis=0), axis=1)
    return speed


def path_length(positions: Reals) -> float:
    """Length of a way through positions [m]."""
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


def movements_of(speed: Reals, rate_hz: float, idle_speed: float = IDLE_SPEED) -> list[slice]:
    """Where a tip moves: stretches of samples at or above the idle speed that last long enough."""
    moves = np.concatenate([[False], speed >= idle_speed, [False]])
    edges = np.flatnonzero(np.diff(moves.astype(np.int8))).reshape(-1, 2)
    return [
        slice(int(begin), int(end))
        for begin, end in edges
        if (end - begin) / rate_hz >= SHORTEST_MOVEMENT
    ]


def working_space(positions: Reals) -> WorkingSpace:
    """The space that a tip worked in.

    Args:
        positions: Of the tip [m], shape (n, 3), n at least 1.
    """
    box = np.ptp(positions, axis=0)
    centred = positions - positions.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    along = centred @ axes.T
    # Extents, not standard deviations: a single far point makes a hull too.
    extent = np.ptp(along, axis=0)
    dimensions = int((extent > FLAT * max(float(extent.max(initial=0.0)), 1e-9)).sum())
    if dimensions < 2:
        return WorkingSpace(box, 0.0, 0.0)
    if dimensions == 2:
        # In two dimensions the library calls the area volume and the circumference area.
        return WorkingSpace(box, 0.0, float(ConvexHull(along[:, :2]).volume))
    hull = ConvexHull(along)
    return WorkingSpace(box, float(hull.volume), float(hull.area))


def motion_of(positions: Reals, rate_hz: float, idle_speed: float = IDLE_SPEED) -> Motion:
    """How a tip moved.

    Args:
        positions: Of the tip, evenly sampled [m], shape (n, 3), n at least 1.
        rate_hz: Samples per second [1/s].
        idle_speed: A tip slower than this is idle [m/s].
    """
    speed = speeds_of(positions, rate_hz)
    moved = movements_of(speed, rate_hz, idle_speed)
    path, nan = path_length(positions), float("nan")
    if not moved:
        return Motion(path, 0.0, 0.0, 0, nan, nan, nan, nan, nan, None, nan)
    whole = slice(moved[0].start, moved[-1].stop)
    moving = float((speed[whole] >= idle_speed).sum()) / rate_hz
    ways = [path_length(positions[part]) for part in moved]
    chords = [float(np.linalg.norm(positions[part][-1] - positions[part][0])) for part in moved]
    sparcs = [spectral_arc_length(speed[part], rate_hz) for part in moved]
    jerks = [log_dimensionless_jerk(speed[part], rate_hz) for part in moved]
    space = working_space(positions[whole])
    return Motion(
        path=path,
        seconds=(whole.stop - whole.start) / rate_hz,
        moving=moving,
        movements=len(moved),
        mean_speed=sum(ways) / (sum(part.stop - part.start for part in moved) / rate_hz),
        straightness=sum(chords) / sum(ways),
        sparc=_median(sparcs),
        sparc_whole=spectral_arc_length(speed[whole], rate_hz),
        jerk=_median(jerks),
        space=space,
        economy_of_volume=float(np.cbrt(space.box.prod())) / path,
    )


def _median(values: list[float]) -> float:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.median(finite)) if finite else float("nan")
