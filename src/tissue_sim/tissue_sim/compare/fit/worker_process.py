"""A process that evaluates the candidates of one problem; `ProcessPool` starts it.

It asks for the problem, says when it has it, and from then on answers each candidate with its
evaluation, or with the exception that came instead. It ends when the other end is closed.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
import traceback
from multiprocessing.connection import Connection
from typing import Any

from tissue_sim.compare.fit.problem import Evaluation, Problem

WHICH_PROBLEM = "which problem?"
READY = "ready"


def serve(connection: Connection) -> None:
    """Evaluate what comes in until the other end is closed."""
    connection.send(WHICH_PROBLEM)
    problem: Problem = connection.recv()
    connection.send(READY)
    while True:
        connection.send(_answer(problem, connection.recv()))


def _answer(problem: Problem, candidate: Any) -> Evaluation | Exception:
    try:
        return problem.evaluate(candidate)
    except Exception as error:
        error.add_note(f"In a worker process:\n{traceback.format_exc()}")
        return error


def _end_with_the_other_end(descriptor: int) -> None:
    """End this process, whatever it is at, once the other end is closed."""
    poll = select.poll()
    poll.register(descriptor, 0)  # hang-ups are told unasked
    poll.poll()
    os._exit(1)


def main() -> None:
    """Serve the connection whose descriptor is the argument."""
    descriptor = int(sys.argv[1])
    threading.Thread(target=_end_with_the_other_end, args=(descriptor,), daemon=True).start()
    with contextlib.suppress(EOFError, ConnectionError):
        serve(Connection(descriptor))


if __name__ == "__main__":
    main()
