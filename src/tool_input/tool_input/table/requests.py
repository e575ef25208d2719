"""What people ask of the simulation's services, in their names."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger
from tissue_interfaces import srv

if TYPE_CHECKING:
    from tool_input.table.person import Person

SERVICES: dict[str, tuple[type, str]] = {
    "add_patch": (srv.AddPatch, "tissue/add_patch"),
    "closure": (srv.Closure, "tissue/closure"),
    "cut": (srv.Cut, "tissue/cut"),
    "grab": (srv.Grab, "tissue/grab"),
    "load": (srv.Load, "tissue/load"),
    "pause": (SetBool, "tissue/pause"),
    "redo": (srv.Undo, "tissue/redo"),
    "release": (srv.Release, "tissue/release"),
    "remove_tool": (srv.RemoveTool, "tissue/remove_tool"),
    "reset": (Trigger, "tissue/reset"),
    "reset_readings": (Trigger, "tissue/reset_readings"),
    "save": (srv.Save, "tissue/save"),
    "set_model": (srv.SetModel, "tissue/set_model"),
    "set_playback": (srv.SetPlayback, "tissue/set_playback"),
    "set_readings": (SetParameters, "readings/set_parameters"),
    "set_risk_region": (srv.SetRiskRegion, "tissue/set_risk_region"),
    "set_tool": (srv.SetTool, "tissue/set_tool"),
    "suture": (srv.Suture, "tissue/suture"),
    "undo": (srv.Undo, "tissue/undo"),
}
"""Everything a person can ask for: service type and name."""

OBSERVERS_MAY = frozenset({"set_readings"})
"""What those may ask for who only watch: it changes nothing but what everybody sees."""


SERVICE_PATIENCE = 5.0
"""[s] How long a request waits for its service, as discovery takes a moment, and for the answer to
the one before it about the same tool."""

SLOW_SECONDS = 3.0
"""Of an answer that has not come after so long the person is told that it is waited for [s]."""


class _Asked(NamedTuple):
    """A request on its way to its service, or on its way back.

    `until` is when patience ends [s]: with the service that is not there, or with its answer.
    """

    until: float
    person: Person
    service: str
    request: Any
    answered: Callable[[Any], None] | None

    @property
    def tool(self) -> str:
        """The tool it is about; empty: none."""
        tool = getattr(self.request, "tool", "")
        return str(getattr(tool, "id", tool))


class Requests:
    """Everybody's requests on their way: each waits for its own service, but not for ever.

    Those about one tool go one after the other, each when the one before is answered: services are
    independent, and making a tool could be overtaken by removing the one of that name before it.
    """

    def __init__(self, node: Node, soon: Callable[[Callable[[], None]], None]) -> None:
        """Begin without requests.

        Args:
            node: The node that asks.
            soon: Calls something in the node's thread.
        """
        self._node = node
        self._soon = soon
        self._clients: dict[str, Client] = {}
        self._numbers = itertools.count(1)
        self._waiting: list[_Asked] = []
        self._under_way: dict[str, float] = {}
        self._unanswered: dict[Any, _Asked] = {}

    def ask(
        self,
        person: Person,
        service: str,
        request: Any,
        answered: Callable[[Any], None] | None = None,
    ) -> None:
        """Ask for something; see `Desk.request`."""
        if person.observer and service not in OBSERVERS_MAY:
            person.tell(f"Observers cannot ask for {service}: they only watch.")
            return
        if hasattr(request, "author"):
            request.author = person.name
        if hasattr(request, "request_id"):
            request.request_id = self.new_id(person)
        until = time.monotonic() + SERVICE_PATIENCE
        asked = _Asked(until, person, service, request, answered)
        if service == "set_tool":
            self._drop_outdated(asked.tool)
        self._waiting.append(asked)
        self.send()

    def new_id(self, person: Person) -> str:
        """A request id that no other request has."""
        return f"{person.name}-{time.time_ns():x}-{next(self._numbers)}"

    def send(self) -> None:
        """Send what waits for a service that is there; tell of what has waited for too long."""
        self._tell_of_slow()
        asked, self._waiting = self._waiting, []
        now = time.monotonic()
        # A service that died answers nothing: its tools do not wait for ever.
        self._under_way = {tool: end for tool, end in self._under_way.items() if end > now}
        held_up: set[str] = set()
        for one in asked:
            client = self._client(one.service)
            if one.tool in self._under_way or one.tool in held_up:
                self._waiting.append(one)
            elif client.service_is_ready():
                if one.tool:
                    self._under_way[one.tool] = now + SERVICE_PATIENCE
                answer = client.call_async(one.request)
                self._unanswered[answer] = one._replace(until=now + SLOW_SECONDS)
                answer.add_done_callback(self._finishing(one))
            elif now > one.until:
                one.person.tell(f"{SERVICES[one.service][1]} is not there: is its node running?")
            else:
                self._waiting.append(one)
                held_up.update({one.tool} - {""})

    def _drop_outdated(self, tool: str) -> None:
        """Of what a tool shall be only the newest counts, as while its size is dragged."""
        last = next((one for one in reversed(self._waiting) if one.tool == tool), None)
        if last is not None and last.service == "set_tool":
            self._waiting.remove(last)

    def _tell_of_slow(self) -> None:
        now = time.monotonic()
        for answer, one in list(self._unanswered.items()):
            if now > one.until:
                del self._unanswered[answer]
                one.person.tell(f"{one.service}: no answer yet; it is still waited for.")

    def _finishing(self, asked: _Asked) -> Callable[[Any], None]:
        def finish(done: Any) -> None:
            self._unanswered.pop(done, None)
            self._answer(asked, done.result())

        return lambda done: self._soon(lambda: finish(done))

    def _client(self, service: str) -> Client:
        if service not in self._clients:
            kind, name = SERVICES[service]
            self._clients[service] = self._node.create_client(kind, name)
        return self._clients[service]

    def _answer(self, asked: _Asked, answer: Any) -> None:
        self._under_way.pop(asked.tool, None)
        self.send()
        if asked.service == "set_readings":
            refusals = [result.reason for result in answer.results if not result.successful]
            success, message = not refusals, "; ".join(refusals)
        else:
            success, message = answer.success, answer.message
        if not success:
            asked.person.tell(f"{asked.service}: {message}")
        elif asked.answered is not None:
            asked.person.attempt(asked.answered, answer)
