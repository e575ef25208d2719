"""What keys do while a recording is watched, and the line that says how it is played."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissue_sim.playback.clock import FASTEST, SLOWEST

if TYPE_CHECKING:
    from tissue_sim.playback_client import PlaybackClient

STEP = 5.0
"""How far an arrow goes [s]."""

HELP = "space pause   ←/→ 5 s   +/- rate   l loop   t take over   q quit"


def act_on(key: str, client: PlaybackClient) -> bool:
    """Do what a key stands for; False: it ends the watching."""
    # Here, so that the command's help needs no ROS.
    from tissue_interfaces.srv import SetPlayback

    ask, told = SetPlayback.Request, client.playback
    if key == "q":
        return False
    if told is None:
        return True
    if key == " ":
        client.change(ask.RESUME if told.paused else ask.PAUSE)
    elif key in ("left", "right"):
        way = STEP if key == "right" else -STEP
        client.change(ask.SEEK, min(max(client.time + way, 0.0), told.duration))
    elif key in ("+", "=", "-"):
        factor = 0.5 if key == "-" else 2.0
        client.change(ask.RATE, min(max(told.rate * factor, SLOWEST), FASTEST))
    elif key == "l":
        client.change(ask.LOOP, float(not told.looping))
    elif key == "t":
        client.change(ask.TAKE_OVER)
    return True


def status_line(client: PlaybackClient, coarse: bool = False) -> str:
    """How it is played, in a few words.

    Args:
        client: What was told.
        coarse: Whole tenths of the way only: a line that seldom changes.
    """
    told, status = client.playback, client.status
    if told is None:
        return "loading"
    if told.branch:
        return f"live after frame {told.branch_frame}: {', '.join(told.taken_over)} taken over"
    if status is not None and status.request == "seek":
        return f"on the way: {status.progress:.0%}"
    time = client.time
    if coarse and not told.paused:
        time = told.duration * int(10 * time / told.duration) / 10
    words = f"{time:.1f} of {told.duration:.1f} s"
    if told.paused:
        return f"{words}, paused"
    return f"{words}, rate {told.rate:g}" + (", looping" if told.looping else "")
