"""How much processor time the processes of a session take."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path

import psutil


class CpuShares:
    """Watches this process and those started by the same launcher.

    Attributes:
        seconds: How long has been watched [s].
    """

    def __init__(self) -> None:
        self._own = psutil.Process()
        self._first: dict[int, tuple[float, float]] = {}
        self._last: dict[int, tuple[float, float]] = {}
        self._names: dict[int, str] = {}
        self.sample()

    def sample(self) -> None:
        """Look at all processes again; those that have ended keep their last figures."""
        now = time.monotonic()
        for process in self._session():
            try:
                if process.pid not in self._names:
                    name = process_name(process.cmdline())
                    if not name:
                        continue
                    self._names[process.pid] = name
                times = process.cpu_times()
            except (psutil.Error, OSError):
                continue
            self._last[process.pid] = (now, times.user + times.system)
            self._first.setdefault(process.pid, self._last[process.pid])

    def shares(self) -> dict[str, float]:
        """Share of one core by process name; processes of one name are added."""
        shares: dict[str, float] = {}
        for pid, name in self._names.items():
            if pid not in self._first:
                continue
            (start, used), (end, total) = self._first[pid], self._last[pid]
            share = (total - used) / (end - start) if end > start else 0.0
            shares[name] = round(shares.get(name, 0.0) + share, 4)
        return dict(sorted(shares.items(), key=lambda item: -item[1]))

    def _session(self) -> Iterable[psutil.Process]:
        try:
            parent = self._own.parent()
            return parent.children(recursive=True) if parent is not None else [self._own]
        except psutil.Error:
            return [self._own]


def process_name(command: list[str]) -> str:
    """What a process is called: its module, or its program; empty for shells and the like."""
    if not command:
        return ""
    program = Path(command[0]).name
    if program.startswith("python"):
        if "-m" in command[1:-1]:
            return command[command.index("-m") + 1].rsplit(".", 1)[-1]
        script = next((part for part in command[1:] if not part.startswith("-")), "")
        return Path(script).stem if script and "-c" not in command else ""
    return "" if program in ("sh", "bash", "dash", "timeout", "make") else program
