"""Services a procedure calls, without waiting for their answers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger
from tissue_interfaces.msg import Sweep
from tissue_interfaces.srv import AddPatch, Closure, Cut, Grab, Release, SetModel, Suture, Undo

from tool_input.patch_items import PatchItem
from tool_input.procedure import ALL_SUTURES, MAKES_SUTURES, Event, Procedure
from tool_input.rim_items import HoleItem
from tool_input.tool_topics import pose_message

SERVICES = {
    "cut": (Cut, "tissue/cut"),
    "grab": (Grab, "tissue/grab"),
    "let_go": (Release, "tissue/release"),
    "model": (SetModel, "tissue/set_model"),
    "pause": (SetBool, "tissue/pause"),
    "reset": (Trigger, "tissue/reset"),
    "undo": (Undo, "tissue/undo"),
    "redo": (Undo, "tissue/redo"),
    "suture": (Suture, "tissue/suture"),
    "tighten": (Suture, "tissue/suture"),
    "unsuture": (Suture, "tissue/suture"),
    "patch": (AddPatch, "tissue/add_patch"),
    "sew_rim": (Suture, "tissue/suture"),
    "closure": (Closure, "tissue/closure"),
}

SEWING = {
    "suture": Suture.Request.SEW,
    "sew_rim": Suture.Request.SEW_RIM,
    "tighten": Suture.Request.TIGHTEN,
    "unsuture": Suture.Request.REMOVE,
}
"""Actions of `tissue/suture`."""


class Requests:
    """Sends the requests of one procedure and remembers what became of them.

    Attributes:
        log: One entry per request: time, action, success, message and what else the answer says.
        failures: Requests that were refused or not answered, for people.
    """

    def __init__(
        self, node: Node, procedure: Procedure, say: Callable[[str], None], timeout: float
    ) -> None:
        """Create the clients the procedure needs.

        Args:
            node: The node they belong to.
            procedure: What is played.
            say: Told about every answer.
            timeout: Longest wait for an answer [s].
        """
        self._node = node
        self._procedure = procedure
        self._say = say
        self._timeout = timeout
        actions = {event.action for event in procedure.events} & set(SERVICES)
        self._clients: dict[str, Client] = {
            action: node.create_client(*SERVICES[action]) for action in sorted(actions)
        }
        self._session = f"script-{time.time_ns():x}"
        self._lock = threading.RLock()
        self._waiting: dict[int, tuple[Event, float]] = {}
        self._later: list[Event] = []
        self._count = 0
        self._sewn: dict[str, list[int]] = {}
        self.log: list[dict[str, Any]] = []
        self.failures: list[str] = []

    def needed(self) -> list[Client]:
        """The clients of all services the procedure calls."""
        return list(self._clients.values())

    def send(self, event: Event) -> None:
        """Send the request of an event, once what it needs has been answered."""
        with self._lock:
            if self._too_early(event):
                self._later.append(event)
                return
            self._count += 1
            number = self._count
        try:
            request = self._request(event, f"{self._session}-{number}")
        except LookupError as error:
            self._fail(event, str(error))
            return
        with self._lock:
            self._waiting[number] = (event, time.monotonic())
        future = self._clients[event.action].call_async(request)
        future.add_done_callback(lambda done: self._answered(number, done))

    def finish(self, ended: threading.Event) -> None:
        """Wait for the answers still missing; what does not come in time is a failure."""
        deadline = time.monotonic() + self._timeout
        while self._open() and time.monotonic() < deadline and not ended.wait(0.02):
            pass
        with self._lock:
            for event, _ in self._waiting.values():
                self._fail(event, "no answer")
            for event in self._later:
                self._fail(event, "what it needs was not answered")
            self._waiting.clear()
            self._later.clear()

    def _open(self) -> bool:
        """Whether answers are missing."""
        with self._lock:
            return bool(self._waiting or self._later)

    def _too_early(self, event: Event) -> bool:
        """Whether an event needs what has been asked for and not been answered."""
        before = [earlier for earlier, _ in self._waiting.values()] + self._later
        return any(event.needs(earlier) for earlier in before)

    def _close(self, number: int) -> None:
        """A request has been answered: send what waited for that."""
        with self._lock:
            self._waiting.pop(number, None)
            later, self._later = self._later, []
            for event in later:
                self.send(event)

    def _request(self, event: Event, request_id: str) -> object:
        if event.action == "cut":
            return Cut.Request(sweep=self._sweep(event), method=event.method, request_id=request_id)
        if event.action == "grab":
            return Grab.Request(tool=event.target, radius=event.value, request_id=request_id)
        if event.action == "let_go":
            return Release.Request(hold_id=0, tool=event.target, request_id=request_id)
        if event.action == "model":
            return SetModel.Request(
                model=event.target,
                parameter_names=list(event.parameters),
                parameter_values=[float(value) for value in event.parameters.values()],
                request_id=request_id,
            )
        if event.action == "pause":
            return SetBool.Request(data=bool(event.value))
        if event.action in ("undo", "redo"):
            return Undo.Request(author=self._session, request_id=request_id)
        if event.action in SEWING:
            return self._sewing(event, request_id)
        if event.patch is not None:
            return self._patching(event.patch, request_id)
        if event.hole is not None:
            return self._closure(event.target, event.hole)
        return Trigger.Request()

    def _sewing(self, event: Event, request_id: str) -> Suture.Request:
        request = Suture.Request(action=SEWING[event.action], length=float(event.value))
        request.author, request.request_id = self._session, request_id
        request.header.frame_id = self._procedure.frame_id
        if event.stitching is None:
            if event.target != ALL_SUTURES:
                with self._lock:
                    if event.target not in self._sewn:
                        raise LookupError(f"{event.target} has not been sewn")
                    request.sutures = self._sewn[event.target]
            return request
        wanted = event.stitching
        request.positions = wanted.positions.ravel().tolist()
        request.spacing, request.reach = float(wanted.spacing), float(wanted.reach)
        request.stiffness, request.running = float(wanted.stiffness), bool(wanted.running)
        request.patch_name, request.hole = wanted.patch, wanted.hole
        return request

    def _closure(self, name: str, hole: HoleItem) -> Closure.Request:
        request = Closure.Request(name=name, reach=float(hole.reach), depth=float(hole.depth))
        request.header.frame_id = self._procedure.frame_id
        request.positions = hole.loop.ravel().tolist()
        return request

    def _patching(self, wanted: PatchItem, request_id: str) -> AddPatch.Request:
        request = AddPatch.Request(
            thickness=float(wanted.thickness), young_modulus=float(wanted.young_modulus),
            density=float(wanted.density), edge_length=float(wanted.edge), name=wanted.name,
            tool=wanted.tool, author=self._session, request_id=request_id,
        )  # fmt: skip
        request.header.frame_id = self._procedure.frame_id
        request.pose = pose_message(wanted.pose)
        numbers = wanted.corners.ravel().tolist()
        if wanted.corners.shape[1] == 2:
            request.outline = numbers
        else:
            request.corners = numbers
        return request

    def _sweep(self, event: Event) -> Sweep:
        if event.sweep is None:
            raise ValueError(f"{event.where}: a cut without a sweep")
        sweep = Sweep()
        sweep.header.frame_id = self._procedure.frame_id
        sweep.header.stamp = self._node.get_clock().now().to_msg()
        sweep.vertices = event.sweep.vertices.ravel().tolist()
        sweep.triangles = event.sweep.triangles.ravel().tolist()
        return sweep

    def _answered(self, number: int, future: Future) -> None:
        with self._lock:
            waiting = self._waiting.get(number)
        if waiting is None:
            return
        event, sent = waiting
        answer = future.result()
        entry: dict[str, Any] = {
            "time": event.time,
            "action": event.action,
            "target": event.target,
            "success": bool(answer.success),
            "message": answer.message,
            "milliseconds": round(1e3 * (time.monotonic() - sent), 3),
        }
        entry |= _details(event.action, answer)
        if event.action in MAKES_SUTURES and answer.success and event.target:
            with self._lock:
                self._sewn[event.target] = [int(suture) for suture in answer.made]
        self.log.append(entry)
        if answer.success:
            self._say(f"{event} done{': ' + answer.message if answer.message else ''}")
        else:
            self._fail(event, answer.message, logged=True)
        self._close(number)

    def _fail(self, event: Event, message: str, logged: bool = False) -> None:
        if not logged:
            self.log.append(
                {"time": event.time, "action": event.action, "success": False, "message": message}
            )
        text = f"{event.where}: {event} failed: {message}"
        self.failures.append(text)
        self._node.get_logger().error(text)


def _details(action: str, answer: Any) -> dict[str, Any]:  # a generated class
    """What an answer says beyond success and message."""
    if action == "cut":
        fields = answer.report.get_fields_and_field_types()
        return {name: getattr(answer.report, name) for name in fields} | {
            "version": answer.version,
            "error_code": answer.error_code,
        }
    if action == "grab":
        return {"hold_id": answer.hold_id, "nodes": answer.nodes, "taken": answer.taken}
    if action == "patch":
        names = (
            "patch_id", "patch_name", "nodes", "elements", "area", "edge_used", "quality_min",
            "quality_mean", "overlap", "hold_id", "version", "error_code",
        )  # fmt: skip
        return {name: getattr(answer, name) for name in names}
    if action == "closure":
        measured = ("covered", "by_patches", "area", "open_area", "gap", "edge_gap", "problem")
        hole = answer.holes[0] if answer.holes else None
        return {name: getattr(hole, name) for name in measured if hole is not None} | {
            "version": answer.version,
            "error_code": answer.error_code,
        }
    if action in SEWING:
        return {
            "sutures": list(answer.made),
            "lengths": [float(length) for length in answer.lengths],
            "forces": [float(force) for force in answer.forces],
            "version": answer.version,
            "error_code": answer.error_code,
        }
    return {}
