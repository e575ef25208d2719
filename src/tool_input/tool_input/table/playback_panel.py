"""The bar of a recording that is played: pause, rate, place, loop, and taking over."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import viser
from tissue_interfaces.msg import Playback
from tissue_interfaces.srv import SetPlayback

from tool_input.table.person import Person

RATES = {"1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0, "4": 4.0}
"""Recorded seconds a second."""

EVERYTHING = "all tools"
FIRST = 0.0
"""Order of the bar in the window: before all else, also in a window that is small."""

STEP = 0.01
"""Of the place in the recording [s]."""

SETTLED = 0.3
"""The recording goes where the slider has stayed for so long [s]: going there takes work."""


class PlaybackPanel:
    """Shown as long as a recording is played; what others do to it is followed."""

    def __init__(
        self, person: Person, gui: viser.GuiApi, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin without a bar.

        Args:
            person: Whose window it is.
            gui: The window's controls.
            clock: Seconds.
        """
        self._person = person
        self._clock = clock
        self._moved: float | None = None
        self._gui = gui
        self._heard: Playback | None = None
        self._folder: viser.GuiFolderHandle | None = None
        self._tools: tuple[str, ...] = ()

    def update(self) -> None:
        """Show where the recording is now."""
        if self._moved is not None and self._clock() - self._moved > SETTLED:
            self._moved = None
            self._ask(SetPlayback.Request.SEEK, self._place.value)
        playback = self._person.desk.playback
        if playback is None or playback is self._heard:
            return
        if self._folder is None or self._heard is None or _other(self._heard, playback):
            self._build(playback)
        self._heard = playback
        self._text.content = _told(playback)
        if self._moved is None:
            self._place.value = min(max(round(playback.time, 2), 0.0), self._place.max)
        self._paused.value, self._loop.value = playback.paused, playback.looping
        tools = (EVERYTHING, *sorted(set(self._person.desk.tools) - set(playback.taken_over)))
        if tools != self._tools:
            self._tools = self._tool.options = tools

    def _build(self, playback: Playback) -> None:
        gui = self._gui
        if self._folder is not None:
            self._folder.remove()
        self._folder = gui.add_folder("Recording", order=FIRST)
        branched = bool(playback.branch)
        with self._folder:
            self._text = gui.add_markdown("")
            last = max(int(playback.duration / STEP), 1) * STEP
            self._place = gui.add_slider(
                "Time [s]", 0.0, round(last, 2), STEP, 0.0, disabled=branched
            )
            self._paused = gui.add_checkbox("Paused", playback.paused)
            rate = gui.add_button_group("Rate", tuple(RATES), disabled=branched)
            self._loop = gui.add_checkbox("Loop", playback.looping, disabled=branched)
            self._tools = (EVERYTHING,)
            self._tool = gui.add_dropdown("Tools", self._tools)
            take = gui.add_button("Take over", hint="They go on live from exactly this state")
        ask, own = self._ask, self._by_person
        self._place.on_update(own(lambda: setattr(self, "_moved", self._clock())))
        self._paused.on_update(own(self._pause))
        rate.on_click(own(lambda: ask(SetPlayback.Request.RATE, RATES[rate.value])))
        self._loop.on_update(own(lambda: ask(SetPlayback.Request.LOOP, float(self._loop.value))))
        take.on_click(own(self._take_over))

    def _by_person(self, act: Any) -> Any:
        """A callback that leaves out what `update` does to a control."""

        def callback(event: Any) -> None:
            if event.client is not None:
                act()

        return self._person.in_turn(callback)

    def _pause(self) -> None:
        paused = self._paused.value
        self._ask(SetPlayback.Request.PAUSE if paused else SetPlayback.Request.RESUME)

    def _take_over(self) -> None:
        tool = self._tool.value
        self._ask(SetPlayback.Request.TAKE_OVER, tools=[] if tool == EVERYTHING else [tool])

    def _ask(self, what: int, value: float = 0.0, tools: list[str] | None = None) -> None:
        request = SetPlayback.Request(what=what, value=float(value), tools=tools or [])
        self._person.request("set_playback", request)


def _other(before: Playback, now: Playback) -> bool:
    """Whether another bar is needed: of another recording, or of one that has branched."""
    return (before.bag, before.duration, bool(before.branch)) != (
        now.bag, now.duration, bool(now.branch),
    )  # fmt: skip


def _told(playback: Playback) -> str:
    text = f"**{playback.bag}**  \n{playback.time:.1f} of {playback.duration:.1f} s"
    if playback.rate != 1.0:
        text += f", {playback.rate:g} times as fast"
    if playback.branch:
        taken = ", ".join(playback.taken_over) or "no tool"
        text += f"  \nBranch after frame {playback.branch_frame}; taken over: {taken}"
    return text
