"""A probe's damping: a pressure by the rate of penetration, of the tissue's motion and its own."""

from __future__ import annotations

import pickle
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from support.haptic_wall import FRAME_HZ, PressedBlock, above
from tissue_sim.interaction.contact import Contact
from tissue_sim.interaction.contact_parts import probe_parts

DAMPED = Contact(contact_damping=2e5, contact_friction=0.0)
UNDAMPED = replace(DAMPED, contact_damping=0.0)
DEPTH = 0.003
Reals = NDArray[np.float64]


def pressed(contact: Contact) -> PressedBlock:
    """A block that a probe has been pressed into, at rest."""
    block = PressedBlock(contact=contact)
    for frame in range(60):
        block.frame(above(DEPTH * min(1.0, frame / 20)))
    return block


def forces(block: PressedBlock) -> Reals:
    """Force of the probe on each node in contact [N], shape (k, 3)."""
    return block.simulation.probes.touches["probe"].force


def test_the_probes_own_speed_is_damped() -> None:
    """Before the tissue gives way the force is A (kappa depth + delta v), as haptic arms feel it.

    In a frame of one step the forces are those on the tissue as the frame found it.
    """
    block, speed = pressed(DAMPED), 0.001
    simulation = block.simulation
    there = above(DEPTH + speed / FRAME_HZ)
    tool, velocity = simulation.tools["probe"], np.array([0.0, 0.0, -speed, 0.0, 0.0, 0.0])
    before = simulation.probes.pressed(tool, there, simulation.state)
    wrench, _, damping = probe_parts(before, DAMPED, there[:3], velocity)
    resting = (DAMPED.contact_stiffness * before.area * before.depth) @ before.normal[:, 2]
    damped = DAMPED.contact_damping * before.area @ (before.normal[:, 2] ** 2 * -speed)
    block.frame(there, steps=1)
    moving = forces(block).sum(axis=0)
    assert moving[2] == pytest.approx(resting + damped, rel=1e-3)
    assert abs(damped) > 0.05 * abs(resting)
    np.testing.assert_allclose(-moving, (wrench - damping @ velocity)[:3], atol=1e-3 * -moving[2])


def test_at_rest_nothing_is_damped() -> None:
    """Force and shape are those of the contact's stiffness alone."""
    with_damping, without = pressed(DAMPED), pressed(UNDAMPED)
    for _ in range(60):
        for block in (with_damping, without):
            block.frame(above(DEPTH))
    np.testing.assert_allclose(
        forces(with_damping), forces(without), atol=0.01 * np.abs(forces(without)).max()
    )


def test_tissue_that_gives_way_takes_its_own_motion_off_the_rate() -> None:
    """Backward Euler: A (kappa d + delta (d - d before) / h), d the depth after each frame."""
    block, speed = pressed(DAMPED), 0.02
    simulation = block.simulation
    tool = simulation.tools["probe"]
    before = simulation.probes.pressed(tool, above(DEPTH), simulation.state).depth
    pose = above(DEPTH + speed / FRAME_HZ)
    block.frame(pose, steps=300)
    now = simulation.probes.pressed(tool, pose, simulation.state)
    assert len(now.depth) == len(before)
    rate = (now.depth - before) * FRAME_HZ
    assert 0.0 < rate.max() < 0.5 * speed
    pressure = DAMPED.contact_stiffness * now.depth + DAMPED.contact_damping * rate
    np.testing.assert_allclose(
        np.linalg.norm(forces(block), axis=1), now.area * pressure, rtol=0.01
    )


@pytest.mark.parametrize("damping", [2e4, 2e7, 1e9])
def test_however_strong_it_never_pulls_and_gives_no_energy(damping: float) -> None:
    """Pressed and torn away at up to 10 cm/s, out of the tissue in each cycle."""
    block, work, pose = PressedBlock(contact=Contact(contact_damping=damping)), 0.0, above(0.0)
    for depth in cycles():
        before, pose = pose, above(depth)
        block.frame(pose)
        touch = block.simulation.probes.touches["probe"]
        force = -touch.force.sum(axis=0)
        assert force[2] >= -1e-9
        work -= float(force @ (pose[:3] - before[:3]))
        assert work > -1e-6
    assert work > 0.0
    assert block.simulation.lost_states == 0


def test_what_was_the_last_gap_is_kept_with_the_simulation() -> None:
    """A simulation taken from a checkpoint in mid-press goes on bit by bit."""
    block = pressed(DAMPED)
    block.frame(above(DEPTH + 0.0002))
    again = PressedBlock(contact=DAMPED)
    again.simulation = pickle.loads(pickle.dumps(block.simulation))
    for one in (block, again):
        one.frame(above(DEPTH + 0.0004))
    np.testing.assert_array_equal(
        block.simulation.state.displacement, again.simulation.state.displacement
    )
    np.testing.assert_array_equal(forces(block), forces(again))


def cycles() -> Iterable[float]:
    return (0.002 - 0.004 * np.cos(2 * np.pi * 4.0 * k / FRAME_HZ) for k in range(90))
