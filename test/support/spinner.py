"""A thread that spins a node of a test, and ends before anything it uses is taken down."""

from __future__ import annotations

import threading

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future


class Spinner:
    """Spins one node until it is stopped.

    `Executor.shutdown` does not wait for the thread that spins: it destroys the guard conditions
    this thread waits for, and the process can die of it.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._end: Future[None] = Future()
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        self._executor.spin_until_future_complete(self._end)

    def stop(self) -> None:
        """End the thread, then destroy the node, the executor and the context, in this order.

        Raises:
            TimeoutError: A callback does not end.
        """
        self._end.set_result(None)
        self._thread.join(timeout=60.0)
        if self._thread.is_alive():
            raise TimeoutError(f"a callback of {self._node.get_name()} does not end")
        self._executor.remove_node(self._node)
        self._node.destroy_node()
        self._executor.shutdown()
        self._node.context.try_shutdown()
