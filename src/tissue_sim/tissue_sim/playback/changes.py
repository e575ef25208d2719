"""What people may change about how a recording is played."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tissue_sim.commands import CommandError
from tissue_sim.frame import Answer
from tissue_sim.playback.clock import checked_rate
from tissue_sim.requests import Request, refuse

if TYPE_CHECKING:
    from tissue_sim.playback.played import PlayedSimulation

SET_PLAYBACK = "set_playback"
"""Kind of requests that change how a recording is played."""

PAUSE, RESUME, SEEK, RATE, LOOP, TAKE_OVER = CHANGES = (
    "pause", "resume", "seek", "rate", "loop", "take_over",
)  # fmt: skip


def answer_change(played: PlayedSimulation, request: Request) -> None:
    """Carry out a request of the kind SET_PLAYBACK, or refuse it, and answer."""
    arguments = request.arguments
    if arguments["what"] == TAKE_OVER and _needs_time(played):
        played.postpone(request)
        return
    try:
        message = change(
            played, str(arguments["what"]), float(arguments["value"]), tuple(arguments["tools"])
        )
    except CommandError as error:
        refuse(request, error.code, str(error))
    except ValueError as error:
        refuse(request, "INVALID", str(error))
    else:
        request.done(Answer(request.request_id, True, message))


def change(
    played: PlayedSimulation, what: str, value: float = 0.0, tools: Sequence[str] = ()
) -> str:
    """Change how a recording is played; says what was done. Nothing happens on an error.

    Args:
        played: What plays it.
        what: One of CHANGES.
        value: Time [s], rate, or whether to loop.
        tools: Tools to take over; none: all.

    Raises:
        CommandError: It is unknown, a tool is not there, or people have taken over.
        ValueError: The value is not allowed.
    """
    player, clock = played.player, played.clock
    if what == TAKE_OVER:
        return _take_over(played, tools)
    if played.branch is not None:
        raise CommandError(
            "BRANCHED",
            f"people took over after frame {played.branch.frame}: there is no way back to the "
            "recording; tissue/pause pauses the simulation",
        )
    if what == PAUSE:
        clock.paused = True
        return "paused"
    if what == RESUME:
        if player.over:
            player.seek(1)
        clock.paused = False
        return "playing"
    if what == SEEK:
        player.seek(player.recording.frame_at(value))
        return f"going to {value:g} s"
    if what == RATE:
        clock.rate = checked_rate(value)
        return f"rate {value:g}"
    if what == LOOP:
        clock.looping = bool(value)
        return "looping" if clock.looping else "not looping"
    allowed = ", ".join(CHANGES)
    raise CommandError("INVALID", f"{what!r} is not allowed; allowed: {allowed}")


def _needs_time(played: PlayedSimulation) -> bool:
    """Whether there is no state to take over yet; then it is on its way."""
    if played.player.states is not None:
        played.player.simulate()
    return played.player.target > 0


def _take_over(played: PlayedSimulation, tools: Sequence[str]) -> str:
    there = played.simulation.tools
    taken = played.branch.taken if played.branch is not None else set()
    unknown = [tool for tool in tools if tool not in there]
    if unknown:
        known = ", ".join(there) or "none"
        raise CommandError("UNKNOWN_TOOL", f"there is no tool {unknown[0]!r}; tools: {known}")
    twice = sorted(set(tools) & taken)
    if twice:
        raise CommandError("INVALID", f"{', '.join(twice)} is taken over already")
    wanted = set(tools) or set(there) - taken
    if played.branch is not None and not wanted:
        raise CommandError("INVALID", "every tool is taken over already")
    if played.branch is None:
        played.begin_branch()
    assert played.branch is not None
    played.branch.taken |= wanted
    return f"taken over: {', '.join(sorted(wanted)) or 'no tool'}"
