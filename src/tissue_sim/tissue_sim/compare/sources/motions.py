"""Five interactions with any organ: a tool holds tissue, pulls it, and holds it still.

In-plane, normal, oblique and circular motions take the organ's hold along with them; the fifth lets
go of it and grabs beside it. As in the thesis (THESIS.md, section 6) the tissue is stretched for
1.5 s at constant speed and then held still for 3 s, at 30 frames a second.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.effort import Effort
from tissue_sim.compare.interaction import Interaction, InteractionError, held_along
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.sources.axes import Axes, axes_at
from tissue_sim.compare.sources.played import STEPS, deciding_model
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import simulate

SHARE = 0.15
"""Amplitude where nobody says which, as a share of the organ's size ..."""

RADII = 2.0
"""... but no more than so many radii of the hold: farther, elements beside it would turn over."""

LET_GO = 1.0 / 3.0
"""Share of the time without motion in which nothing is held before tissue is grabbed again."""

SMALLEST = 1e-6
"""Smallest amplitude [m]."""


@dataclass(frozen=True)
class Pull:
    """What every motion is made of.

    Attributes:
        organ: The organ.
        axes: Directions at its hold.
        amplitude: How far the hold gets from rest [m].
        rate_hz: Frames per second [1/s].
        pull_frames: Frames of the stretch.
        hold_frames: Frames without motion.
        reference: Decides where tissue is when it is grabbed again.
    """

    organ: Organ
    axes: Axes
    amplitude: float
    rate_hz: float
    pull_frames: int
    hold_frames: int
    reference: Subject

    @property
    def progress(self) -> NDArray[np.float64]:
        """Share of the way that is done in each frame, 1 while it is held still."""
        frames = np.arange(1, self.pull_frames + self.hold_frames + 1)
        return np.minimum(frames / self.pull_frames, 1.0)

    def along(self, name: str, direction: NDArray[np.float64]) -> Interaction:
        """The hold moves in a direction, and is held there."""
        offsets = self.amplitude * self.progress[:, None] * direction
        return held_along(self.organ, name, self.rate_hz, self.organ.hold, offsets)


def motion(
    name: str,
    organ: Organ,
    amplitude: float | None = None,
    rate_hz: float = 30.0,
    pull_seconds: float = 1.5,
    hold_seconds: float = 3.0,
    reference: Subject | None = None,
) -> Interaction:
    """One of `MOTIONS`.

    Args:
        name: Its name.
        organ: The organ.
        amplitude: How far the hold gets from rest [m]; None: `default_amplitude`.
        rate_hz: Frames per second [1/s].
        pull_seconds: Time of the stretch [s].
        hold_seconds: Time without motion after it [s].
        reference: For `regrab` only: what decides where tissue is when it is grabbed again; None:
            `deciding_model`.

    Raises:
        ValueError: There is no such motion, or a number is out of range.
    """
    if name not in MOTIONS:
        raise InteractionError(f"there is no motion {name!r}; allowed: {', '.join(MOTIONS)}")
    if not len(organ.hold):
        raise InteractionError(f"{organ.name} has no free node to hold: all of them are fixed")
    far = default_amplitude(organ) if amplitude is None else amplitude
    if not SMALLEST <= far <= organ.size:
        raise InteractionError(
            f"amplitude {1e3 * far:g} mm is out of range; allowed on {organ.name}: "
            f"{1e3 * SMALLEST:g} to {1e3 * organ.size:.4g} mm"
        )
    if not 1.0 <= rate_hz <= 1000.0:
        raise InteractionError(f"rate_hz = {rate_hz:g} is out of range; allowed: 1 to 1000")
    for label, seconds in (("pull_seconds", pull_seconds), ("hold_seconds", hold_seconds)):
        if not 1.0 / rate_hz <= seconds <= 3600.0:
            raise InteractionError(
                f"{label} = {seconds:g} s is out of range; allowed: a frame to 3600 s"
            )
    decides = reference or Subject(deciding_model(organ), effort=Effort(steps=STEPS))
    pull = Pull(
        organ, axes_at(organ), far, rate_hz, round(rate_hz * pull_seconds),
        round(rate_hz * hold_seconds), decides,
    )  # fmt: skip
    return MOTIONS[name](pull)


def default_amplitude(organ: Organ) -> float:
    """A large pull that elements beside the hold bear [m]: `SHARE` of the size, at most `RADII`."""
    places = organ.rest[organ.hold]
    radius = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max(initial=0.0))
    far = SHARE * organ.size
    return min(far, RADII * radius) if radius > 0.0 else far


def _in_plane(pull: Pull) -> Interaction:
    return pull.along("in_plane", pull.axes.in_plane)


def _normal(pull: Pull) -> Interaction:
    return pull.along("normal", pull.axes.normal)


def _oblique(pull: Pull) -> Interaction:
    return pull.along("oblique", _diagonal(pull.axes))


def _circular(pull: Pull) -> Interaction:
    """One and a half turns on a circle through rest in the tissue's plane: it ends farthest out."""
    angle = 3.0 * np.pi * pull.progress[:, None]
    radius = 0.5 * pull.amplitude
    offsets = radius * ((1.0 - np.cos(angle)) * pull.axes.in_plane + np.sin(angle) * pull.axes.side)
    return held_along(pull.organ, "circular", pull.rate_hz, pull.organ.hold, offsets)


def _regrab(pull: Pull) -> Interaction:
    """Pull in the plane, let go, grab beside the first place and pull obliquely.

    The second grab takes tissue from where the reference has it then.
    """
    organ, stretch, waits = pull.organ, pull.pull_frames, round(LET_GO * pull.hold_frames)
    way = pull.amplitude * pull.progress[:, None]
    offsets = np.zeros((stretch + waits, 3))
    offsets[:stretch] = way[:stretch] * pull.axes.in_plane
    held = np.arange(len(offsets)) < stretch
    before = held_along(organ, "regrab", pull.rate_hz, organ.hold, offsets, held)
    beside = _beside_the_hold(pull)
    start = simulate(pull.reference, organ, before).displacement[-1, beside].astype(np.float64)
    after = start + (way[: len(way) - waits] * _diagonal(pull.axes))[:, None, :]
    return _one_after_the_other(before, beside, after)


def _one_after_the_other(
    before: Interaction, rows: NDArray[np.int32], places: NDArray[np.float64]
) -> Interaction:
    """An interaction, then other nodes held at places [m], shape (frames, len(rows), 3)."""
    nodes = np.union1d(before.nodes, rows).astype(np.int32)
    frames = before.frames + len(places)
    held = np.zeros((frames, len(nodes)), dtype=np.bool_)
    displacement = np.zeros((frames, len(nodes), 3))
    early, late = np.searchsorted(nodes, before.nodes), np.searchsorted(nodes, rows)
    held[: before.frames, early] = before.held
    displacement[: before.frames, early] = before.displacement
    held[before.frames :, late] = True
    displacement[before.frames :, late] = places
    return Interaction(before.name, before.rate_hz, nodes, held, displacement, before.organ)


def _beside_the_hold(pull: Pull) -> NDArray[np.int32]:
    """As many free nodes as the hold has, around a place one radius of the hold beside it."""
    organ = pull.organ
    places = organ.rest[organ.hold]
    centre = places.mean(axis=0)
    radius = float(np.linalg.norm(places - centre, axis=1).max())
    count = organ.mesh.node_rows
    free = np.flatnonzero(organ.mesh.node_alive[:count] & ~organ.mesh.fixed[:count])
    away = np.linalg.norm(organ.rest[free] - (centre + radius * pull.axes.side), axis=1)
    nearest = np.argsort(away, kind="stable")[: len(organ.hold)]
    return np.sort(free[nearest]).astype(np.int32)


def _diagonal(axes: Axes) -> NDArray[np.float64]:
    """Half way between the tissue's plane and its normal."""
    return (axes.in_plane + axes.normal) / np.sqrt(2.0)


MOTIONS: dict[str, Callable[[Pull], Interaction]] = {
    "in_plane": _in_plane,
    "normal": _normal,
    "oblique": _oblique,
    "circular": _circular,
    "regrab": _regrab,
}
"""The five interactions by name."""
