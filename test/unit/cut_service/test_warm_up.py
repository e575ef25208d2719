"""What `make setup` and the start of the cut service compile is all that a cut needs."""

from __future__ import annotations

import subprocess
import sys

import pytest

CUTS = """
import gc

import numpy as np
from numba.core.dispatcher import Dispatcher

from cut_service.planner import METHODS, plan
from cut_service.sweep import Sweep
from cut_service.warm_up import warm_up
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import wall


def compiled():
    found = (one for one in gc.get_objects() if isinstance(one, Dispatcher))
    return {(k.py_func.__module__, k.py_func.__name__, str(s)) for k in found for s in k.signatures}


warm_up()
before = compiled()
removed = 0
for method in METHODS:
    for slope in (0.0, 0.13, 0.4):
        mesh = Mesh(wall())
        rest = mesh.rest[: mesh.node_rows]
        low, high = rest.min(axis=0), rest.max(axis=0)
        at = lambda x, y, z: low + np.array([x, y, z]) * (high - low)
        sweep = Sweep.between(
            np.array([at(0.4, -1, -1), at(0.4 + slope, 2, -1)]),
            np.array([at(0.4 - slope, -1, 2), at(0.4, 2, 2)]),
        )
        planned = plan(mesh, rest, sweep, method)
        removed += planned.report.degenerate[0]
        mesh.apply(planned.edit)
print("removed", removed)
for kernel in sorted(compiled() - before):
    print("compiled", *kernel)
"""


@pytest.fixture(scope="module")
def said() -> list[str]:
    """What a process of its own says: here other tests have compiled everything."""
    run = subprocess.run(
        [sys.executable, "-P", "-c", CUTS], capture_output=True, text=True, timeout=280, check=False
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


def test_nothing_is_compiled_at_a_cut(said: list[str]) -> None:
    assert [line for line in said if line.startswith("compiled")] == []


def test_the_cuts_had_degeneracies_to_remove(said: list[str]) -> None:
    assert int(said[0].split()[1]) > 10
