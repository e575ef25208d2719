"""Plays a procedure against any clock."""

from __future__ import annotations

from typing import Protocol

from tool_input.motion import Pose
from tool_input.procedure import Event, Procedure


class Stage(Protocol):
    """Where a procedure is played."""

    def pose(self, tool: str, pose: Pose) -> None:
        """Put a tool somewhere."""

    def use(self, tool: str, pressed: bool) -> None:
        """Press or release a tool."""

    def act(self, event: Event) -> None:
        """Do anything else."""


class Player:
    """Plays a procedure from its start to its end.

    Attributes:
        procedure: What is played.
        time: Time played so far [s].
    """

    def __init__(self, procedure: Procedure, stage: Stage) -> None:
        self.procedure = procedure
        self.time = 0.0
        self._stage = stage
        self._next = 0

    @property
    def over(self) -> bool:
        """Whether everything has been played."""
        return self.time >= self.procedure.end and self._next == len(self.procedure.events)

    def begin(self) -> None:
        """Put every tool at its start, not pressed."""
        for tool in self.procedure.tools:
            self._stage.pose(tool, self.procedure.pose(tool, 0.0))
            self._stage.use(tool, False)

    def advance(self, time: float) -> None:
        """Play up to a time [s]; nothing is left out, however large the step.

        A press takes effect where the tool is at the time of the press: its pose of that time goes
        first.
        """
        self.time = max(time, self.time)
        events = self.procedure.events
        while self._next < len(events) and events[self._next].time <= self.time:
            event = events[self._next]
            self._next += 1
            if event.action in ("press", "release"):
                self._stage.pose(event.target, self.procedure.pose(event.target, event.time))
                self._stage.use(event.target, event.action == "press")
            else:
                self._stage.act(event)
        for tool in self.procedure.tools:
            self._stage.pose(tool, self.procedure.pose(tool, self.time))
