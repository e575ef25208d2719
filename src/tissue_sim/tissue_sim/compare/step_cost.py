"""What a step of a model costs on an organ, and how many of them a budget buys.

A time budget makes other steps in every run; a number of steps makes the same. So the time of a
step is measured once, and a budget becomes steps a frame.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, replace

from tissue_sim.bench import measure_triad
from tissue_sim.compare.effort import Effort
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import Player
from tissue_sim.elastic.spring_mass import FRAME

MOST_A_FRAME = 50
"""Most steps of a frame while they are measured."""

FEWEST = 5
"""Fewer steps than these that begin with work to do are no sample; all of them are, then."""

NONE = Effort(steps=0.0)
"""Holds what is held in a frame, and leaves the steps to who measures them."""


@dataclass(frozen=True)
class StepCost:
    """What a step costs.

    Attributes:
        ms: Median processor time of a step that begins with work to do, while the hold moves [ms];
            steps compute on one thread.
        steps: Number of steps that this is the median of.
        time_step: Simulated time of a step [s]; None: the model has no time.
        bandwidth: Of the memory, one thread, right before: a yardstick of the machine [GB/s].
    """

    ms: float
    steps: int
    time_step: float | None
    bandwidth: float


@dataclass(frozen=True)
class Share:
    """What a model may do in a frame for a budget.

    Attributes:
        subject: The model with its effort and, if it has time, its time step.
        steps: Steps a frame.
        real_time: Whether simulated time keeps up with the interaction; models without time do.
    """

    subject: Subject
    steps: float
    real_time: bool


def step_cost(
    subject: Subject, organ: Organ, interaction: Interaction, seconds: float = 1.0
) -> StepCost:
    """Measure a step while an interaction goes on.

    Steps that a model begins idle are left out: finite elements that know a motion already would
    be told from frames that cost nothing, not from those that decide.

    Args:
        subject: The model; its effort is not used.
        organ: The organ.
        interaction: What is held; it moves in all frames that count.
        seconds: About how long to measure [s]; every frame is stepped once at least.
    """
    bandwidth = 1e-9 * measure_triad()
    model = subject.build(organ)
    player = Player(model, organ, interaction)
    player.play(0, Effort(steps=2.0))
    working, every = [], []
    for frame in range(1, interaction.frames):
        player.play(frame, NONE)
        left = seconds / interaction.frames
        for _ in range(MOST_A_FRAME):
            idle, begun = model.idle, time.thread_time()
            model.step(player.state)
            spent = time.thread_time() - begun
            every.append(spent)
            if not idle:
                working.append(spent)
            left -= spent
            if left <= 0.0:
                break
    sample = working if len(working) >= FEWEST else every
    milliseconds = 1e3 * statistics.median(sample)
    return StepCost(milliseconds, len(sample), model.time_step, bandwidth)


def bought(subject: Subject, cost: StepCost, budget_ms: float, rate_hz: float) -> Share:
    """What a budget a frame buys of a model.

    Whole steps where there is one at least, otherwise a fraction of a step, which is carried over
    from frame to frame. A model in time makes as many steps as keep up with the frames; where the
    budget has fewer they are longer: springs with masses get heavier nodes (`mass_scaling`), and
    vertex block descent makes one step a frame of as many sweeps as the budget has. Where even
    the longest steps cost too much, simulated time falls behind.

    Args:
        subject: The model; its effort is replaced.
        cost: What a step of it costs, with the shortest time step or a single sweep.
        budget_ms: Time a frame [ms].
        rate_hz: Frames a second [1/s].
    """
    affordable = budget_ms / cost.ms
    steps = float(int(affordable)) if affordable >= 1.0 else float(f"{affordable:.3g}")
    if cost.time_step is None:
        return _share(subject, steps, True)
    if subject.model == "spring_mass":
        return _springs_in_time(subject, cost.time_step, steps, rate_hz)
    sweeps = {"time_step": 1.0 / rate_hz, "iterations": max(steps, 1.0)}
    return _share(subject.with_values(sweeps), min(steps, 1.0), steps >= 1.0)


def _springs_in_time(subject: Subject, shortest: float, steps: float, rate_hz: float) -> Share:
    wanted = 1.0 / (rate_hz * shortest)
    if steps >= wanted:
        return _share(subject, wanted, True)
    longest = min(1.0 / (rate_hz * max(steps, 1.0)), FRAME)
    heavier = subject.with_values({"time_step": longest, "mass_scaling": 1.0})
    return _share(heavier, steps, steps * longest * rate_hz > 1.0 - 1e-9)


def _share(subject: Subject, steps: float, real_time: bool) -> Share:
    return Share(replace(subject, effort=Effort(steps=steps)), steps, real_time)
