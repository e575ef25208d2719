"""Ends the processes of a launcher that died without doing so itself.

The launcher holds the other end of this process's standard input and writes the id of each process
group it starts, one a line. When the launcher is gone, however it went, the input ends and the
groups named are ended. Standard library only, so that it is small and starts at once.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time

GRACE_SECONDS = 4.0
"""How long a group may take to end by itself before it is killed."""


def alive(group: int) -> bool:
    """Whether a process group has a process left that is more than a zombie nobody reaps."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return any(_runs_in(entry, group) for entry in os.listdir("/proc") if entry.isdecimal())


def _runs_in(process: str, group: int) -> bool:
    try:
        with open(f"/proc/{process}/stat", encoding="utf-8", errors="replace") as stat:
            state, _, process_group = stat.read().rpartition(")")[2].split()[:3]
    except OSError:
        return False
    return int(process_group) == group and state not in "ZX"


def signal_group(group: int, number: int) -> None:
    """Send a signal to every process of a group, if there is one."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)


def end_groups(groups: list[int]) -> None:
    """End process groups: politely, then by force."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        for group in groups:
            signal_group(group, number)
        deadline = time.monotonic() + GRACE_SECONDS / 2
        while any(alive(group) for group in groups) and time.monotonic() < deadline:
            time.sleep(0.05)


def main() -> None:
    """Read process groups until the launcher is gone, then end those that are left."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    groups: list[int] = []
    for line in sys.stdin:
        word, _, number_text = line.strip().partition(" ")
        group = int(number_text)
        if word == "started":
            groups.append(group)
        elif group in groups:
            groups.remove(group)
    end_groups(groups)


if __name__ == "__main__":
    main()
