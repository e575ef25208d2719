"""After the rehearsal no frame compiles a kernel or waits for one from the cache."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.frames_after_rehearsal import PROGRAM, scenes
from tissue_sim.elastic import registry


@pytest.fixture(scope="module")
def called_first_in_frames(repository: Path) -> dict[str, list[str]]:
    """Kernels that frames called first, by scene: in a process that has called none before."""
    path = os.pathsep.join([str(repository / "test"), *filter(None, sys.path)])
    run = subprocess.run(
        [sys.executable, "-m", PROGRAM],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=280,
    )
    found: dict[str, list[str]] = json.loads(run.stdout)
    return found


def test_every_model_is_looked_at(called_first_in_frames: dict[str, list[str]]) -> None:
    assert set(called_first_in_frames) == set(scenes())
    assert {scene.model for scene in scenes().values()} == set(registry.names())


@pytest.mark.parametrize("label", scenes())
def test_frames_after_the_rehearsal_call_no_kernel_first(
    called_first_in_frames: dict[str, list[str]], label: str
) -> None:
    assert called_first_in_frames[label] == []
