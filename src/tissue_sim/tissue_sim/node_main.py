"""What every node's main() shares: parameters, one executor, a clean end."""

from __future__ import annotations

import contextlib
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from tissue_sim.discovery import stay_local
from tissue_sim.parameters import ParameterError, Spec, refuse_unknown

_OWN = ("use_sim_time", "start_type_description_service")
_TYPES = {
    "bool": Parameter.Type.BOOL,
    "integer": Parameter.Type.INTEGER,
    "double": Parameter.Type.DOUBLE,
    "string": Parameter.Type.STRING,
    "doubles": Parameter.Type.DOUBLE_ARRAY,
    "strings": Parameter.Type.STRING_ARRAY,
}


def overrides(node: Node) -> dict[str, Any]:
    """Parameter values given on the command line and in files, by full name."""
    return {name: given.value for name, given in node._parameter_overrides.items()}


def names_under(node: Node, prefix: str) -> list[str]:
    """The names N of all given parameters `prefix.N.key`, sorted; for families of parameters."""
    start = prefix + "."
    tails = (name[len(start) :] for name in overrides(node) if name.startswith(start))
    return sorted({tail.rsplit(".", 1)[0] for tail in tails if "." in tail})


def declare(node: Node, specs: Iterable[Spec]) -> dict[str, Any]:
    """Declare all parameters of a node, once, and give their checked values by full name.

    A whole number given for a `double` is taken as one. Live parameters may be set later, within
    their limits.

    Raises:
        ParameterError: A value is not allowed, or a parameter was given that is not in the table.
    """
    table = {spec.name: spec for spec in specs}
    given = overrides(node)
    own = [name for name in given if name in _OWN or name.startswith("qos_overrides.")]
    refuse_unknown(given, [*table, *own])
    values = {}
    for spec in table.values():
        value = given.get(spec.name)
        values[spec.name] = spec.checked(spec.default if value is None else value)
        # The override is replaced by what was checked: rclpy would refuse a 1 where 1.0 is meant.
        checked = Parameter(spec.name, _TYPES[spec.kind], values[spec.name])
        node._parameter_overrides[spec.name] = checked
        node.declare_parameter(spec.name, checked.value, _descriptor(spec))
    node.add_on_set_parameters_callback(lambda changes: _check_changes(table, changes))
    return values


def _descriptor(spec: Spec) -> ParameterDescriptor:
    unit = f" [{spec.unit}]" if spec.unit else ""
    descriptor = ParameterDescriptor(
        name=spec.name,
        type=_TYPES[spec.kind].value,
        description=f"{spec.description}{unit}",
        additional_constraints=spec.allowed,
        read_only=not spec.live,
        # rclpy takes an empty list for a list of bytes; `Spec.checked` knows better.
        dynamic_typing=spec.kind in ("doubles", "strings"),
    )
    if spec.minimum is not None and spec.maximum is not None:
        if spec.kind == "double":
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(spec.minimum), to_value=float(spec.maximum))
            ]
        elif spec.kind == "integer":
            descriptor.integer_range = [
                IntegerRange(from_value=int(spec.minimum), to_value=int(spec.maximum), step=1)
            ]
    return descriptor


def _check_changes(table: dict[str, Spec], changes: list[Parameter]) -> SetParametersResult:
    for change in changes:
        try:
            if change.name in table:
                table[change.name].checked(change.value)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)


def run(factory: Callable[[], Node], args: list[str] | None = None) -> int:
    """Make a node, spin it in one SingleThreadedExecutor until it is interrupted, and take it down.

    A node may have `close()`, called before it is destroyed, and an `exit_code`.

    Args:
        factory: Makes the node; called after rclpy.init.
        args: Command line without the program's name; None for sys.argv.

    Returns:
        Exit code: the node's own, or 2 when it refuses to start.
    """
    stay_local()
    nodes: list[Node] = []
    code = 0
    end = _End()
    try:
        try:
            _spin(factory, args, nodes, end)
        except (ValueError, OSError, rclpy_implementation.RCLError) as error:
            if not (nodes and isinstance(error, rclpy_implementation.RCLError)) or rclpy.ok():
                print(f"{Path(sys.argv[0]).stem}: {error}", file=sys.stderr, flush=True)
                code = 2
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    for node in nodes:
        close = getattr(node, "close", None)
        if close is not None:
            close()
        code = code or int(getattr(node, "exit_code", 0))
        node.destroy_node()
    rclpy.try_shutdown()
    return code


class _End:
    """Notices Ctrl-C and SIGTERM while the executor waits.

    rclpy's own handler ends the context at once, under the feet of threads that still publish. Here
    the node is closed first: Python's handler interrupts only the making of the node; later a byte
    that the signal writes wakes the executor.

    Attributes:
        asked: Whether to end.
        executor: What to wake; None while the node is being made.
    """

    def __init__(self) -> None:
        self.asked = False
        self.executor: SingleThreadedExecutor | None = None
        self._reader, self._writer = socket.socketpair()
        self._writer.setblocking(False)
        signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._interrupt)
        threading.Thread(target=self._watch, name="end", daemon=True).start()

    def _interrupt(self, *_: object) -> None:
        self.asked = True
        if self.executor is None:
            raise KeyboardInterrupt

    def _watch(self) -> None:
        while self._reader.recv(1):
            self.asked = True
            if self.executor is not None:
                self.executor.wake()


def _spin(
    factory: Callable[[], Node], args: list[str] | None, nodes: list[Node], end: _End
) -> None:
    """Make the node and spin it until the end is asked for or the context ends."""
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    with contextlib.suppress(ExternalShutdownException):
        node = factory()
        nodes.append(node)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        end.executor = executor
        while rclpy.ok() and not end.asked:
            executor.spin_once()
