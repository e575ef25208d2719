"""At most one simulator publishes a tissue/state."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from tissue_interfaces.msg import Status

from tissue_sim import conversions, qos

LOOK_AROUND = 1.0
"""Time from the node's start after which another simulator has usually been seen [s]."""

PROBATION = 10.0
"""Time from the node's start after which another simulator must be the newer one [s]."""

LOOK_AGAIN = 0.2
"""Period of looking for another simulator meanwhile [s]."""


class Rivals:
    """Looks for other simulators of the same resolved topic; runs in the executor's thread.

    Discovery can be slow: one that is not seen before the first frame is looked for a while longer.
    Of two simulators the one that was ready later gives way.
    """

    def __init__(self, node: Node, topic: str) -> None:
        """Begin to look around.

        Args:
            node: The node, which publishes the topic itself already.
            topic: Resolved name of tissue/state.
        """
        self._node, self._topic = node, topic
        self._started = time.perf_counter()
        self._ready_at = 0
        self._timer: Timer | None = None
        self._status: Subscription | None = None

    @property
    def _reason(self) -> str:
        return (
            f"another simulator publishes {self._topic} already; start this one in another "
            "namespace (-r __ns:=/other) or ROS_DOMAIN_ID"
        )

    @property
    def _seen(self) -> bool:
        return bool(self._node.count_publishers(self._topic) > 1)

    def refuse(self) -> None:
        """Wait until others have usually been seen.

        Raises:
            ValueError: Another simulator is there.
        """
        time.sleep(max(0.0, LOOK_AROUND - (time.perf_counter() - self._started)))
        if self._seen:
            raise ValueError(self._reason)

    def watch(self, own_epoch: Callable[[], bytes], give_way: Callable[[str], None]) -> None:
        """Go on looking for a while.

        Args:
            own_epoch: Gives the epoch of this simulator.
            give_way: Called with the reason when the other was ready before.
        """
        self._ready_at = time.time_ns()

        def on_status(status: Status) -> None:
            is_other = conversions.epoch_of(status) != own_epoch()
            before = conversions.nanoseconds_of(status.header.stamp) < self._ready_at
            if is_other and before and status.state != Status.LOADING:
                give_way(self._reason)

        def look() -> None:
            if time.perf_counter() - self._started > PROBATION:
                self._end()
            elif not self._status and self._seen:
                self._status = self._node.create_subscription(
                    Status, "tissue/status", on_status, qos.LATCHED
                )

        self._timer = self._node.create_timer(LOOK_AGAIN, look)

    def _end(self) -> None:
        if self._timer:
            self._node.destroy_timer(self._timer)
        if self._status:
            self._node.destroy_subscription(self._status)
