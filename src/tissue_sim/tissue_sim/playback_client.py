"""A node that follows how a recording is played, and changes it."""

from __future__ import annotations

import os
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future
from tissue_interfaces.msg import Playback, Status
from tissue_interfaces.srv import SetPlayback

from tissue_sim import qos


class PlaybackClient:
    """Hears `tissue/playback` and calls `tissue/set_playback`; use it as a context manager.

    Attributes:
        playback: How it is played, as told last; None: nothing was told yet.
        status: What the simulation is doing, as told last.
        said: What was refused since somebody looked.
    """

    def __init__(self) -> None:
        """Join the domain."""
        self.playback: Playback | None = None
        self.status: Status | None = None
        self.said: list[str] = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node(f"tissue_replay_{os.getpid()}", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(Playback, "tissue/playback", self._hear, qos.LATCHED)
        self._node.create_subscription(Status, "tissue/status", self._hear_status, qos.LATCHED)
        self._client = self._node.create_client(SetPlayback, "tissue/set_playback")
        self._heard_at = 0.0

    def __enter__(self) -> PlaybackClient:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        rclpy.shutdown(context=self._context)

    @property
    def time(self) -> float:
        """Where the recording is now by what was told last [s]."""
        told = self.playback
        if told is None:
            return 0.0
        since = 0.0 if told.paused else (time.monotonic() - self._heard_at) * told.rate
        return float(min(told.time + since, told.duration))

    @property
    def at_end(self) -> bool:
        """Whether the recording stands at its end."""
        told = self.playback
        return told is not None and told.paused and told.time >= told.duration

    def poll(self, seconds: float) -> None:
        """Take what comes, for some time [s]."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def change(self, what: int, value: float = 0.0) -> None:
        """Ask for a change; `said` tells later whether it was refused.

        Args:
            what: A constant of `SetPlayback.Request`.
            value: What it needs.
        """
        request = SetPlayback.Request(what=what, value=float(value))
        self._client.call_async(request).add_done_callback(self._answered)

    def _hear(self, message: Playback) -> None:
        self.playback, self._heard_at = message, time.monotonic()

    def _hear_status(self, message: Status) -> None:
        self.status = message

    def _answered(self, future: Future) -> None:
        answer = future.result()
        if answer is not None and not answer.success:
            self.said.append(answer.message)
