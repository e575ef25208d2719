"""From a move of the mouse to changed pixels: which of the times noted belong together."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Photon:
    """One move of the mouse and what came of it, all in seconds since 1970.

    Attributes:
        moved: The browser had the event.
        sent: The page gave it to its connection.
        posed: The node published the tool's pose.
        applied: The simulation published the frame that used the pose.
        arrived: The page had the tissue as it moved.
        drawn: Pixels of the page had changed with it.
    """

    moved: float
    sent: float
    posed: float
    applied: float
    arrived: float
    drawn: float

    def parts(self) -> NDArray[np.float64]:
        """Time between each and the next [ms], shape (5,), none negative."""
        return np.diff([getattr(self, field.name) for field in fields(self)]) * 1e3


PARTS = {
    "browser": "from the event to the page's message",
    "node in": "from the message to `tools/<tool>/servo_cp`",
    "simulation": "from the pose to the frame that used it",
    "node out": "from that frame to its arrival in the page",
    "drawing": "from its arrival to changed pixels",
}
"""What the times between two neighbours of `Photon` are called, and what they are."""


@dataclass(frozen=True)
class PageNotes:
    """What one window noted, in seconds since 1970, each in the order of time.

    Attributes:
        sent: Messages about a drag.
        places: When a batch with the organ came, and where the followed vertex was in it.
        changed: Frames drawn in which many pixels changed.
    """

    sent: list[float]
    places: list[tuple[float, NDArray[np.float64]]]
    changed: list[float]

    @classmethod
    def read(cls, watch: dict[str, Any], fewest: int) -> PageNotes:
        """Notes of `browser_watch.js`.

        Args:
            watch: `origin`, `sent`, `batches` and `frames` as the script keeps them.
            fewest: Pixels that must have changed in a frame.
        """

        def clock(given: float) -> float:
            return (float(watch["origin"]) + given) / 1e3

        return cls(
            [clock(at) for at, said in watch["sent"] if said["type"] == "SceneNodeDragMessage"],
            [(clock(at), np.array(seen[0])) for at, _, seen in watch["batches"] if seen],
            [clock(at) for at, changed, _ in watch["frames"] if changed >= fewest],
        )


@dataclass(frozen=True)
class ToolNotes:
    """What the session's bag says of one tool, in seconds since 1970.

    Attributes:
        poses: When each pose was published, and where it was [m].
        frames: Stamp of the newest pose that each frame used, and when the frame was published.
    """

    poses: list[tuple[float, NDArray[np.float64]]]
    frames: list[tuple[float, float]]


def photons(moves: Sequence[float], page: PageNotes, tool: ToolNotes, least: float) -> list[Photon]:
    """The moves of the mouse that were seen, with their times.

    A move counts if all that follows came before the next one: moves must be far enough apart, and
    the tissue at rest when they begin.

    Args:
        moves: When the mouse was moved, in the order of time.
        page: What the page noted.
        tool: What was recorded of the tool it moves.
        least: How far the followed vertex must have gone, in the page's units.
    """
    moving = [at for (_, old), (at, new) in pairwise(tool.poses) if not np.array_equal(old, new)]
    stamps = [stamp for stamp, _ in tool.frames]
    found = []
    for move, end in pairwise([*moves, np.inf]):
        try:
            rest = next(place for at, place in reversed(page.places) if at <= move)
            sent = _first(page.sent, move)
            posed = _first(moving, sent)
            applied = tool.frames[bisect_left(stamps, posed)][1]
            arrived = next(
                at
                for at, place in page.places
                if at >= applied and np.linalg.norm(place - rest) >= least
            )
            drawn = _first(page.changed, arrived)
        except (StopIteration, IndexError):
            continue
        if drawn < end:
            found.append(Photon(move, sent, posed, applied, arrived, drawn))
    return found


def quantiles(found: Sequence[Photon]) -> dict[str, dict[str, float]]:
    """Median and 95th percentile [ms] of the whole and of each part.

    Raises:
        ValueError: No move was seen.
    """
    if not found:
        raise ValueError("no move of the mouse was seen to change the picture")
    parts = np.array([photon.parts() for photon in found])
    columns = {"whole": parts.sum(axis=1), **dict(zip(PARTS, parts.T, strict=True))}
    return {
        name: {f"p{share}": round(float(np.percentile(ms, share)), 1) for share in (50, 95)}
        for name, ms in columns.items()
    }


def _first(times: Sequence[float], after: float) -> float:
    """The first of increasing times that is not before another; IndexError if there is none."""
    return times[bisect_left(times, after)]
