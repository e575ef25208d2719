"""What is asked of a running simulation, and the work that must not stop the loop."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from tissue_sim.frame import Answer
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.edit_check import CheckedEdit

Done = Callable[[Answer], None]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Request:
    """Something asked of the simulation.

    Attributes:
        kind: grab, release, set_tool, remove_tool, pause, set_model, save, load, reset, undo, redo
            or edit.
        arguments: What it needs.
        request_id: Set by the client.
        done: Called with the answer, in the loop thread or a worker thread.
    """

    kind: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    request_id: str = ""
    done: Done = lambda _answer: None


@dataclass(frozen=True)
class PlannedEdit:
    """The arguments of an `edit` request.

    Attributes:
        edit: The edit.
        epoch: The epoch it was planned in.
        checked: What was found out about it when it came, if it can be applied.
    """

    edit: TopologyEdit
    epoch: bytes
    checked: CheckedEdit | None = None


class Job:
    """Work beside the loop; its result is looked for between frames.

    Attributes:
        request: Who asked for it.
        result: What came of it.
        error: Why it failed; empty: it did not.
    """

    def __init__(self, request: Request, work: Callable[[], Any]) -> None:
        self.request = request
        self.result: Any = None
        self.error = ""
        self._thread = threading.Thread(target=self._run, args=(work,), name=request.kind)
        self._thread.daemon = True
        self._thread.start()

    @property
    def over(self) -> bool:
        """Whether it is done, well or not."""
        return not self._thread.is_alive()

    def _run(self, work: Callable[[], Any]) -> None:
        try:
            self.result = work()
        except ValueError as error:
            self.error = str(error)
        except Exception as error:
            # Whatever happens beside the loop must reach whoever asked, not end the loop.
            log.exception("%s failed", self.request.kind)
            self.error = f"{type(error).__name__}: {error}"


def refuse(request: Request, error: str, message: str) -> None:
    """Answer a request that is not carried out.

    Args:
        request: The request.
        error: Name of the error in the service's constants.
        message: What is wrong and what is allowed.
    """
    request.done(Answer(request.request_id, False, message, error))
