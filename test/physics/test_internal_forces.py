"""Spring laws, volume forces, home forces and what turns inverted elements back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from support.elastic_scenes import (
    MATERIAL,
    apply,
    ball,
    block_mesh,
    build,
    double,
    hold,
    plain_forces,
    release,
    split_edit,
    steps,
    top_ball,
    two_nodes,
)
from support.spring_energy import biphasic, cubic, elongations, volume_ratios
from tissue_sim.elastic import registry
from tissue_sim.elastic.spring_mass import SpringMass
from tissue_sim.frame import Budget, FrameInputs
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

LAWS: dict[str, dict[str, Any]] = {
    "biphasic": {"spring_law": 1, "critical_elongation": 0.2, "stiffness_ratio": 3.0},
    "cubic": {"spring_law": 2, "quadratic": 0.5, "cubic": 2.0, "polynomial_up_to": 0.3},
}


def pull(elongation: float, **values: Any) -> float:
    """Force between the ends of one spring over k l0 [1], positive when it pulls."""
    mesh, springs = two_nodes()
    _, state = double(mesh)
    model, _ = build("spring_mass", mesh, springs, state, turning_pressure=0.0, **values)
    # The springs from node 0 to the others keep their length: what pulls at it is this one alone.
    axis = mesh.rest[1] - mesh.rest[0]
    state.displacement[1] = elongation * axis
    F = model.forces(state, np.array([0], dtype=np.int32))[0]
    k, l0 = springs.springs.stiffness[0], np.linalg.norm(axis)
    return float(F @ (axis / l0) / (k * l0))


@pytest.mark.parametrize("e", [-0.6, -0.2, -1e-6, 1e-6, 0.1, 0.2, 0.21, 0.5, 2.0])
def test_a_biphasic_spring_pulls_by_its_closed_form(e: float) -> None:
    expected = e if e <= 0.2 else 0.2 + 3.0 * (e - 0.2)
    assert pull(e, **LAWS["biphasic"]) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("e", [-0.6, -0.3, -0.2, -1e-6, 1e-6, 0.1, 0.3, 0.31, 0.5, 2.0])
def test_a_cubic_spring_pulls_by_its_closed_form(e: float) -> None:
    inside = np.clip(e, -0.3, 0.3)
    slope = 1 + 2 * 0.5 * inside + 3 * 2.0 * inside**2
    expected = inside + 0.5 * inside**2 + 2.0 * inside**3 + slope * (e - inside)
    assert pull(e, **LAWS["cubic"]) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("law", "e"), [("biphasic", 0.2), ("cubic", 0.3), ("cubic", -0.3)])
def test_forces_do_not_jump_where_a_law_changes(law: str, e: float) -> None:
    below, above = pull(e - 1e-9, **LAWS[law]), pull(e + 1e-9, **LAWS[law])
    assert above == pytest.approx(below, abs=1e-7)


def test_the_slope_of_a_cubic_spring_does_not_jump_either() -> None:
    def slope(e: float) -> float:
        return (pull(e + 1e-5, **LAWS["cubic"]) - pull(e - 1e-5, **LAWS["cubic"])) / 2e-5

    assert slope(0.3 + 3e-5) == pytest.approx(slope(0.3 - 3e-5), rel=1e-3)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("e", [-0.4, 0.05, 0.19, 0.25, 0.6])
def test_no_law_is_steeper_than_the_time_step_allows_for(law: str, e: float) -> None:
    mesh = block_mesh(3)
    model = registry.build("spring_mass", mesh, MATERIAL, LAWS[law])
    linear = registry.build("spring_mass", mesh, MATERIAL)
    assert isinstance(model, SpringMass)
    assert isinstance(linear, SpringMass)
    steepest = (linear.longest_time_step() / model.longest_time_step()) ** 2
    slope = (pull(e + 1e-6, **LAWS[law]) - pull(e - 1e-6, **LAWS[law])) / 2e-6
    assert slope <= steepest * (1 + 1e-6)
    # Springs across the pull: tension over length.
    assert pull(e, **LAWS[law]) / (1 + e) <= steepest


def test_a_law_of_negative_stiffness_is_refused_with_the_range() -> None:
    values = {"spring_law": 2, "cubic": -5.0}
    with pytest.raises(
        ValueError, match=r"cubic = -5 make springs of negative .* allowed: .* >= 0"
    ):
        registry.build("spring_mass", block_mesh(3), MATERIAL, values)


def test_all_laws_with_neutral_numbers_move_as_the_linear_one() -> None:
    ends = []
    cases: list[dict[str, Any]] = [
        {},
        {"spring_law": 1, "stiffness_ratio": 1.0},
        {"spring_law": 2, "cubic": 0.0},
    ]
    for values in cases:
        mesh = block_mesh(5)
        springs, state = double(mesh)
        model, _ = build("spring_mass", mesh, springs, state, **values)
        held = hold(model, state, top_ball(mesh, 0.016), mesh)
        state.displacement[held] = [0, 0.002, 0.01]
        steps(model, state, 200)
        np.testing.assert_allclose(
            model.forces(state, held), plain_forces(springs, state.displacement)[held], rtol=1e-9
        )
        ends.append(state.displacement.copy())
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-12)
    np.testing.assert_allclose(ends[2], ends[0], atol=1e-12)


def test_default_steps_are_those_of_the_quick_kernel_bit_for_bit() -> None:
    """Nothing of what this model can do besides touches tissue that needs none of it."""
    ends = []
    for turning in (0.0, 0.2):
        mesh = block_mesh(6)
        model, state = build("spring_mass", mesh, turning_pressure=turning)
        held = hold(model, state, top_ball(mesh), mesh)
        state.displacement[held] = [0, 0, 0.003]
        steps(model, state, 300)
        assert isinstance(model, SpringMass)
        assert model.internal.plain
        ends.append(state.displacement.copy())
    np.testing.assert_array_equal(ends[0], ends[1])


CASES: dict[str, dict[str, Any]] = {
    "biphasic": LAWS["biphasic"],
    "cubic": LAWS["cubic"],
    "volume": {"volume_stiffness": 2e5},
    "home": {"home_stiffness": 1e8},
    "all": {**LAWS["cubic"], "volume_stiffness": 2e5, "home_stiffness": 1e8},
    "turning": {"turning_pressure": 0.5},
}


def energy(mesh: Mesh, springs, u: np.ndarray, values: dict[str, float]) -> float:  # type: ignore[no-untyped-def] # noqa: ANN001
    """All of what is configured [J], in plain numpy."""
    k, l0, e = elongations(springs, u)
    law = values.get("spring_law", 0)
    density = e**2 / 2
    if law == 1:
        density = biphasic(e, values["critical_elongation"], values["stiffness_ratio"])
    if law == 2:
        density = cubic(e, values["quadratic"], values["cubic"], values["polynomial_up_to"])
    total = (k * l0**2 * density).sum()
    volume, J = volume_ratios(mesh, u)
    s = np.abs(J - 1)
    B = values.get("volume_stiffness", 0.0)
    total += B * (volume * np.where(s <= 1, s**2 / 2, s - 0.5)).sum()
    home = values.get("home_stiffness", 0.0) * springs.masses / MATERIAL.density
    total += (home[:, None] * u**2).sum() / 2
    turned = np.maximum(-J, 0.0)
    ramp = 0.25
    share = np.where(turned < ramp, turned**2 / (2 * ramp), turned - ramp / 2)
    total += values.get("turning_pressure", 0.0) * MATERIAL.young_modulus * (volume * share).sum()
    return float(total)


@pytest.mark.parametrize("case", CASES)
def test_forces_are_minus_the_gradient_of_an_energy(case: str) -> None:
    values: dict[str, Any] = {"turning_pressure": 0.0, **CASES[case]}
    mesh = block_mesh(4, fixed=False, size=0.03)
    springs, state = double(mesh)
    model, _ = build("spring_mass", mesh, springs, state, **values)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    random = np.random.default_rng(3)
    u = state.displacement
    # Some springs beyond where their laws change; faces within what volume forces allow for.
    noise = 4e-4 if "volume_stiffness" in values else 1.5e-3
    u[rows] = random.normal(0, noise, (len(rows), 3)) + 0.05 * mesh.rest[rows]
    if case == "turning":
        u[rows[::7]] += random.normal(0, 1e-2, (len(rows[::7]), 3))
        assert (volume_ratios(mesh, u)[1] < 0).any()
        assert isinstance(model, SpringMass)
        for _ in range(64):
            model.internal.look(u)
    F = model.forces(state, rows)
    step = 1e-8
    for node in random.choice(rows, 12, replace=False):
        for axis in range(3):
            there, back = u.copy(), u.copy()
            there[node, axis] += step
            back[node, axis] -= step
            slope = energy(mesh, springs, there, values) - energy(mesh, springs, back, values)
            assert F[node, axis] == pytest.approx(-slope / (2 * step), abs=2e-6 * np.abs(F).max())


@pytest.mark.parametrize("case", ["biphasic", "cubic", "volume", "turning"])
def test_these_forces_have_neither_resultant_nor_moment(case: str) -> None:
    mesh = block_mesh(5)
    springs, state = double(mesh)
    model, _ = build("spring_mass", mesh, springs, state, **CASES[case])
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    # Far enough for some elements to be inverted or far larger than at rest.
    state.displacement[rows] = np.random.default_rng(1).normal(0, 8e-3, (len(rows), 3))
    assert isinstance(model, SpringMass)
    for _ in range(64):
        model.internal.look(state.displacement)
    assert model.internal.inverted > 0
    F = model.forces(state, rows)
    x = mesh.rest[rows] + state.displacement[rows]
    assert np.abs(F.sum(axis=0)).max() < 1e-12 * np.abs(F).sum()
    assert np.abs(np.cross(x, F).sum(axis=0)).max() < 1e-12 * np.abs(F).sum()


@pytest.mark.parametrize("case", ["biphasic", "cubic", "volume"])
def test_these_forces_vanish_at_rest_and_under_rigid_motion(case: str) -> None:
    mesh = block_mesh(5, fixed=False)
    single, at_rest = build("spring_mass", mesh, **CASES[case])
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    assert not single.forces(at_rest, rows).any()
    springs, state = double(mesh)
    model, _ = build("spring_mass", mesh, springs, state, **CASES[case])
    state.displacement[rows] = [0.01, -0.02, 0.005]
    assert not model.forces(state, rows).any()
    c, s = np.cos(1.0), np.sin(1.0)
    turned = mesh.rest[rows] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    state.displacement[rows] = turned - mesh.rest[rows]
    scale = springs.springs.stiffness.max() * 0.01
    assert np.abs(model.forces(state, rows)).max() < 1e-10 * scale


def squeezed_volume(**values: Any) -> float:
    """Volume of a block over that at rest when its top is pressed down by a tenth and rests."""
    mesh = block_mesh(6)
    model, state = build("spring_mass", mesh, damping=0.1, **values)
    top = np.flatnonzero(mesh.rest[: mesh.node_rows, 2] > 0.06 - 1e-9)
    held = hold(model, state, top, mesh)
    state.displacement[held, 2] = -0.006
    steps(model, state, 3000)
    volume, J = volume_ratios(mesh, state.displacement.astype(np.float64))
    return float((volume * J).sum() / volume.sum())


def test_volume_forces_restore_volume() -> None:
    losses = [1 - squeezed_volume(volume_stiffness=B) for B in (0.0, 5e4, 5e5)]
    assert losses[0] > 0.03
    assert losses[1] < 0.6 * losses[0]
    assert losses[2] < 0.2 * losses[0]


def test_home_forces_shorten_the_reach_of_a_pull_and_bring_an_organ_with_nothing_fixed_home() -> (
    None
):
    mesh = block_mesh(6, fixed=False)
    model, state = build("spring_mass", mesh, home_stiffness=1e8, damping=0.05)
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0, 0, 0.005]
    steps(model, state, 2000)
    low = np.flatnonzero(mesh.rest[: mesh.node_rows, 2] < 0.02)
    assert np.abs(state.displacement[low]).max() < 0.2 * 0.005
    release(model, state, mesh)
    steps(model, state, 4000)
    assert np.abs(state.displacement).max() < 1e-7


def test_the_frequency_of_an_organ_that_only_home_forces_hold() -> None:
    mesh = block_mesh(4, fixed=False)
    springs, state = double(mesh)
    model, _ = build(
        "spring_mass", mesh, springs, state, home_stiffness=4e7, damping=0.0, time_step=2e-4
    )
    rows = np.arange(mesh.node_rows)
    assert model.time_step is not None
    omega, t = np.sqrt(4e7 / MATERIAL.density), 0.0
    state.displacement[rows, 0] = 1e-3
    state.previous[rows, 0] = 1e-3 * np.cos(omega * model.time_step)
    for _ in range(400):
        model.step(state)
        t += model.time_step
        assert state.displacement[0, 0] == pytest.approx(1e-3 * np.cos(omega * t), abs=2e-6)


def test_home_forces_are_refused_in_tissue_that_has_been_cut() -> None:
    mesh = block_mesh(5)
    mesh.apply(split_edit(mesh, 0.03))
    with pytest.raises(ValueError, match=r"home_stiffness = 1e\+08 .* has been cut.*; allowed: 0"):
        registry.build("spring_mass", mesh, MATERIAL, {"home_stiffness": 1e8})
    registry.build("spring_mass", mesh, MATERIAL)


def test_home_forces_are_refused_in_tissue_that_was_cut_before_it_was_saved() -> None:
    mesh = block_mesh(5)
    mesh.apply(split_edit(mesh, 0.03))
    rows = mesh.node_rows
    saved = RawMesh(
        mesh.rest[:rows],
        mesh.tets[: mesh.element_rows].astype(np.int64),
        node_file_ids=mesh.node_file_ids[:rows],
    )
    again = Mesh(saved)
    assert again.version == 1
    with pytest.raises(ValueError, match="has been cut"):
        registry.build("spring_mass", again, MATERIAL, {"home_stiffness": 1e8})


def test_a_cut_while_running_ends_the_home_forces_and_says_so() -> None:
    scene = Scene(model="spring_mass", parameters={"spring_mass": {"home_stiffness": 1e8}})
    mesh = block_mesh(5, fixed=False)
    simulation = Simulation(mesh, scene)
    simulation.state.displacement[: mesh.node_rows] = [1e-3, 0, 0]
    simulation.state.previous[:] = simulation.state.displacement
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    assert np.abs(simulation.model.forces(simulation.state, rows)).max() > 0
    frame = simulation.advance(FrameInputs(edits=(split_edit(mesh, 0.03),)), Budget(steps=0))
    assert any("home forces are switched off" in event for event in frame.events)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    assert not simulation.model.forces(simulation.state, rows).any()
    frame = simulation.advance(FrameInputs(), Budget(steps=5))
    assert not frame.events
    # Built anew it is refused, and the running model goes on.
    with pytest.raises(ValueError, match="has been cut"):
        simulation.build_model("spring_mass", {})


@pytest.mark.parametrize("case", ["biphasic", "cubic", "volume", "turning"])
def test_a_cut_keeps_mass_and_the_energy_of_a_strained_organ(case: str) -> None:
    """Stiffness of every kind is shared out: the same strain stores the same energy."""
    mesh = block_mesh(5)
    springs, state = double(mesh)
    model, _ = build("spring_mass", mesh, springs, state, **CASES[case])
    rows = np.arange(mesh.node_rows)
    x = mesh.rest[rows]
    state.displacement[rows] = x @ np.array([[0.05, 0.1, 0], [0, -0.2, 0.05], [0.1, 0, 0.3]])
    state.previous[:] = state.displacement
    mass, before = springs.masses.sum(), energy(mesh, springs, state.displacement, CASES[case])
    apply(mesh, model, state, split_edit(mesh, 0.03))
    assert springs.masses.sum() == pytest.approx(mass, rel=1e-12)
    after = energy(mesh, springs, state.displacement, CASES[case])
    assert after == pytest.approx(before, rel=1e-12)


def dragged(mesh: Mesh, **values: Any) -> tuple[float, float]:
    """A hold goes through the organ and out at 1 m/s and lets go.

    Returns:
        Largest displacement over the size while it is dragged, and 5 s later.
    """
    model, state = build("spring_mass", mesh, **values)
    assert model.time_step is not None
    held = hold(model, state, ball(mesh, mesh.rest[: mesh.node_rows].max(axis=0), 0.015), mesh)
    corner = mesh.rest[held].mean(axis=0)
    way, place = [[0.03, 0.03, 0.01], [0.01, 0.05, 0.03], [-0.04, 0.03, 0.08]], corner
    for goal in way:
        n = int(np.linalg.norm(goal - place) / (1.0 * model.time_step))
        for part in range(1, n + 1):
            state.displacement[held] = place + (goal - place) * part / n - corner
            model.step(state)
        place = np.array(goal)
    most = float(np.abs(state.displacement).max())
    state.previous[held] = state.displacement[held]
    release(model, state, mesh)
    steps(model, state, round(5.0 / model.time_step))
    assert np.isfinite(state.displacement).all()
    return most / 0.06, float(np.abs(state.displacement).max()) / 0.06


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"integrator": 1, "damping": 0.2},
        {"integrator": 2, "damping": 0.1},
        {"integrator": 3},
        {"spring_law": 1},
        {"spring_law": 2},
        {"volume_stiffness": 5e4},
    ],
)
def test_tissue_that_a_tool_went_through_comes_back(values: dict[str, float]) -> None:
    most, end = dragged(block_mesh(5), **values)
    assert 0.5 < most < 3.0
    assert end < 0.05


def test_springs_alone_would_have_left_it_inside_out() -> None:
    assert dragged(block_mesh(5), turning_pressure=0.0)[1] > 0.1
