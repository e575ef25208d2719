"""Models by name: what is refused, and how quickly models follow each other."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from support.allocations import least_peak
from support.elastic_scenes import MATERIAL, block_mesh, build, hold, release, steps, top_ball
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material, Model
from tissue_sim.elastic.springs import SpringNetwork

ALL = registry.names()


def test_the_models_are_there_and_follow_the_protocol() -> None:
    assert ALL == [
        "chain_mail",
        "finite_element",
        "lr",
        "quasi_static",
        "relaxation",
        "spring_mass",
        "vertex_block_descent",
        "voxel_chain_mail",
    ]
    for name in ALL:
        assert isinstance(registry.build(name, block_mesh(3), MATERIAL), Model)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("finite", {}, "there is no model 'finite'; allowed: .*lr, quasi_static"),
        (
            "lr",
            {"levles": 4.0},
            "no parameter 'levles'; allowed: step, force_step, levels, .*, linear_factor",
        ),
        ("lr", {"levels": 0.0}, "levels = 0 is out of range; allowed: 1 to 10000"),
        ("lr", {"levels": 2.5}, "levels = 2.5 must be a whole number"),
        ("quasi_static", {"step": 2.0}, "step = 2 is out of range; allowed: 0.01 to 1.99"),
        ("quasi_static", {"step": np.nan}, "step = nan is out of range"),
        ("spring_mass", {"damping": -0.1}, "damping = -0.1 is out of range; allowed: 0 to 0.9"),
        ("spring_mass", {"time_step": 1.0}, "time_step = 1 is out of range; allowed: 0 to .* s"),
    ],
)
def test_bad_names_and_values_are_refused_with_what_is_allowed(
    name: str, values: dict[str, float], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        registry.build(name, block_mesh(3), MATERIAL, values)


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (Material(young_modulus=-1.0), "young_modulus = -1 is out of range"),
        (Material(poisson_ratio=0.5), "poisson_ratio = 0.5 is out of range; .* not including, 0.5"),
        (Material(density=np.inf), "density = inf is out of range"),
    ],
)
def test_materials_that_make_no_sense_are_refused(material: Material, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        registry.build("lr", block_mesh(3), material)


def test_models_of_one_mesh_share_their_springs() -> None:
    mesh = block_mesh(4)
    first = registry.build("lr", mesh, MATERIAL)
    springs: SpringNetwork = first.springs  # type: ignore[attr-defined]
    second = registry.build("spring_mass", mesh, MATERIAL, springs=springs)
    assert second.springs is springs  # type: ignore[attr-defined]
    stiffer = registry.build("lr", mesh, Material(young_modulus=1e5), springs=springs)
    assert stiffer.springs is not springs  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("other", ALL)
def test_models_take_over_from_each_other_with_a_hold_and_after_it(name: str, other: str) -> None:
    mesh = block_mesh(6)
    first, state = build(name, mesh)
    held = hold(first, state, top_ball(mesh), mesh)
    for frame in range(1, 11):
        state.displacement[held] = [0, 0, 0.0004 * frame]
        steps(first, state, 10)
    second = registry.build(other, mesh, MATERIAL, springs=first.springs)  # type: ignore[attr-defined]
    state.previous[:] = state.displacement
    second.prescribed_changed(state, held)
    steps(second, state, 100)
    assert np.isfinite(state.displacement).all()
    np.testing.assert_allclose(state.displacement[held], [[0, 0, 0.004]] * len(held), rtol=1e-6)
    release(second, state, mesh)
    steps(second, state, 3000)
    # Relaxation stops at its limits, 0.035 % of the size.
    assert np.abs(state.displacement).max() < (2e-4 if other == "relaxation" else 2e-5)


@pytest.mark.parametrize("name", ALL)
def test_steps_allocate_no_arrays(name: str) -> None:
    mesh = block_mesh(17)
    model, state = build(name, mesh)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0, 0, 0.003]
    steps(model, state, 10)
    release(model, state, mesh)
    steps(model, state, 10)
    assert least_peak(lambda: steps(model, state, 50)) < 8 * mesh.node_rows


@pytest.mark.parametrize("name", ALL)
def test_steps_allocate_no_arrays_while_a_hold_moves(name: str) -> None:
    mesh = block_mesh(17)
    model, state = build(name, mesh)
    held = hold(model, state, top_ball(mesh), mesh)
    assert len(held) > 20
    places = mesh.rest[held] - mesh.rest[held].mean(axis=0)
    turning = np.cross([0.3, 1.0, 0.2], places)
    frames = itertools.count()

    def moves() -> None:
        for _ in range(10):
            t = 0.1 * next(frames)
            state.displacement[held] = [0.001 * np.sin(t), 0.0, 0.003 * np.sin(0.7 * t)]
            state.displacement[held] += 0.2 * np.sin(1.3 * t) * turning
            steps(model, state, 5)

    moves()
    assert least_peak(moves) < 8 * mesh.node_rows
