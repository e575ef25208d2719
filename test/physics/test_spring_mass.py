"""The dynamic model: frequency, order of the integrator, stability bound."""

from __future__ import annotations

import numpy as np
import pytest

from support.elastic_scenes import MATERIAL, block_mesh, build, hold, steps, top_ball
from support.oscillator import LENGTH, oscillator
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import State
from tissue_sim.elastic.spring_mass import FRAME, SpringMass
from tissue_sim.elastic.springs import SpringNetwork


def test_an_oscillator_has_its_frequency() -> None:
    model, state, omega = oscillator(2e-5)
    assert model.time_step is not None
    state.displacement[3, 2] = state.previous[3, 2] = 1e-6 * LENGTH
    signs, crossings = 1.0, []
    for n in range(1, 40000):
        model.step(state)
        now = state.displacement[3, 2]
        if now * signs < 0:
            before = state.previous[3, 2]
            crossings.append(model.time_step * (n - now / (now - before)))
            signs = np.sign(now)
        if len(crossings) == 12:
            break
    period = 2 * np.diff(crossings).mean()
    assert 2 * np.pi / period == pytest.approx(omega, rel=1e-3)


def test_verlet_is_of_second_order() -> None:
    _, _, omega = oscillator(1e-5)
    duration, errors, amplitude = 3.0 / omega, [], 1e-6 * LENGTH
    for n in (25, 50, 100):
        h = duration / n
        model, state, _ = oscillator(h)
        state.displacement[3, 2] = amplitude
        state.previous[3, 2] = amplitude * np.cos(omega * h)
        steps(model, state, n)
        errors.append(abs(state.displacement[3, 2] / amplitude - np.cos(omega * duration)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.1)


def test_the_default_time_step_is_stable_and_divides_a_frame() -> None:
    mesh = block_mesh(7)
    model, state = build("spring_mass", mesh, damping=0.0)
    assert isinstance(model, SpringMass)
    assert model.time_step is not None
    assert FRAME / model.time_step == pytest.approx(round(FRAME / model.time_step))
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0, 0, 0.003]
    steps(model, state, 3000)
    assert np.abs(state.displacement).max() < 0.02
    assert model.added_mass() < 1e-6 * model.springs.masses.sum()


def test_a_step_beyond_the_bound_is_refused_and_would_have_been_unstable() -> None:
    mesh = block_mesh(5)
    model = SpringMass(mesh, MATERIAL, {"damping": 0.0})
    too_long = 1.2 * model.longest_time_step()
    with pytest.raises(
        ValueError, match=r"time_step = .* not stable .* allowed: up to .* mass_scaling"
    ):
        registry.build("spring_mass", mesh, MATERIAL, {"damping": 0.0, "time_step": too_long})


def test_added_mass_keeps_a_long_step_stable() -> None:
    mesh = block_mesh(7)
    model, state = build("spring_mass", mesh, time_step=FRAME / 4, mass_scaling=1)
    assert isinstance(model, SpringMass)
    assert model.added_mass() > 0
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0, 0, 0.006]
    steps(model, state, 2000)
    assert np.abs(state.displacement).max() < 0.01
    assert model.residual(state) < 1.0


def test_a_step_too_long_is_taken_where_somebody_wants_to_see_it_explode() -> None:
    mesh, farthest = block_mesh(5), []
    longest = SpringMass(mesh, MATERIAL, {"damping": 0.0}).longest_time_step()
    for factor in (1.0, 3.0):
        model, state = build(
            "spring_mass", mesh, time_step=factor * longest, damping=0.0, mass_scaling=2
        )
        assert isinstance(model, SpringMass)
        assert model.added_mass() < 1e-6 * model.springs.masses.sum()
        held = hold(model, state, top_ball(mesh), mesh)
        state.displacement[held] = [0, 0, 0.001]
        steps(model, state, 60)
        farthest.append(np.abs(state.displacement).max())
    assert farthest[0] < 0.01
    assert not farthest[1] < 1.0


def test_a_released_node_starts_without_velocity() -> None:
    mesh = block_mesh(5)
    model, state = build("spring_mass", mesh)
    held = hold(model, state, top_ball(mesh, 0.016), mesh)
    for frame in range(20):
        state.displacement[held] = [0, 0, 1e-4 * frame]
        model.step(state)
    np.testing.assert_array_equal(state.previous[held], state.displacement[held])


def test_damped_motion_ends_in_the_quasi_static_equilibrium() -> None:
    mesh = block_mesh(5)
    springs = SpringNetwork(mesh, MATERIAL, np.float64)
    ends = []
    for name, more in (("spring_mass", {"damping": 0.05}), ("quasi_static", {"levels": 10000.0})):
        state = State(mesh, np.float64)
        model, _ = build(name, mesh, springs, state, **more)
        held = hold(model, state, top_ball(mesh, 0.016), mesh)
        state.displacement[held] = [0, 0.002, 0.005]
        steps(model, state, 6000)
        ends.append(state.displacement.copy())
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-8)


def strains(model: SpringMass, state: State) -> np.ndarray:
    """How much longer springs are than at rest, over that; those between free nodes."""
    springs, rest = model.springs.springs, model.mesh.rest
    ends = springs.ends[: model.springs.rows]
    ends = ends[~state.prescribed[ends].any(axis=1)]
    x = rest + state.displacement
    now, then = (np.linalg.norm(y[ends[:, 1]] - y[ends[:, 0]], axis=1) for y in (x, rest))
    return now / then - 1.0


def test_relaxation_after_each_step_keeps_springs_within_their_limits() -> None:
    worst = {}
    for passes in (0, 4):
        mesh = block_mesh(7)
        model, state = build("spring_mass", mesh, passes=passes, linear_factor=0.12)
        assert isinstance(model, SpringMass)
        held = hold(model, state, top_ball(mesh), mesh)
        for frame in range(1, 61):
            state.displacement[held] = [0, 0, 0.0001 * frame]
            steps(model, state, 4)
        steps(model, state, 600)
        worst[passes] = np.abs(strains(model, state)).max()
        hold(model, state, [], mesh)
        steps(model, state, 1500)
        assert np.abs(state.displacement).max() < 1e-4
    assert worst[0] > 0.14
    assert worst[4] < 0.125


def test_relaxation_that_finds_nothing_outside_changes_no_bit() -> None:
    shapes = []
    for passes in (0, 1):
        mesh = block_mesh(5)
        model, state = build("spring_mass", mesh, passes=passes, linear_factor=0.9)
        held = hold(model, state, top_ball(mesh), mesh)
        state.displacement[held] = [0.001, 0, 0.001]
        steps(model, state, 100)
        shapes.append(state.displacement.copy())
    assert np.abs(shapes[0]).max() > 0
    np.testing.assert_array_equal(shapes[0], shapes[1])


def test_relaxation_with_other_integrators_is_refused() -> None:
    with pytest.raises(ValueError, match="integrator = 0"):
        build("spring_mass", block_mesh(4), passes=1, integrator=3)
