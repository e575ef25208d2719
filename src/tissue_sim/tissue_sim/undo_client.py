"""A short-lived node that asks a running simulation to undo or redo edits."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import rclpy
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from tissue_interfaces.srv import Undo

from tissue_sim.launcher import LaunchError


def ask(
    kind: str, namespace: str, times: int, timeout: float, strokes: bool = False
) -> Iterator[str]:
    """Ask so many times; what the simulation says to each.

    Args:
        kind: "undo" or "redo".
        namespace: Of the organ; "": none.
        times: How many edits.
        timeout: Longest wait for the simulation and for each answer [s].
        strokes: Whether all edits of one stroke of a blade count as one.

    Raises:
        LaunchError: There is no simulation, or it refuses.
    """
    context = rclpy.Context()
    rclpy.init(context=context)
    try:
        name = f"tissue_{kind}_{os.getpid()}"
        node = rclpy.create_node(name, context=context, namespace=namespace or None)
        client = node.create_client(Undo, f"tissue/{kind}")
        if not client.wait_for_service(timeout_sec=timeout):
            raise LaunchError(f"no simulation offers {client.srv_name}; is one running?")
        number = 0
        while number < times:
            request = Undo.Request(author=name, request_id=f"{time.time_ns():x}-{number}")
            answer = _answer(node, client, request, timeout)
            if not answer.success:
                raise LaunchError(answer.message)
            yield f"{answer.message}; {answer.can_undo} more to undo, {answer.can_redo} to redo"
            stroke = stroke_of(answer.reverted_request_id)
            goes_on = strokes and stroke and stroke == stroke_of(answer.next_request_id)
            number += not goes_on
    finally:
        rclpy.shutdown(context=context)


def stroke_of(request_id: str) -> str:
    """The stroke that an edit belongs to; empty: none."""
    return request_id.rpartition("/")[0]


def _answer(node: Node, client: Client, request: Undo.Request, timeout: float) -> Undo.Response:
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    future = client.call_async(request)
    executor.spin_until_future_complete(future, timeout_sec=timeout)
    executor.remove_node(node)
    executor.shutdown()
    if not future.done():
        raise LaunchError(f"{client.srv_name} did not answer within {timeout:g} s")
    return future.result()
