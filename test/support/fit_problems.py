"""Problems of fits: a small one, and one in whose evaluations happens what a test asks for."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from support.small_block import block_mesh
from tissue_sim.compare.effort import Effort
from tissue_sim.compare.fit.problem import Evaluation, Problem, case_of
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.interaction import held_along
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import simulate

CLOUD = np.random.default_rng(5).random((24, 2))
"""Candidates of two values."""

BAD = float(np.sort(CLOUD[:, 0])[-2])
"""The first numbers of two of them are at least this."""


def block_problem(nodes: int = 4, frames: int = 8) -> Problem:
    """Quasi-static tissue with two free values, to agree with itself, on a block that is pulled."""
    mesh = block_mesh(nodes)
    organ = Organ("block", mesh)
    top = np.flatnonzero(organ.rest[:, 1] > organ.rest[:, 1].max() - 1e-9)
    pull = np.linspace(0.0, 0.01, frames)[:, None] * np.array([0.6, 0.8, 0.0])
    interaction = held_along(organ, "pull", 30.0, top, pull)
    subject = Subject("quasi_static", effort=Effort(steps=2.0))
    reference = simulate(subject, organ, interaction)
    space = Space.parse("step=0.2..1.5", "material.young_modulus=1000..20000:log")
    return Problem(organ, subject, space, (case_of(organ, interaction, reference),))


@dataclass(frozen=True)
class Watched:
    """A problem in whose evaluations something happens first.

    Attributes:
        happens: Called with the first number of each candidate, in the process that evaluates it.
        problem: What is evaluated then.
    """

    happens: Callable[[float], None]
    problem: Problem = field(default_factory=block_problem)

    @property
    def space(self) -> Space:
        """That of the problem."""
        return self.problem.space

    def evaluate(self, unit: NDArray[np.float64]) -> Evaluation:
        """Let it happen, and evaluate."""
        self.happens(float(unit[0]))
        return self.problem.evaluate(unit)


@dataclass(frozen=True)
class DiesOf:
    """Kills the process that evaluates candidates whose value is at least `bad`.

    Attributes:
        bad: From which value on.
        times: So often a candidate kills; notes are kept in `folder`.
        folder: Where deaths are counted.
    """

    bad: float
    times: int
    folder: Path

    def __call__(self, value: float) -> None:
        """Kill, if it is time."""
        if value < self.bad:
            return
        for number in range(self.times):
            note = self.folder / f"{value!r} {number}"
            if not note.exists():
                note.touch()
                os.kill(os.getpid(), signal.SIGKILL)


@dataclass(frozen=True)
class Sleeps:
    """Takes its time, and says in `folder` who is at what.

    Attributes:
        seconds: How long [s].
        folder: A file named after the process for each evaluation that is begun.
    """

    seconds: float
    folder: Path

    def __call__(self, value: float) -> None:
        """Sleep."""
        (self.folder / f"{os.getpid()} {value!r}").touch()
        time.sleep(self.seconds)


def begun(folder: Path) -> list[int]:
    """Process of each evaluation that `Sleeps` has begun."""
    return [int(path.name.split()[0]) for path in folder.iterdir()]


def refuses(value: float) -> None:
    """Raise."""
    raise ZeroDivisionError(f"no {value:.2f}")
