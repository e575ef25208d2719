"""Edits that the cutting node asks the simulation for by itself."""

from __future__ import annotations

import time
import uuid
from dataclasses import replace

import numpy as np
from rclpy.node import Node
from rclpy.task import Future
from tissue_interfaces.srv import ApplyEdit

from tissue_sim import edit_messages
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.replica import Shape

REFUSED_PAUSE = 1.0
"""Wait after the simulation refused an edit before another one is planned [s]."""


class Proposals:
    """Edits sent to the simulation one at a time.

    Attributes:
        counts: What became of them.
        done: What those that were applied amount to, in whatever their sender counts.
        version: Version that the last one made; 0: there is none in this epoch.
        said: What the simulation said last when it refused one; empty: it never did.
    """

    def __init__(self, node: Node, patience: float) -> None:
        self.counts = {"applied": 0, "stale": 0, "refused": 0, "unanswered": 0}
        self.said, self.done, self.version = "", 0, 0
        self._amount = 0
        self._node, self._patience = node, patience
        self._client = node.create_client(ApplyEdit, "tissue/apply_edit")
        self._asked: Future | None = None
        self._since = self._not_before = -np.inf

    def busy(self) -> bool:
        """Whether an answer is awaited, or it is too early after a refusal."""
        now = time.monotonic()
        if self._asked is not None:
            if self._asked.done():
                self._take(self._asked.result(), now)
            elif now - self._since < self._patience:
                return True
            else:
                self.counts["unanswered"] += 1
            self._client.remove_pending_request(self._asked)
            self._asked = None
        return now < self._not_before or not self._client.service_is_ready()

    def _take(self, answer: ApplyEdit.Response, now: float) -> None:
        if answer.success:
            self.counts["applied"] += 1
            self.done += self._amount
            self.version = answer.version
        elif answer.error_code in (ApplyEdit.Response.STALE, ApplyEdit.Response.BUSY):
            self.counts["stale"] += 1
        else:
            self.counts["refused"] += 1
            self.said = answer.message
            self._not_before = now + REFUSED_PAUSE
            self._node.get_logger().warning(
                f"the simulation refused an edit: {answer.message}", throttle_duration_sec=5.0
            )

    def forget(self) -> None:
        """A new epoch: nobody answers what was asked in the old one."""
        if self._asked is not None:
            self._client.remove_pending_request(self._asked)
        self._asked, self.version = None, 0

    def send(
        self, edit: TopologyEdit, amount: int, shape: Shape, epoch: bytes, frame_id: str
    ) -> None:
        """Ask for an edit that was planned on a shape."""
        named = replace(
            edit, base_frame=shape.frame, author=self._node.get_name(),
            request_id=f"{edit.kind}-{uuid.uuid4().hex}",
        )  # fmt: skip
        stamp = self._node.get_clock().now().to_msg()
        message = edit_messages.edit_to_msg(named, epoch, frame_id, stamp)
        self._asked = self._client.call_async(ApplyEdit.Request(edit=message))
        self._since, self._amount = time.monotonic(), amount
