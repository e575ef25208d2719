"""What a step of a model costs on an organ, and how many of them a budget buys.

A time budget makes other steps in every run; a number of steps makes the same. So the time of a
step is measured once, and a budget becomes steps a frame.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from tissue_sim.compare.effort import Effort
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import Player
from tissue_sim.elastic import registry
from tissue_sim.elastic.spring_mass import FRAME

KEPT = 0.9
"""Share of the frames in which a budget is to be kept."""

NONE = Effort(steps=0.0)
"""Holds what is held in a frame, and leaves the steps to who measures them."""


@dataclass(frozen=True)
class StepCost:
    """What a step costs.

    Attributes:
        ms: Processor time of a step, in `KEPT` of the frames no more [ms].
        steps: Number of steps that were measured.
        time_step: Simulated time of a step [s]; None: the model has no time.
    """

    ms: float
    steps: int
    time_step: float | None


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
    subject: Subject, organ: Organ, interaction: Interaction, budget_ms: float
) -> StepCost:
    """Measure steps through an interaction in which each frame has a budget.

    A step costs what there is to do: less while little has moved yet and where a motion is known
    already, most when all moves. So each frame is measured by itself, after as many steps before
    as the budget allowed, and the dearer ones decide. Steps compute on one thread, whose processor
    time does not depend on what else the machine does.

    Args:
        subject: The model; its effort is not used.
        organ: The organ.
        interaction: What is held.
        budget_ms: Processor time a frame [ms]; at least one step is made.
    """
    model = subject.build(organ)
    player = Player(model, organ, interaction)
    player.play(0, Effort(steps=2.0))
    total, of_frames = 0, []
    for frame in range(1, interaction.frames):
        player.play(frame, NONE)
        steps, spent, begun = 0, 0.0, time.thread_time()
        while steps == 0 or (1e3 * spent < budget_ms and not model.idle):
            model.step(player.state)
            steps += 1
            spent = time.thread_time() - begun
        total += steps
        of_frames.append(1e3 * spent / steps)
    return StepCost(float(np.quantile(of_frames, KEPT)), total, model.time_step)


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
    most = next(
        parameter.maximum
        for parameter in registry.parameters_of(subject.model)
        if parameter.name == "iterations"
    )
    sweeps = {"time_step": 1.0 / rate_hz, "iterations": min(max(steps, 1.0), most)}
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
