"""How a recording is played, for those who watch it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlaybackState:
    """How a recording is played.

    Attributes:
        time: [s] into the recording.
        rate: Recorded seconds a second.
        paused: Whether it stands.
        looping: Whether it begins again at its end.
        taken_over: Tools that people have taken over, sorted.
        branch: Id of the branch that the first of them began; empty: it is the recording itself.
        branch_frame: Frame of the recorded epoch it began after.
        seeking: Whether it is on the way to another time.
    """

    time: float
    rate: float
    paused: bool
    looping: bool
    taken_over: tuple[str, ...]
    branch: str
    branch_frame: int
    seeking: bool
