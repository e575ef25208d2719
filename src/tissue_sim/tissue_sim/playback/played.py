"""A recorded session as it is watched at any speed, and taken over."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from tissue_sim.frame import AppliedEdit, Command, Frame, JournalEntry
from tissue_sim.interaction.tracker import ToolLimits, ToolTracker
from tissue_sim.live import LiveSimulation
from tissue_sim.playback.branch import Branch
from tissue_sim.playback.changes import SEEK, SET_PLAYBACK, answer_change
from tissue_sim.playback.clock import PlaybackClock
from tissue_sim.playback.player import Player
from tissue_sim.playback.state import PlaybackState
from tissue_sim.requests import Request, refuse
from tissue_sim.simulation import Simulation

WATCHED = "a recording is played: take over its tools first"


class PlayedSimulation(LiveSimulation):
    """A simulation whose inputs come from a recording, until people take over.

    Attributes:
        player: What repeats the recording.
        clock: How fast.
        branch: What people made of it; None: nobody has taken over.
    """

    def __init__(
        self,
        player: Player,
        clock: PlaybackClock,
        limits: ToolLimits,
        data_dir: Path,
        budget: float = 0.006,
        steps_per_frame: int = 0,
        prepare: Callable[[Simulation], Any] = lambda _simulation: None,
    ) -> None:
        """Stand where the player stands; the rest is as in `LiveSimulation`."""
        super().__init__(player.simulation, limits, data_dir, budget, steps_per_frame, prepare)
        self.player, self.clock = player, clock
        self.branch: Branch | None = None
        self._shown = self.simulation.epoch
        self._due = 0
        self._notes: list[str] = []
        self._postponed: list[Request] = []

    @property
    def state(self) -> PlaybackState:
        """How it is played."""
        recording, branch = self.player.recording, self.branch
        return PlaybackState(
            time=min(self.player.frame, recording.frames) / recording.rate_hz,
            rate=self.clock.rate,
            paused=self.clock.paused,
            looping=self.clock.looping,
            taken_over=tuple(sorted(branch.taken)) if branch else (),
            branch=branch.id if branch else "",
            branch_frame=branch.frame if branch else 0,
            seeking=self.player.target > 0,
        )

    # From any thread

    def post_pose(self, tool: str, pose: NDArray[Any], stamp: int, now: float) -> None:
        """Hand over a pose; a tool that follows the recording takes none."""
        self._inbox.append(lambda: self._hand_over(tool))
        super().post_pose(tool, pose, stamp, now)

    def post_use(self, tool: str, pressed: bool) -> None:
        """Hand over a level of `use`; a tool that follows the recording takes none."""
        self._inbox.append(lambda: self._hand_over(tool))
        super().post_use(tool, pressed)

    def _to(self, tool: str, action: Callable[[ToolTracker], None]) -> None:
        def deliver() -> None:
            if tool in self._sourced():
                action(self.trackers[tool])

        self._inbox.append(deliver)

    # In the loop thread

    @property
    def paused(self) -> bool:
        """Whether time stands still: that of the recording, or that of the simulation."""
        return super().paused or (self.branch is None and self.clock.paused)

    @property
    def loading(self) -> bool:
        """Whether another epoch, or another time, is under way."""
        return self.player.target > 0 or super().loading

    @property
    def busy_with(self) -> str:
        """What is worked on; on the way to another time that is `seek`."""
        return SEEK if self.player.target else super().busy_with

    @property
    def progress(self) -> float:
        """Share of the way to another time that is done, 0 to 1."""
        return self.player.progress

    def due(self, until: float) -> bool:
        """Take what has come, and say whether there is a frame to make now.

        On the way to another time there is none before it is reached.

        Args:
            until: Steady time (`time.perf_counter`) at which to stop going there [s].
        """
        self._empty_inbox()
        if not self.player.target:
            self._requests.extendleft(self._postponed)
            self._postponed.clear()
        # What comes after a take-over waits for the frame that it takes effect in.
        while self.branch is None and self._requests:
            self._accept(self._requests.popleft(), [], [])
        while self.branch is None and self._edits:
            refuse(self._edits.popleft(), "BUSY", WATCHED)
        if self.branch is not None:
            return True
        if self.player.over and self.clock.looping and not self.player.target:
            self.player.seek(1)
        if self.player.target:
            self._due = int(self.player.approach(until))
        else:
            self._due = min(self.clock.tick(), self.player.recording.frames - self.player.frame)
            self.clock.paused |= self.player.over
        return self._due > 0

    def next_frame(self, now: float, until: float = math.inf) -> tuple[Frame, Callable[[], None]]:
        """Advance: by what is due of the recording, or by one live frame (see `due`).

        Frames between two that are shown are simulated like all others. What does not fit in before
        `until` is left for later: then the recording is slower than it was asked to be.
        """
        if self.branch is None:
            return self._watched(until), lambda: None
        branch = self.branch
        self._empty_inbox()
        live, asked = self._gather(now)
        entry = self._recorded()
        inputs, requests = branch.merge(entry, live, asked, self.simulation)
        budget = self._live_budget(until)
        if entry is not None and not branch.parted:
            budget = replace(budget, steps=entry.steps)
        made = self._advance(inputs, budget)
        if entry is not None:
            self._follow(made)
            self.player.count(made, compare=not branch.parted)

        def answer() -> None:
            for request, result in zip(requests, made.answers, strict=True):
                request.done(result)

        return branch.finish(made), answer

    def _watched(self, until: float) -> Frame:
        """Play what is due; what its last frame shows, with the edits of all."""
        player = self.player
        edits: tuple[AppliedEdit, ...] = ()
        differing = player.differing
        for left in reversed(range(self._due)):
            frame = player.play()
            edits += frame.edits
            if left and time.perf_counter() > until:
                break
        if player.simulation.epoch != self._shown:
            # Its keyframe has those of frames that were not shown.
            edits = frame.edits
            self._show_another_epoch()
        elif frame.tools_changed:
            self._follow_tools()
        self._follow(frame)
        if player.differing and not differing:
            why = "another processor or version"
            self._notes.append(f"frame {frame.journal.frame} is not bit for bit as recorded: {why}")
        events, self._notes = (*self._notes, *frame.events), []
        # The recording has the edits of its cuts: nobody shall plan them again.
        return replace(frame, edits=edits, cuts=(), events=events)

    def _show_another_epoch(self) -> None:
        player = self.player
        self._shown = player.simulation.epoch
        start = player.recording.epoch_at(max(player.frame, 1)).start
        self._switch((player.simulation, start, self._prepare(player.simulation)))

    def _recorded(self) -> JournalEntry | None:
        """The recorded frame that a branch goes on with; None: there is none any more."""
        recording, following = self.player.recording, self.player.frame + 1
        first = following == 1
        over = self.player.over or (recording.begins(following) and not first)
        # After a load or a reset nothing of the recording fits.
        elsewhere = self.branch is not None and self.simulation.epoch.hex() != self.branch.id
        return None if over or elsewhere else recording.entry(following)

    def _follow(self, frame: Frame) -> None:
        """Let trackers know what the recording does with their tools."""
        sourced = self._sourced()
        for sample in frame.journal.inputs.tools:
            if sample.tool in self.trackers and sample.tool not in sourced:
                self.trackers[sample.tool].adopt(sample)

    def _sourced(self) -> Mapping[str, ToolTracker]:
        own = self.branch.own if self.branch is not None else set()
        return {tool: tracker for tool, tracker in self.trackers.items() if tool in own}

    def _hand_over(self, tool: str) -> None:
        if self.branch is not None and tool in self.trackers:
            self.branch.hand_over(tool)

    # What people ask for

    def begin_branch(self) -> None:
        """Go on live from here, in an epoch of its own: what was planned before is stale."""
        self.clock.paused, self.clock.rate = False, 1.0
        self.simulation.epoch = os.urandom(16)
        self._show_another_epoch()
        self.branch = Branch(self.simulation.epoch.hex(), self.simulation.frame)

    def postpone(self, request: Request) -> None:
        """Answer a request when the time that is sought is reached."""
        self._postponed.append(request)

    def _accept(self, request: Request, commands: list[Command], answers_to: list[Request]) -> None:
        if request.kind == SET_PLAYBACK:
            answer_change(self, request)
        elif self.branch is None:
            refuse(request, "BUSY", WATCHED)
        elif self._is_somebody_elses(request):
            refuse(request, "BUSY", "the tool follows the recording; take it over first")
        else:
            super()._accept(request, commands, answers_to)

    def _is_somebody_elses(self, request: Request) -> bool:
        """Whether a request is about a tool that follows the recording and was not taken over."""
        assert self.branch is not None
        tool = str(request.arguments.get("tool", request.arguments.get("id", "")))
        if tool in self.trackers:
            return not self.branch.hand_over(tool)
        if request.kind == "set_tool":
            self.branch.own.add(tool)
        return False
