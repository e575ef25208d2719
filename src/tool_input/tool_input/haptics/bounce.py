"""A mass thrown at a stiff wall that is known sixty times a second only: does it gain energy?

A mass free of friction meets a spring and a damper at height 0. What it feels comes from frames
that sample its height and whose word arrives some time later, and is rendered at the loop's rate.
A passive rendering lets it leave no faster than it came.

References:
    Colgate, J. E. and Schenkel, G. G. (1997): Passivity of a class of sampled-data systems.
    J. Robotic Systems 14(1), 37-47 (a sampled wall is passive if the device's own damping is more
    than stiffness times sampling time over two, plus the wall's damping: this mass has none).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.interaction.contact_model import ContactModel
from tool_input.haptics.contact_loop import ContactLoop, LoopLimits

HELD, MODELS, PASSIVE = "force held", "models", "models and controller"
RENDERINGS = (HELD, MODELS, PASSIVE)
"""The frame's force until the next one; contact models; these with the passivity controller."""

MASS = 0.1
"""[kg]"""
SPEED = 0.05
"""At which it comes [m/s]."""
START = 0.0021
"""Height it comes from [m]."""
FRAME_HZ = 60.0
LONGEST = 2.0
"""After so long a bounce is given up [s]."""


@dataclass(frozen=True)
class Wall:
    """What the mass meets.

    Attributes:
        stiffness: [N/m].
        damping: [N s/m].
        delay: From the sample of a frame to the arrival of its word [s].
        loop_hz: Rate of the rendering.
    """

    stiffness: float
    damping: float = 0.0
    delay: float = 0.006
    loop_hz: float = 1000.0


def restitution(wall: Wall, rendering: str) -> float:
    """Speed after the bounce over speed before; 0 if it does not leave.

    Args:
        wall: What it meets.
        rendering: One of `RENDERINGS`.
    """
    period = 1.0 / wall.loop_hz
    loop = ContactLoop(LoopLimits(max_damping=1e3, passive=rendering == PASSIVE), period)
    loop.pushes_only = True
    pose = np.array([0.0, 0.0, START, 0.0, 0.0, 0.0, 1.0])
    speed, held, frames = -SPEED, 0.0, 0
    under_way: list[tuple[float, ContactModel]] = []
    for tick in range(int(LONGEST * wall.loop_hz)):
        now = tick * period
        if now >= frames / FRAME_HZ:
            under_way.append((now, _model(wall, pose)))
            frames += 1
        while under_way and under_way[0][0] + wall.delay <= now:
            found_at, model = under_way.pop(0)
            loop.receive(model, found_at)
            held = max(model.wrench[2] - model.damping[2, 2] * speed, 0.0)
        felt = held if rendering == HELD else loop.step(now, pose, pose)[2]
        speed += felt / MASS * period
        pose = pose.copy()
        pose[2] += speed * period
        if pose[2] > START:
            break
    return max(float(speed), 0.0) / SPEED


def _model(wall: Wall, pose: NDArray[np.float64]) -> ContactModel:
    """What a frame knows of the wall."""
    touches = pose[2] < 0.0
    along = np.diag([0.0, 0.0, float(touches), 0.0, 0.0, 0.0])
    push = wall.stiffness * max(-pose[2], 0.0)
    return ContactModel(
        pose, push * np.eye(6)[2], wall.stiffness * along, wall.damping * along, 0.1, 0.05, touches
    )
