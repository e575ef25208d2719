"""Commands: changes of tools, holds, model and pause, undo and redo, between two frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from tissue_sim.elastic import registry
from tissue_sim.frame import Answer, AppliedEdit, Command
from tissue_sim.geometry.edit import UNDO, EditError
from tissue_sim.geometry.edit_history import NoEditError
from tissue_sim.interaction.tools import GRAB, LARGEST, SHAPES, ToolError, ToolSpec

if TYPE_CHECKING:
    from tissue_sim.simulation import Simulation


class CommandError(ValueError):
    """A command that cannot take effect.

    Attributes:
        code: Name of the error in the service's constants.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


def execute(simulation: Simulation, command: Command) -> Answer:
    """Carry out a command. Modifies the simulation in place, or nothing when it is refused."""
    handler = _HANDLERS.get(command.kind)
    if handler is None:
        message = f"unknown command {command.kind!r}; allowed: {', '.join(_HANDLERS)}"
        return Answer(command.request_id, False, message, "INVALID")
    try:
        message, values = handler(simulation, command.arguments, command.request_id)
    except CommandError as error:
        return Answer(command.request_id, False, str(error), error.code)
    return Answer(command.request_id, True, message, values=values)


_Result = tuple[str, dict[str, Any]]


def _tool(simulation: Simulation, name: str) -> ToolSpec:
    if name not in simulation.tools:
        known = ", ".join(simulation.tools) or "none"
        raise CommandError("UNKNOWN_TOOL", f"there is no tool {name!r}; known tools: {known}")
    return simulation.tools[name]


def _grab(simulation: Simulation, arguments: Mapping[str, Any], _: str) -> _Result:
    tool = _tool(simulation, str(arguments["tool"]))
    radius = float(arguments.get("radius", 0.0))
    own_shape = radius == 0.0 and tool.shape in SHAPES[GRAB]
    if not own_shape and not 0.0 < radius <= LARGEST:
        raise CommandError(
            "OUT_OF_RANGE", f"radius = {radius:g} m is not allowed; allowed: up to {LARGEST:g} m"
        )
    hold = simulation.grab(tool.id, radius, by_use=False)
    if hold is None:
        where = f"inside {tool.id}" if own_shape else f"within {radius:g} m of {tool.id}'s tip"
        raise CommandError("NOTHING_THERE", f"no free node {where}")
    values = {"hold_id": hold.id, "nodes": len(hold.rows), "taken": len(hold.waiting)}
    taken = f", {len(hold.waiting)} held already" if len(hold.waiting) else ""
    return f"{tool.id} holds {len(hold.rows)} nodes{taken}", values


def _release(simulation: Simulation, arguments: Mapping[str, Any], _: str) -> _Result:
    hold_id, tool = int(arguments.get("hold_id", 0)), str(arguments.get("tool", ""))
    if hold_id:
        holds = [simulation.holds.by_id[hold_id]] if hold_id in simulation.holds.by_id else []
    else:
        holds = simulation.holds.of_tool(tool)
    if not holds and (hold_id or tool not in simulation.tools):
        ids = ", ".join(map(str, simulation.holds.by_id)) or "none"
        what = f"hold {hold_id}" if hold_id else f"tool {tool!r}"
        raise CommandError("UNKNOWN_HOLD", f"there is no {what}; holds: {ids}")
    simulation.release(holds)
    return f"released {len(holds)} holds", {}


def _set_tool(simulation: Simulation, arguments: Mapping[str, Any], _: str) -> _Result:
    there = simulation.tools.get(str(arguments.get("id", "")))
    if there is not None and "hold" not in arguments:
        kept = there.as_arguments()
        arguments = {**arguments, "hold": kept["hold"], "coupling": kept["coupling"]}
    if there is not None and "cutting" not in arguments and there.kind == arguments.get("kind"):
        kept = there.as_arguments()
        arguments = {**arguments, "cutting": kept["cutting"], "response": kept["response"]}
    if there is not None and "contact" not in arguments and there.kind == arguments.get("kind"):
        arguments = {**arguments, "contact": there.contact.as_arguments()}
    try:
        tool = ToolSpec.from_arguments(arguments)
    except ToolError as error:
        raise CommandError("OUT_OF_RANGE", str(error)) from None
    simulation.set_tool(tool)
    return f"tool {tool.id} is set", {}


def _remove_tool(simulation: Simulation, arguments: Mapping[str, Any], _: str) -> _Result:
    tool = _tool(simulation, str(arguments["tool"]))
    simulation.remove_tool(tool.id)
    return f"tool {tool.id} is removed", {}


def checked_model(name: str, parameters: Mapping[str, Any]) -> dict[str, float]:
    """All parameters of a model, checked.

    Raises:
        CommandError: The model or a parameter is unknown, or a value is out of range.
    """
    if name not in registry.names():
        allowed = ", ".join(registry.names())
        raise CommandError("UNKNOWN_MODEL", f"there is no model {name!r}; allowed: {allowed}")
    try:
        return registry.checked_parameters(name, {k: float(v) for k, v in parameters.items()})
    except ValueError as error:
        raise CommandError("OUT_OF_RANGE", str(error)) from None


def _set_model(simulation: Simulation, arguments: Mapping[str, Any], request_id: str) -> _Result:
    name, parameters = str(arguments["model"]), arguments.get("parameters", {})
    checked_model(name, parameters)
    try:
        simulation.set_model(name, parameters, request_id)
    except ValueError as error:
        raise CommandError("OUT_OF_RANGE", str(error)) from None
    return f"the model is {name}", {}


def _pause(simulation: Simulation, arguments: Mapping[str, Any], _: str) -> _Result:
    simulation.paused = bool(arguments["on"])
    return "paused" if simulation.paused else "running", {}


def _undo(simulation: Simulation, arguments: Mapping[str, Any], request_id: str) -> _Result:
    return _bring_back(simulation, simulation.undo, arguments, request_id)


def _redo(simulation: Simulation, arguments: Mapping[str, Any], request_id: str) -> _Result:
    return _bring_back(simulation, simulation.redo, arguments, request_id)


def _bring_back(
    simulation: Simulation,
    bring_back: Callable[[str, str], AppliedEdit],
    arguments: Mapping[str, Any],
    request_id: str,
) -> _Result:
    try:
        applied = bring_back(str(arguments.get("author", "")), request_id)
    except NoEditError as error:
        raise CommandError("NOTHING_THERE", str(error)) from None
    except EditError as error:
        raise CommandError("REFUSED", str(error)) from None
    history, edit = simulation.history, applied.change.edit
    step = (history.undone if edit.kind == UNDO else history.done)[-1].edit
    by = f" by {step.author}" if step.author else ""
    asked = f" ({step.request_id})" if step.request_id else ""
    message = f"{edit.kind} of the {step.kind}{by}{asked}: version {edit.version}"
    waiting = history.done if edit.kind == UNDO else history.undone
    values = {
        "version": edit.version, "reverted_kind": step.kind, "reverted_author": step.author,
        "reverted_request_id": step.request_id, "can_undo": len(history.done),
        "can_redo": len(history.undone), "apply_ms": 1e3 * applied.seconds,
        "next_request_id": waiting[-1].edit.request_id if waiting else "",
    }  # fmt: skip
    return message, values


_HANDLERS: dict[str, Callable[[Simulation, Mapping[str, Any], str], _Result]] = {
    "grab": _grab,
    "release": _release,
    "set_model": _set_model,
    "set_tool": _set_tool,
    "remove_tool": _remove_tool,
    "pause": _pause,
    "undo": _undo,
    "redo": _redo,
}
