"""`tissue undo` and `tissue redo`."""

from __future__ import annotations

import os
import time
from typing import Annotated, Any

import typer

from tissue_sim.launcher import LaunchError

Namespace = Annotated[str, typer.Option(help="Namespace of the organ.")]
Times = Annotated[int, typer.Option("--times", "-n", min=1, help="How many edits.")]
Wait = Annotated[float, typer.Option(help="Longest wait for the simulation and its answers [s].")]


def undo(namespace: Namespace = "", times: Times = 1, timeout: Wait = 10.0) -> None:
    """Take back the newest edits of a running simulation, whoever made them."""
    _ask("undo", namespace, times, timeout)


def redo(namespace: Namespace = "", times: Times = 1, timeout: Wait = 10.0) -> None:
    """Make edits again that were undone last, in a running simulation."""
    _ask("redo", namespace, times, timeout)


def _ask(kind: str, namespace: str, times: int, timeout: float) -> None:
    import rclpy
    from tissue_interfaces.srv import Undo

    context = rclpy.Context()
    rclpy.init(context=context)
    try:
        node = rclpy.create_node(
            f"tissue_{kind}_{os.getpid()}", context=context, namespace=namespace or None
        )
        client = node.create_client(Undo, f"tissue/{kind}")
        if not client.wait_for_service(timeout_sec=timeout):
            raise LaunchError(f"no simulation offers {client.srv_name}; is one running?")
        for number in range(times):
            author, key = node.get_name(), f"{time.time_ns():x}-{number}"
            answer = _answer(client, Undo.Request(author=author, request_id=key), node, timeout)
            if not answer.success:
                raise LaunchError(answer.message)
            typer.echo(
                f"{answer.message}; {answer.can_undo} more to undo, {answer.can_redo} to redo"
            )
    finally:
        rclpy.shutdown(context=context)


def _answer(client: Any, request: Any, node: Any, timeout: float) -> Any:
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    future = client.call_async(request)
    executor.spin_until_future_complete(future, timeout_sec=timeout)
    executor.remove_node(node)
    executor.shutdown()
    if not future.done():
        raise LaunchError(f"{client.srv_name} did not answer within {timeout:g} s")
    return future.result()
