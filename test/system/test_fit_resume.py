"""A fit whose process is killed goes on where it was, and finds what it would have found."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from support.simulation_process import eventually

COMMAND = "import sys; sys.argv[0] = 'tissue'; from tissue_sim.cli import main; main()"
GENERATIONS = 10
FIT = (
    "fit", "block", "--interaction", "oblique", "--reference", "quasi_static:levels=1000@3",
    "--target", "quasi_static:levels=1000@2", "--range", "step=0.1..1.99",
    "--range", "momentum=0..0.9", "--population", "8", "--generations", str(GENERATIONS),
    "--strategy", "ea",
    "--processes", "1", "--rate", "15",
)  # fmt: skip
LIMIT = 200.0
"""Longest wait for a process [s]; only a failing test waits so long."""


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Begin a fit."""
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, *FIT, *arguments],
        cwd=folder,
        env={**os.environ, "XDG_CACHE_HOME": str(folder / "cache")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def finish(process: subprocess.Popen[str]) -> str:
    """Wait until a fit is done; what it said."""
    output, _ = process.communicate(timeout=LIMIT)
    assert process.returncode == 0, output
    return output


def kill(process: subprocess.Popen[str], checkpoint: Path) -> None:
    """Kill a fit once a generation is done, before all are."""
    eventually(lambda: checkpoint.exists() or process.poll() is not None, LIMIT)
    process.kill()
    output, _ = process.communicate(timeout=LIMIT)
    assert process.returncode == -signal.SIGKILL, output
    assert 0 < len(json.loads(checkpoint.read_text())["history"]) < GENERATIONS


def found(folder: Path) -> dict[str, Any]:
    """What a fit found, without how long it took."""
    result = json.loads((folder / "result.json").read_text())
    return {key: value for key, value in result.items() if key not in ("made", "seconds")}


def test_a_fit_that_is_killed_finds_the_same_when_it_is_resumed(tmp_path: Path) -> None:
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    uninterrupted = start(tmp_path, "--out", str(whole))
    kill(start(tmp_path, "--out", str(killed)), killed / "checkpoint.json")
    assert not (killed / "result.json").exists()
    finish(start(tmp_path, "--out", str(killed), "--resume"))
    finish(uninterrupted)
    assert found(killed) == found(whole)
    assert len(found(whole)["generations"]) == GENERATIONS
    assert (killed / "report.html").exists()
