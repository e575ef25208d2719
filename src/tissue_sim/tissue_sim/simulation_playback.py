"""What the simulation's node says and serves about a recording that it plays."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from tissue_interfaces.msg import Playback
from tissue_interfaces.srv import SetPlayback

from tissue_sim import conversions, qos
from tissue_sim.playback.changes import (
    LOOP,
    PAUSE,
    RATE,
    RESUME,
    SEEK,
    SET_PLAYBACK,
    TAKE_OVER,
)
from tissue_sim.playback.played import PlayedSimulation
from tissue_sim.playback.state import PlaybackState
from tissue_sim.simulation_services import SimulationServices

LOOK = 0.05
"""Period of looking whether something has changed [s]."""

REPEAT = 1.0
"""It is told at least so often [s]."""

CHANGES = {
    SetPlayback.Request.PAUSE: PAUSE,
    SetPlayback.Request.RESUME: RESUME,
    SetPlayback.Request.SEEK: SEEK,
    SetPlayback.Request.RATE: RATE,
    SetPlayback.Request.LOOP: LOOP,
    SetPlayback.Request.TAKE_OVER: TAKE_OVER,
}


class PlaybackTopics:
    """`tissue/playback` and `tissue/set_playback`; runs in the executor's thread."""

    def __init__(
        self,
        node: Node,
        live: PlayedSimulation,
        served: SimulationServices,
        frame_id: str,
        tools_changed: Callable[[], None],
    ) -> None:
        """Begin to tell and to serve.

        Args:
            node: The simulation's node.
            live: What plays.
            served: Where the service joins the others.
            frame_id: The organ's frame.
            tools_changed: Called when the recording has set or removed tools.
        """
        self._live, self._frame_id, self._tools_changed = live, frame_id, tools_changed
        self._publisher = node.create_publisher(Playback, "tissue/playback", qos.LATCHED)
        self._told: tuple[Any, ...] = ()
        self._told_at = 0.0
        self._tools = list(live.trackers)
        served.offer(SET_PLAYBACK, SetPlayback, "tissue/set_playback", _arguments)
        node.create_timer(LOOK, self._look, callback_group=MutuallyExclusiveCallbackGroup())

    def _look(self) -> None:
        tools = list(self._live.trackers)
        if tools != self._tools:
            self._tools = tools
            self._tools_changed()
        state, now = self._live.state, time.monotonic()
        changed = (
            state.rate, state.paused, state.looping, state.taken_over, state.branch, state.seeking,
            self._live.switched,
        )  # fmt: skip
        if changed != self._told or now - self._told_at > REPEAT:
            self._told, self._told_at = changed, now
            self._publisher.publish(self._message(state))

    def _message(self, state: PlaybackState) -> Playback:
        recording = self._live.player.recording
        return Playback(
            header=conversions.header(self._frame_id, conversions.stamp_of(time.time_ns())),
            bag=recording.name,
            time=state.time,
            duration=recording.seconds,
            rate=state.rate,
            paused=state.paused,
            looping=state.looping,
            taken_over=list(state.taken_over),
            branch=state.branch,
            branch_frame=state.branch_frame,
        )


def _arguments(request: SetPlayback.Request) -> dict[str, Any]:
    what = CHANGES.get(request.what, str(request.what))
    return {"what": what, "value": float(request.value), "tools": list(request.tools)}
