"""A fast force loop beside slow frames of tissue: no energy gained, no jumps, no force too many."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from support.haptic_wall import LOOP_HZ, Felt, press
from tissue_sim.interaction import rigid
from tissue_sim.interaction.contact_model import ContactModel
from tissue_sim.interaction.reaction import ForceLimits
from tool_input.haptics.bounce import HELD, MODELS, PASSIVE, Wall, restitution
from tool_input.haptics.contact_loop import (
    NO_MODEL,
    OLD_MODEL,
    VELOCITY_SECONDS,
    ContactLoop,
    LoopLimits,
    pushing,
)
from tool_input.haptics.passivity import PassivityController

Reals = NDArray[np.float64]
PERIOD = 1.0 / LOOP_HZ
CYCLES_HZ, CYCLES, DEPTH = 1.5, 3, 0.003
LIMITS = LoopLimits()
EPSILON = (
    LIMITS.force.max_force
    * DEPTH * (2 * np.pi * CYCLES_HZ) ** 2
    * (VELOCITY_SECONDS + PERIOD) * PERIOD
)  # fmt: skip
"""Energy of a tick whose motion differs by the hand's largest acceleration from that predicted."""

JITTER = np.random.default_rng(7).uniform(0.004, 0.045, 400)
DELAYS: dict[str, Callable[[int], float]] = {
    "prompt": lambda _: 0.006,
    "late": lambda _: 0.03,
    "jittering": lambda frame: float(JITTER[frame]),
}


def depth_at(now: float) -> float:
    """Out of the tissue for a third of each cycle."""
    return DEPTH * (0.7 - np.cos(2 * np.pi * CYCLES_HZ * now))


def felt_by_loop(limits: LoopLimits, delay: str) -> tuple[Felt, ContactLoop]:
    loop = ContactLoop(limits, PERIOD)
    loop.pushes_only = True
    felt = press(
        CYCLES / CYCLES_HZ, depth_at, loop.receive, lambda now, pose: loop.step(now, pose, pose),
        DELAYS[delay],
    )  # fmt: skip
    return felt, loop


def gained_by_cycle(felt: Felt) -> Reals:
    """Energy the hand has got out of each cycle of pressing and letting go [J]."""
    ends = np.minimum(
        (np.arange(CYCLES + 1) * LOOP_HZ / CYCLES_HZ).astype(int), len(felt.energy) - 1
    )
    return -np.diff(np.array(felt.energy)[ends])


# A virtual wall of tissue, pressed and let go


@pytest.mark.parametrize("delay", DELAYS)
def test_pressing_and_letting_go_gains_no_energy(delay: str) -> None:
    felt, loop = felt_by_loop(LIMITS, delay)
    forces = np.array(felt.forces)
    assert min(felt.energy) >= -EPSILON
    assert loop.passivity.lowest >= -EPSILON
    assert gained_by_cycle(felt).max() <= EPSILON
    # And it was a wall that was felt, softly ended in the air.
    assert 1.8 < forces[:, 2].max() < 3.0
    assert forces[:, 2].min() > -0.05
    high = np.array(felt.heights) > max(felt.heights) - 1e-4
    assert np.abs(forces[high]).max() < 0.05


def test_a_plain_hold_of_the_frames_force_gains_energy() -> None:
    """The control: the same hand, frames and delay, without models and controller."""
    newest = [np.zeros(6)]

    def receive(model: ContactModel, _: float) -> None:
        newest[0] = model.wrench

    felt = press(
        CYCLES / CYCLES_HZ, depth_at, receive, lambda _now, _pose: newest[0], DELAYS["late"]
    )
    assert gained_by_cycle(felt).min() > 50 * EPSILON


def test_without_its_controller_the_loop_gains_energy_from_late_models() -> None:
    """The control of the controller: contact that is known late pushes with what it never took."""
    felt, loop = felt_by_loop(replace(LIMITS, passive=False), "late")
    assert gained_by_cycle(felt).max() > 10 * EPSILON
    assert loop.passivity.lowest < -50 * EPSILON


@pytest.mark.parametrize("delay", [0.002, 0.03])
@pytest.mark.parametrize("stiffness", [100.0, 2000.0])
def test_a_mass_does_not_leave_a_wall_faster_than_it_came(stiffness: float, delay: float) -> None:
    """Without friction of its own; with the frames' force held, or the models alone, it does."""
    wall = Wall(stiffness, delay=delay)
    assert restitution(wall, PASSIVE) <= 1.01
    assert restitution(wall, MODELS) > 1.05
    assert restitution(wall, HELD) > 1.3


# The account of the energy


@given(st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 12), min_size=1, max_size=40))
def test_with_the_motion_as_predicted_no_energy_is_ever_given(
    ticks: list[tuple[float, ...]],
) -> None:
    controller = PassivityController(arm=0.03, damping=1e9, period=PERIOD)
    taken = 0.0
    for numbers in ticks:
        wrench, motion = np.array(numbers[:6]), 1e-3 * np.array(numbers[6:])
        allowed = controller.correct(wrench, motion)
        controller.observe(allowed, motion)
        taken -= float(allowed @ motion)
        assert controller.energy == pytest.approx(taken, abs=1e-12)
        assert taken >= -1e-7


def test_the_controller_leaves_alone_what_takes_energy() -> None:
    controller = PassivityController(0.03, 20.0, PERIOD)
    wrench = np.array([-1.0, 0.5, 0.0, 0.0, 0.0, 0.01])
    assert controller.correct(wrench, 1e-3 * np.eye(6)[0]) is wrench
    assert controller.corrections == 0
    stopped = controller.correct(-wrench, 1e-3 * np.eye(6)[0])
    assert stopped[0] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(stopped[1:], -wrench[1:])
    controller.observe(np.eye(6)[0], 1e-3 * np.eye(6)[0])
    controller.forget()
    assert controller.energy == pytest.approx(-1e-3)


# Bounds, and what ends a force


MODEL = ContactModel(
    rigid.IDENTITY, np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.diag([500.0] * 3 + [0.05] * 3),
    np.diag([1.0] * 3 + [1e-4] * 3), 0.1, 0.01, True,
)  # fmt: skip


def at(way: float, axis: int = 0) -> Reals:
    pose = rigid.IDENTITY.copy()
    pose[axis] = way
    return pose


def run(loop: ContactLoop, first: int, ticks: int, pose: Reals, withheld: str = "") -> list[Reals]:
    return [loop.step((first + k) * PERIOD, pose, pose, withheld) for k in range(ticks)]


def test_a_model_is_rendered_as_it_is_written() -> None:
    loop = ContactLoop(LIMITS, PERIOD)
    assert not run(loop, 0, 3, at(0.0))[-1].any()
    assert loop.withheld == NO_MODEL
    loop.receive(MODEL, 0.0)
    given = run(loop, 3, 40, at(0.001))[-1]
    np.testing.assert_allclose(given, [-0.5, 0.0, 1.0, 0.0, 0.0, 0.0], atol=1e-9)
    assert loop.withheld == ""


def test_a_new_model_comes_without_a_jump() -> None:
    loop = ContactLoop(LIMITS, PERIOD)
    loop.receive(MODEL, 0.0)
    before = run(loop, 0, 40, at(0.0))[-1]
    loop.receive(replace(MODEL, wrench=-MODEL.wrench), 0.08)
    forces = np.array([before, *run(loop, 40, 30, at(0.0))])
    np.testing.assert_allclose(forces[1], before, atol=1e-9)
    assert np.abs(np.diff(forces, axis=0)).max() < 0.2
    np.testing.assert_allclose(forces[-1], -before, atol=1e-9)


def test_a_model_that_is_overtaken_is_left_out() -> None:
    loop = ContactLoop(LIMITS, PERIOD)
    loop.receive(MODEL, 0.05)
    loop.receive(replace(MODEL, wrench=-MODEL.wrench), 0.04)
    assert run(loop, 25, 30, at(0.0))[-1][2] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("first", "withheld", "says"), [(52, "", OLD_MODEL), (20, "the device is silent", "silent")]
)
def test_a_force_that_must_go_goes_smoothly_and_soon(first: int, withheld: str, says: str) -> None:
    loop = ContactLoop(LIMITS, PERIOD)
    loop.receive(MODEL, 0.0)
    run(loop, 0, first, at(0.0))
    forces = np.array([wrench[2] for wrench in run(loop, first, 20, at(0.0), withheld)])
    assert says in loop.withheld
    assert (np.diff(forces) <= 0.0).all()
    assert forces[0] > 0.8
    assert not forces[int(LIMITS.fade / PERIOD) + 1 :].any()
    if withheld:
        assert run(loop, first + 20, 10, at(0.0))[-1][2] > 0.5


def test_beyond_its_reach_a_model_is_not_believed() -> None:
    sizes = []
    for way in (0.009, 0.015, 0.021):
        loop = ContactLoop(replace(LIMITS, max_stiffness=50.0), PERIOD)
        loop.receive(MODEL, 0.0)
        sizes.append(float(np.linalg.norm(run(loop, 0, 40, at(way))[-1])))
    assert sizes[0] > sizes[1] > 0.0
    assert sizes[2] == 0.0


def test_force_torque_and_rate_are_bounded() -> None:
    limits = LoopLimits(ForceLimits(2.0, 0.05, 100.0, 2.0))
    loop = ContactLoop(limits, PERIOD)
    loop.receive(replace(MODEL, wrench=np.array([300.0, 0.0, 0.0, 0.0, 9.0, 0.0])), 0.0)
    forces = np.array(run(loop, 0, 45, at(0.0)))
    assert np.linalg.norm(forces[-1, :3]) == pytest.approx(2.0)
    assert np.linalg.norm(forces[-1, 3:]) == pytest.approx(0.05)
    steps = np.linalg.norm(np.diff(forces[:, :3], axis=0), axis=1)
    assert steps.max() <= 100.0 * PERIOD + 1e-9


def test_a_stiffness_too_large_for_the_device_is_rendered_softer() -> None:
    loop = ContactLoop(replace(LIMITS, max_stiffness=250.0), PERIOD)
    loop.receive(MODEL, 0.0)
    assert run(loop, 0, 40, at(0.001))[-1][0] == pytest.approx(-0.25)
    assert loop.scaled_down == 1


def test_a_probe_does_not_pull() -> None:
    reference = np.array([0.0, 0.3, 1.0, 0.01, 0.0, 0.0])
    half = pushing(np.array([0.2, 0.15, 0.5, 0.01, 0.0, 0.0]), reference)
    assert 0.0 < half[2] < 0.6
    assert not pushing(np.array([0.2, -0.3, -0.5, 0.01, 0.0, 0.0]), reference).any()
    more = np.array([0.0, 0.6, 2.0, 0.02, 0.0, 0.0])
    assert pushing(more, reference) is more


def test_a_frozen_tool_gives_no_energy_to_the_hand_that_moves_on() -> None:
    """With a clutch or at the workspace's edge the tool stays; the hand's own motion counts."""
    loop = ContactLoop(LIMITS, PERIOD)
    loop.receive(MODEL, 0.0)
    taken, force, before = 0.0, np.zeros(6), 0.0
    for k in range(45):
        height = 0.02 * k * PERIOD
        taken -= force[2] * (height - before)
        before = height
        force = loop.step(k * PERIOD, at(0.0), at(height, 2))
        assert taken >= -EPSILON
