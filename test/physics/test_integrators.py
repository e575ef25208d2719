"""Integrators of the dynamic model: order, stability bound, energy, velocities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

from support.allocations import least_peak
from support.elastic_scenes import (
    MATERIAL,
    apply,
    block_mesh,
    build,
    double,
    hold,
    release,
    split_edit,
    steps,
    top_ball,
)
from support.oscillator import LENGTH, oscillator
from support.small_block import CORNER, block_simulation, pose_of, tool_at
from support.small_block import block_mesh as small_block_mesh
from support.split_edit import split_at
from support.spring_energy import kinetic_energy, spring_energy
from tissue_sim.elastic import registry
from tissue_sim.elastic.integrators import (
    EULER,
    NAMES,
    RUNGE_KUTTA_2,
    RUNGE_KUTTA_4,
    TABLEAUS,
    VERLET,
    stability_limit,
)
from tissue_sim.elastic.model import State
from tissue_sim.elastic.spring_mass import SpringMass
from tissue_sim.frame import Budget, Command, FrameInputs, ToolSample
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.journal import replay

ALL = [VERLET, EULER, RUNGE_KUTTA_2, RUNGE_KUTTA_4]


def swing(omega: float, c: float, t: float) -> float:
    """x(t) of x'' = -omega^2 x - c x', x(0) = 1, x'(0) = 0."""
    s = np.sqrt(complex(c * c / 4 - omega * omega))
    both = [(-c / 2 + s), (-c / 2 - s)]
    a, b = both[1] / (both[1] - both[0]), -both[0] / (both[1] - both[0])
    return float((a * np.exp(both[0] * t) + b * np.exp(both[1] * t)).real)


@pytest.mark.parametrize(
    ("integrator", "order"), [(EULER, 1), (RUNGE_KUTTA_2, 2), (RUNGE_KUTTA_4, 4)]
)
def test_runge_kutta_methods_have_their_order(integrator: int, order: int) -> None:
    _, _, omega = oscillator(1e-5)
    c, duration, amplitude, errors = omega, 3.0 / omega, 1e-9 * LENGTH, []
    for n in (16, 32, 64, 128):
        h = duration / n
        model, state, _ = oscillator(h, damping=c * h, integrator=integrator)
        state.displacement[3, 2] = state.previous[3, 2] = amplitude
        steps(model, state, n)
        errors.append(abs(state.displacement[3, 2] / amplitude - swing(omega, c, duration)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 0.02
    np.testing.assert_allclose(orders[-2:], order, atol=0.15)


def test_runge_kutta_4_keeps_time_far_better_than_verlet() -> None:
    _, _, omega = oscillator(1e-5)
    amplitude, errors = 1e-9 * LENGTH, {}
    h = 2 * np.pi / omega / 40
    for integrator in (VERLET, RUNGE_KUTTA_4):
        model, state, _ = oscillator(h, integrator=integrator)
        state.displacement[3, 2] = amplitude
        back = np.cos(omega * h) if integrator == VERLET else 1.0
        state.previous[3, 2] = amplitude * back
        steps(model, state, 10)
        # A quarter of a period later it goes through its place of rest.
        errors[integrator] = abs(state.displacement[3, 2] / amplitude)
    assert errors[RUNGE_KUTTA_4] < 2e-5
    assert 1e-3 < errors[VERLET] < 2e-3


def step_matrix(integrator: int, y: float, d: float) -> np.ndarray:
    """One step of (u, p) with h^2 omega^2 = y, written down independently of the kernels."""
    if integrator == VERLET:
        return np.array([[2 - d - y, -(1 - d)], [1, 0]])
    A = np.array([[0.0, 1.0], [-y, -d]])
    total, term = np.eye(2), np.eye(2)
    for power in range(1, {EULER: 1, RUNGE_KUTTA_2: 2, RUNGE_KUTTA_4: 4}[integrator] + 1):
        term = term @ A / power
        total = total + term
    return total


@pytest.mark.parametrize("integrator", ALL)
@pytest.mark.parametrize("damping", [0.001, 0.02, 0.3, 0.9])
def test_the_bound_is_where_oscillations_begin_to_grow(integrator: int, damping: float) -> None:
    limit = stability_limit(integrator, damping)

    def growth(y: float) -> float:
        return float(np.abs(np.linalg.eigvals(step_matrix(integrator, y, damping))).max())

    inside = [growth(limit * share) for share in np.linspace(1e-4, 0.999, 2000)]
    assert max(inside) < 1.0
    assert growth(1.002 * limit) > 1.0


def test_without_damping_the_bounds_are_those_of_the_textbook() -> None:
    assert stability_limit(VERLET, 0.0) == 4.0
    assert stability_limit(EULER, 0.0) == stability_limit(RUNGE_KUTTA_2, 0.0) == 0.0
    assert stability_limit(RUNGE_KUTTA_4, 0.0) == pytest.approx(8.0)


@pytest.mark.parametrize("integrator", ALL)
def test_one_node_just_inside_the_bound_is_stable_and_just_outside_is_not(integrator: int) -> None:
    _, _, omega = oscillator(1e-5)
    grown = []
    for share in (0.97, 1.03):
        h = share * np.sqrt(stability_limit(integrator, 0.3)) / omega
        # The model's own bound is Gershgorin's, which is smaller, and leaves a margin.
        model, state, _ = oscillator(1e-5, damping=0.3, integrator=integrator)
        model._scale[3] = h**2 / model.springs.masses[3]
        state.displacement[3, 2] = state.previous[3, 2] = 1e-9 * LENGTH
        steps(model, state, 600)
        grown.append(np.abs(state.displacement).max() / (1e-9 * LENGTH))
    assert grown[0] < 0.05
    assert grown[1] > 10.0


@pytest.mark.parametrize("integrator", [EULER, RUNGE_KUTTA_2])
def test_methods_that_need_damping_are_refused_without(integrator: int) -> None:
    with pytest.raises(ValueError, match=r"damping = 0 is not stable .*; allowed: more than 0"):
        registry.build(
            "spring_mass", block_mesh(3), MATERIAL, {"damping": 0.0, "integrator": integrator}
        )


@pytest.mark.parametrize("integrator", ALL)
def test_a_time_step_too_long_for_the_integrator_is_refused_by_name(integrator: int) -> None:
    mesh = block_mesh(4)
    longest = SpringMass(mesh, MATERIAL, {"integrator": integrator}).longest_time_step()
    values = {"integrator": integrator, "time_step": 1.01 * longest}
    with pytest.raises(ValueError, match=rf"with {NAMES[integrator]} and damping .* up to .* s"):
        registry.build("spring_mass", mesh, MATERIAL, values)
    values["time_step"] = 0.99 * longest
    registry.build("spring_mass", mesh, MATERIAL, values)


def energies(integrator: int, damping: float, count: int) -> np.ndarray:
    """Energy of a swinging block [J] every 100 steps."""
    mesh = block_mesh(4)
    springs, state = double(mesh)
    model, _ = build("spring_mass", mesh, springs, state, integrator=integrator, damping=damping)
    rows = np.arange(mesh.node_rows)
    z = mesh.rest[rows, 2] / 0.06
    state.displacement[rows, 0] = 0.006 * z**2
    state.previous[:] = state.displacement
    assert model.time_step is not None
    found = []
    for n in range(count):
        steps(model, state, 1)
        if n % 100 == 0:
            u, velocity = (
                state.displacement,
                (state.displacement - state.previous) / model.time_step,
            )
            if integrator == VERLET:
                # Its velocity belongs to the middle of the step.
                u = (state.displacement + state.previous) / 2
            found.append(spring_energy(springs, u) + kinetic_energy(springs, velocity))
    return np.array(found)


def test_undamped_verlet_neither_gains_nor_loses_energy_in_the_long_run() -> None:
    energy = energies(VERLET, 0.0, 20000)
    assert np.abs(energy / energy[0] - 1).max() < 0.1
    early, late = energy[:50].mean(), energy[-50:].mean()
    assert late == pytest.approx(early, rel=0.02)


def test_undamped_runge_kutta_4_loses_energy_slowly_and_never_gains() -> None:
    energy = energies(RUNGE_KUTTA_4, 0.0, 5000)
    assert (np.diff(energy) < 1e-9 * energy[0]).all()
    assert energy[-1] > 0.2 * energy[0]


@pytest.mark.parametrize("integrator", [EULER, RUNGE_KUTTA_2])
def test_with_damping_the_others_lose_energy_too(integrator: int) -> None:
    energy = energies(integrator, 0.02, 2000)
    assert (np.diff(energy) < 1e-6 * energy[0]).all()


FIVE = [[0, 3, 5, 6], [1, 0, 3, 5], [2, 0, 3, 6], [4, 0, 5, 6], [7, 3, 5, 6]]
"""A cube as five tetrahedra; corner x + 2 y + 4 z. Mirrored in x, corner c becomes c ^ 1."""


def bar() -> tuple[Mesh, float, float]:
    """A slender bar along x, fixed at x = 0; its length [m] and cross-section [m^2].

    Neighbouring cubes are mirror images, so that the bar is symmetric and a pull does not bend it.
    """
    nx, n, side = 40, 2, 0.01
    x, y, z = np.meshgrid(np.arange(nx + 1), np.arange(n + 1), np.arange(n + 1), indexing="ij")
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float64)
    points *= side
    tets = []
    for i, j, k in np.ndindex(nx, n, n):
        mirrored = (i + j + k) % 2
        corners = [
            ((i + (c & 1)) * (n + 1) + j + (c >> 1 & 1)) * (n + 1) + k + (c >> 2) for c in range(8)
        ]
        tets += [[corners[c ^ mirrored] for c in tet] for tet in FIVE]
    tets_ = np.array(tets)
    wrong = signed_volumes(points, tets_.astype(np.int32)) < 0
    tets_[wrong] = tets_[wrong][:, [0, 1, 3, 2]]
    return Mesh(RawMesh(points, tets_), points[:, 0] < 1e-9), nx * side, (n * side) ** 2


def static_modulus(springs, mesh: Mesh, length: float, area: float) -> float:  # type: ignore[no-untyped-def] # noqa: ANN001
    """Young's modulus of the bar [Pa] from a pull at its end, by the springs' stiffness matrix."""
    rows, used = mesh.node_rows, springs.springs.alive[: springs.rows]
    ends = springs.springs.ends[: springs.rows][used]
    k = springs.springs.stiffness[: springs.rows][used]
    n = mesh.rest[ends[:, 1]] - mesh.rest[ends[:, 0]]
    n /= np.linalg.norm(n, axis=1)[:, None]
    blocks = k[:, None, None] * n[:, :, None] * n[:, None, :]
    places, entries = [], []
    for a, b, sign in ((0, 0, 1), (1, 1, 1), (0, 1, -1), (1, 0, -1)):
        i = (3 * ends[:, a])[:, None, None] + np.arange(3)[None, :, None] + np.zeros((1, 1, 3), int)
        j = (3 * ends[:, b])[:, None, None] + np.arange(3)[None, None, :] + np.zeros((1, 3, 1), int)
        places.append(np.stack([i.ravel(), j.ravel()]))
        entries.append(sign * blocks.ravel())
    places_, entries_ = np.concatenate(places, axis=1), np.concatenate(entries)
    K = coo_array((entries_, (places_[0], places_[1])), shape=(3 * rows, 3 * rows)).tocsr()
    free = np.flatnonzero(np.repeat(~mesh.fixed[:rows], 3))
    # A tension at the end, spread as mass is spread there.
    end = np.flatnonzero(mesh.rest[:rows, 0] > length - 1e-9)
    share = springs.masses[end] / springs.masses[end].sum()
    f = np.zeros(3 * rows)
    f[3 * end] = share
    u = np.zeros(3 * rows)
    u[free] = spsolve(K[free][:, free], f[free])
    return length / (area * float((share * u[3 * end]).sum()))


@pytest.mark.parametrize("integrator", [VERLET, RUNGE_KUTTA_4])
def test_a_bar_swings_along_itself_with_the_frequency_of_the_one_dimensional_bar(
    integrator: int,
) -> None:
    mesh, length, area = bar()
    springs, state = double(mesh)
    model, _ = build("spring_mass", mesh, springs, state, damping=0.0, integrator=integrator)
    assert model.time_step is not None
    E = static_modulus(springs, mesh, length, area)
    expected = np.sqrt(E / MATERIAL.density) / (4 * length)
    rows = np.arange(mesh.node_rows)
    shape = np.sin(np.pi / 2 * mesh.rest[rows, 0] / length)
    state.displacement[rows, 0] = 1e-5 * shape
    state.previous[:] = state.displacement
    weights = springs.masses[rows] * shape
    crossings, before = [], 1.0
    for n in range(1, 100000):
        model.step(state)
        now = float(weights @ state.displacement[rows, 0])
        if now * before < 0:
            crossings.append((n - now / (now - before)) * model.time_step)
        before = now
        if len(crossings) == 5:
            break
    frequency = 1 / (2 * np.diff(crossings).mean())
    assert frequency == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("integrator", sorted(TABLEAUS))
def test_a_released_node_starts_without_velocity_with_every_integrator(integrator: int) -> None:
    mesh = block_mesh(5)
    model, state = build("spring_mass", mesh, integrator=integrator)
    held = hold(model, state, top_ball(mesh, 0.016), mesh)
    for frame in range(20):
        state.displacement[held] = [0, 0, 1e-4 * frame]
        model.step(state)
    np.testing.assert_array_equal(state.previous[held], state.displacement[held])


@pytest.mark.parametrize("integrator", sorted(TABLEAUS))
def test_state_alone_says_how_it_goes_on(integrator: int) -> None:
    """A model built anew goes on as the old one does, up to the digits that `previous` lacks."""
    mesh = block_mesh(5)
    springs, state = double(mesh)
    model, _ = build("spring_mass", mesh, springs, state, integrator=integrator)
    held = hold(model, state, top_ball(mesh, 0.016), mesh)
    state.displacement[held] = [0, 0, 0.004]
    steps(model, state, 50)
    assert (state.previous != state.displacement).any()
    other, copy = build(
        "spring_mass", mesh, springs, State(mesh, np.float64), integrator=integrator
    )
    for name in ("displacement", "previous", "prescribed"):
        getattr(copy, name)[:] = getattr(state, name)
    other.prescribed_changed(copy, held)
    steps(model, state, 100)
    steps(other, copy, 100)
    np.testing.assert_allclose(copy.displacement, state.displacement, atol=1e-12)


@pytest.mark.parametrize("integrator", sorted(TABLEAUS))
def test_a_state_put_to_rest_is_at_rest(integrator: int) -> None:
    mesh = block_mesh(5, fixed=False)
    model, state = build("spring_mass", mesh, integrator=integrator)
    rows = np.arange(mesh.node_rows)
    state.previous[rows] = [-1e-5, 0, 0]
    steps(model, state, 3)
    assert state.displacement[rows, 0].all()
    # What a switch of models and the recovery of a lost state do.
    state.displacement[:] = state.previous[:] = 0.0
    model.prescribed_changed(state, np.empty(0, dtype=np.int32))
    steps(model, state, 20)
    assert not state.displacement.any()


@pytest.mark.parametrize("integrator", ALL)
def test_a_cut_changes_neither_mass_nor_stiffness_nor_the_motion_of_a_shifted_organ(
    integrator: int,
) -> None:
    mesh = block_mesh(5, fixed=False)
    springs, state = double(mesh)
    model, _ = build("spring_mass", mesh, springs, state, integrator=integrator)
    rows = np.arange(mesh.node_rows)
    state.previous[rows] = [-1e-6, 2e-6, 0]
    mass = springs.masses.sum()
    stiffness = springs.springs.stiffness[springs.springs.alive].sum()
    steps(model, state, 5)
    apply(mesh, model, state, split_edit(mesh, 0.03))
    assert springs.masses.sum() == pytest.approx(mass, rel=1e-12)
    assert springs.springs.stiffness[springs.springs.alive].sum() == pytest.approx(
        stiffness, rel=1e-12
    )
    # No node has got a velocity of its own: the halves go on together.
    steps(model, state, 5)
    rows = np.arange(mesh.node_rows)
    u = state.displacement[rows]
    assert np.ptp(u, axis=0).max() < 1e-12
    assert u[0, 0] > 5e-6


@pytest.mark.parametrize("integrator", ALL)
def test_steps_with_every_force_allocate_no_arrays(integrator: int) -> None:
    mesh = block_mesh(17)
    model, state = build(
        "spring_mass", mesh, integrator=integrator, spring_law=2, volume_stiffness=5e4,
        home_stiffness=1e6,
    )  # fmt: skip
    held = hold(model, state, top_ball(mesh), mesh)
    state.displacement[held] = [0, 0, -0.03]
    steps(model, state, 70)
    assert isinstance(model, SpringMass)
    assert model.internal.inverted > 0
    assert least_peak(lambda: steps(model, state, 10)) < 8 * mesh.node_rows


@pytest.mark.parametrize("integrator", ALL)
def test_a_session_with_a_hold_a_cut_and_inverted_elements_replays_bit_by_bit(
    integrator: int,
) -> None:
    values = {"integrator": integrator, "damping": 0.1, "volume_stiffness": 2e4, "spring_law": 1}
    tool = tool_at(CORNER, "left")
    simulation = block_simulation(
        tool, model="spring_mass", parameters={"spring_mass": values, "lr": {}}
    )
    place, entries, inverted = np.array(CORNER), [], 0
    for number in range(1, 41):
        commands: tuple[Command, ...] = ()
        if number == 2:
            commands = (Command("grab", {"tool": "left", "radius": 0.02}),)
        if number == 25:
            commands = (Command("release", {"hold_id": 0, "tool": "left"}),)
        if number == 32:
            commands = (Command("set_model", {"model": "spring_mass", "parameters": values}),)
        edits = (split_at(simulation.mesh, 0.03, top=0.05),) if number == 12 else ()
        place = place + (0.03 - place) * 0.1
        sample = ToolSample("left", pose_of(place), 1, False, 0)
        frame = simulation.advance(FrameInputs(commands, edits, (sample,)), Budget(steps=8))
        assert all(answer.success for answer in frame.answers)
        entries.append(frame.journal)
        assert isinstance(simulation.model, SpringMass)
        inverted = max(inverted, simulation.model.internal.inverted)
    assert inverted > 0
    assert np.abs(simulation.state.displacement).max() > 1e-4
    result = replay(entries, small_block_mesh())
    assert result.mismatches == ()
    for name in ("displacement", "previous"):
        np.testing.assert_array_equal(
            getattr(result.simulation.state, name), getattr(simulation.state, name)
        )


@pytest.mark.parametrize("integrator", [VERLET, RUNGE_KUTTA_2, RUNGE_KUTTA_4])
def test_released_tissue_ends_at_rest(integrator: int) -> None:
    mesh = block_mesh(5)
    model, state = build("spring_mass", mesh, integrator=integrator)
    held = hold(model, state, top_ball(mesh, 0.016), mesh)
    state.displacement[held] = [0, 0, 0.01]
    steps(model, state, 200)
    release(model, state, mesh)
    steps(model, state, 8000)
    assert np.abs(state.displacement).max() < 1e-6
