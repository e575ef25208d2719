"""What the simulation's node serves: requests are queued for the loop, which answers them."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger
from tissue_interfaces.srv import (
    ApplyEdit,
    Grab,
    Load,
    Release,
    RemoveTool,
    Save,
    SetModel,
    SetTool,
    Undo,
)

from tissue_sim import conversions, edit_messages
from tissue_sim.frame import Answer
from tissue_sim.geometry.edit import REDO, UNDO
from tissue_sim.live import LiveSimulation
from tissue_sim.requests import PlannedEdit, Request

REMEMBERED = 1024
"""Answers kept for repeated requests."""

ArgumentsOf = Callable[[Any], Mapping[str, Any]]


class SimulationServices:
    """The services of the node; everything runs in the executor's thread.

    A handler waits for the loop without standing in the way of other callbacks: it awaits a future
    in a reentrant group of its own, and the loop wakes the executor when it has set the result.
    """

    def __init__(
        self, node: Node, live: LiveSimulation, frame_id: str, tools_changed: Callable[[], None]
    ) -> None:
        """Offer the services.

        Args:
            node: The node.
            live: What answers.
            frame_id: The organ's frame.
            tools_changed: Called in the executor's thread after tools were set or removed.
        """
        self._node, self._live, self._frame_id = node, live, frame_id
        self._tools_changed = tools_changed
        self._answers: OrderedDict[tuple[str, str], Future] = OrderedDict()
        self._stopped = threading.Event()
        for kind, service, name, arguments in (
            ("grab", Grab, "tissue/grab", _grab),
            ("release", Release, "tissue/release", _release),
            ("save", Save, "tissue/save", _name),
            ("load", Load, "tissue/load", _name),
            ("set_model", SetModel, "tissue/set_model", _set_model),
            ("set_tool", SetTool, "tissue/set_tool", _set_tool),
            ("remove_tool", RemoveTool, "tissue/remove_tool", _remove_tool),
            ("edit", ApplyEdit, "tissue/apply_edit", _edit),
            ("undo", Undo, "tissue/undo", _author),
            ("redo", Undo, "tissue/redo", _author),
            ("pause", SetBool, "tissue/pause", _pause),
            ("reset", Trigger, "tissue/reset", _reset),
        ):
            self.offer(kind, service, name, arguments)

    def offer(self, kind: str, service: Any, name: str, arguments: ArgumentsOf) -> None:
        """Offer a service whose requests the loop answers.

        Args:
            kind: Kind of the requests.
            service: Its type.
            name: Its name.
            arguments: What a message asks for.
        """
        handler = self._handler(kind, arguments)
        self._node.create_service(service, name, handler, callback_group=ReentrantCallbackGroup())

    def stop(self) -> None:
        """Answer whoever waits still: the simulation ends."""
        self._stopped.set()
        for future in list(self._answers.values()):
            if not future.done():
                future.set_result(Answer("", False, "the simulation ends", "BUSY"))

    def _handler(
        self, kind: str, arguments_of: ArgumentsOf
    ) -> Callable[[Any, Any], Awaitable[Any]]:
        async def handle(request: Any, response: Any) -> Any:
            message = request.edit if kind == "edit" else request
            request_id = str(getattr(message, "request_id", ""))
            key = (kind, request_id or f"#{id(request)}")
            future = self._answers.get(key) if request_id else None
            if future is None:
                future = self._ask(key, kind, arguments_of, request, request_id)
            answer: Answer = await future
            if kind in ("set_tool", "remove_tool"):
                self._tools_changed()
            if not request_id:
                self._answers.pop(key, None)
            return self._respond(kind, answer, response)

        return handle

    def _ask(
        self,
        key: tuple[str, str],
        kind: str,
        arguments_of: ArgumentsOf,
        request: Any,
        request_id: str,
    ) -> Future:
        future = Future()
        self._answers[key] = future
        while len(self._answers) > REMEMBERED:
            self._answers.popitem(last=False)
        try:
            arguments = arguments_of(request)
        except ValueError as error:
            code = "INVALID" if kind == "edit" else "OUT_OF_RANGE"
            future.set_result(Answer(request_id, False, str(error), code))
            return future

        def done(answer: Answer) -> None:
            future.set_result(answer)
            executor = self._node.executor
            if executor is not None:
                executor.wake()

        if self._stopped.is_set():
            done(Answer(request_id, False, "the simulation ends", "BUSY"))
        else:
            self._live.post(Request(kind, arguments, request_id, done))
        return future

    def _respond(self, kind: str, answer: Answer, response: Any) -> Any:
        response.success = bool(answer.success)
        response.message = answer.message
        if hasattr(response, "error_code"):
            response.error_code = int(getattr(response, answer.error, 0))
        if kind == "grab":
            for name in ("hold_id", "nodes", "taken"):
                setattr(response, name, int(answer.values.get(name, 0)))
        elif kind in (UNDO, REDO):
            for name, value in answer.values.items():
                setattr(response, name, value)
        elif kind == "edit" and answer.success:
            applied = answer.values["applied"]
            stamp = self._node.get_clock().now().to_msg()
            response.version = applied.change.edit.version
            response.hold_id = int(answer.values["hold_id"])
            response.apply_ms = 1e3 * float(applied.seconds)
            response.applied = edit_messages.edit_to_msg(
                applied.change.edit, answer.values["epoch"], self._frame_id, stamp
            )
        return response


def _grab(request: Any) -> dict[str, Any]:
    return {"tool": request.tool, "radius": float(request.radius)}


def _release(request: Any) -> dict[str, Any]:
    return {"hold_id": int(request.hold_id), "tool": request.tool}


def _name(request: Any) -> dict[str, Any]:
    return {"name": request.name}


def _author(request: Any) -> dict[str, Any]:
    return {"author": request.author}


def _set_model(request: Any) -> dict[str, Any]:
    names, values = list(request.parameter_names), list(request.parameter_values)
    if len(names) != len(values):
        raise ValueError(f"{len(names)} parameter names and {len(values)} values")
    parameters = {name: float(value) for name, value in zip(names, values, strict=True)}
    return {"model": request.model, "parameters": parameters}


def _set_tool(request: Any) -> dict[str, Any]:
    return conversions.tool_arguments(request.tool)


def _remove_tool(request: Any) -> dict[str, Any]:
    return {"tool": request.tool}


def _edit(request: Any) -> dict[str, Any]:
    edit = edit_messages.edit_from_msg(request.edit)
    return {"planned": PlannedEdit(edit, conversions.epoch_of(request.edit))}


def _pause(request: Any) -> dict[str, Any]:
    return {"on": bool(request.data)}


def _reset(_request: Any) -> dict[str, Any]:
    return {}
