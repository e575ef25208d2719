"""Nodes as processes of their own, for tests that kill and restart them."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from support.simulation_process import eventually

END_SECONDS = 30.0
PLAY_SECONDS = 200.0
"""Longest wait for a procedure's end [s]; only a failing test waits so long."""

_BLOCK = Path(__file__).resolve().parents[2] / "config" / "block.yaml"


class Processes:
    """Processes by name; each writes into a log named after it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    @property
    def folder(self) -> Path:
        """The processes' working directory."""
        return self._folder

    def start(self, name: str, module: str, *arguments: str) -> None:
        """Start a module as a program; a restarted one goes on writing the same log."""
        with self._log_file(name).open("ab") as log:
            self._running[name] = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=self._folder,
            )

    def runs(self, name: str) -> bool:
        """Whether a process has not ended by itself."""
        return self._running[name].poll() is None

    def send(self, name: str, number: signal.Signals) -> None:
        """Send a signal to a process that goes on running."""
        self._running[name].send_signal(number)

    def end(self, name: str, number: signal.Signals) -> int:
        """Send a signal that ends a process; gives the exit code."""
        process = self._running.pop(name)
        process.send_signal(number)
        return process.wait(timeout=END_SECONDS)

    def log(self, name: str) -> str:
        """What a process has written so far."""
        path = self._log_file(name)
        return path.read_text(errors="replace") if path.exists() else ""

    def close(self) -> None:
        """Kill what is left and show what everybody wrote."""
        for process in self._running.values():
            process.kill()
        for name, process in self._running.items():
            process.wait()
            print(f"--- {name}\n{self.log(name)}")

    def _log_file(self, name: str) -> Path:
        return self._folder / f"{name.replace('/', '_')}.log"


@contextmanager
def processes(folder: Path) -> Iterator[Processes]:
    """Processes that end with the block."""
    made = Processes(folder)
    try:
        yield made
    finally:
        made.close()


def play_on_block(world: Processes, procedure: str, nodes: int) -> dict[str, Any]:
    """Play a procedure's text with a simulation, a cut service and a script; the script's report.

    All three go on running. The organ is the block of `config/block.yaml`, with so many nodes
    along each edge.
    """
    (world.folder / "procedure.yaml").write_text(procedure)
    report = world.folder / "report.json"
    world.start(
        "simulation", "tissue_sim.simulation_node", "--ros-args", "--params-file", str(_BLOCK),
        *(word for axis in "xyz" for word in ("-p", f"shape.nodes_{axis}:={nodes}")),
        "-p", "steps_per_frame:=2", "-p", "wait_for:=['tissue/journal:2','tissue/edits:1']",
        "-p", f"wait_timeout:={PLAY_SECONDS}",
    )  # fmt: skip
    world.start("cut", "cut_service.cut_node")
    world.start(
        "script", "tool_input.script_node", "--ros-args", "-p", "procedure:=procedure.yaml",
        "-p", "clock:=simulation", "-p", f"report:={report.name}",
    )  # fmt: skip
    eventually(report.exists, PLAY_SECONDS)
    played: dict[str, Any] = json.loads(report.read_text())
    assert played["exit_code"] == 0, played
    return played
