"""Surfaces and connected surfaces: forces, curvature, bending, and what the models do on them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from support.elastic_scenes import NO_ROWS, build, double, hold, plain_forces, release, steps
from support.sheets import (
    EVERYTHING,
    WITH_TORSION,
    ball,
    connected,
    lattice,
    sheet_mesh,
    shell,
    strip,
    torsion_energy,
)
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sheet import (
    ANGULAR,
    BENDING,
    CONNECTING,
    SURFACE,
    SheetStiffness,
    triangle_areas,
)

ON_SHEETS = ("quasi_static", "lr", "relaxation", "spring_mass", "chain_mail")
WITH_FORCES = ("quasi_static", "lr", "spring_mass")
NO_POISSON = Material(poisson_ratio=0.0)


def turned(points: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T


def strained(mesh: Mesh, amount: float = 4e-4) -> State:
    state = State(mesh, np.float64)
    random = np.random.default_rng(3)
    state.displacement[: mesh.node_rows] = random.normal(0, amount, (mesh.node_rows, 3))
    return state


def rows_of(mesh: Mesh) -> NDArray[np.int32]:
    return np.arange(mesh.node_rows, dtype=np.int32)


def test_forces_are_the_slope_of_the_energy_of_springs_and_torsion() -> None:
    mesh = sheet_mesh(ball(subdivisions=1), WITH_TORSION, thickness=0.008)
    springs, _ = double(mesh)
    state = strained(mesh)
    model, _ = build("quasi_static", mesh, springs, state)
    F = (
        model.forces(state, rows_of(mesh))
        - plain_forces(springs, state.displacement)[rows_of(mesh)]
    )
    h, u = 1e-8, state.displacement
    for node in range(0, mesh.node_rows, 7):
        for axis in range(3):
            step = np.zeros_like(u)
            step[node, axis] = h
            slope = torsion_energy(springs, u + step) - torsion_energy(springs, u - step)
            assert F[node, axis] == pytest.approx(-slope / (2 * h), rel=1e-5, abs=1e-6)
    assert np.abs(F).max() > 0.01


@pytest.mark.parametrize("kind", ["surface", "connected_surfaces"])
def test_a_sheet_at_rest_or_moved_has_no_force_bit_for_bit(kind: str) -> None:
    mesh = sheet_mesh(shell(), EVERYTHING, kind)
    for name in ON_SHEETS:
        model, state = build(name, mesh)
        state.displacement[:] = state.previous[:] = [0.01, -0.02, 0.005]
        model.prescribed_changed(state, NO_ROWS)
        before = state.displacement.copy()
        steps(model, state, 20)
        np.testing.assert_array_equal(state.displacement, before)
        assert not model.forces(state, rows_of(mesh)).any()


def test_a_turned_sheet_has_no_force_and_in_single_precision_stays_turned() -> None:
    mesh = sheet_mesh(shell(), EVERYTHING, "connected_surfaces")
    rows = rows_of(mesh)
    away = turned(mesh.rest[rows], 1.3) - mesh.rest[rows]
    springs, exact = double(mesh)
    exact.displacement[rows] = away
    model, _ = build("quasi_static", mesh, springs, exact)
    assert np.abs(model.forces(exact, rows)).max() < 1e-10 * springs.springs.stiffness.max() * 0.01
    for name in WITH_FORCES:
        model, state = build(name, mesh)
        state.displacement[rows] = state.previous[rows] = away
        model.prescribed_changed(state, NO_ROWS)
        steps(model, state, 300)
        assert np.abs(state.displacement[rows] - away).max() < 1e-6


def test_internal_forces_of_a_sheet_sum_to_zero_and_have_no_moment() -> None:
    mesh = sheet_mesh(shell(subdivisions=1), EVERYTHING, "connected_surfaces")
    springs, _ = double(mesh)
    state = strained(mesh, 2e-3)
    model, _ = build("quasi_static", mesh, springs, state)
    F = model.forces(state, rows_of(mesh))
    x = mesh.rest[rows_of(mesh)] + state.displacement[rows_of(mesh)]
    assert np.abs(F.sum(axis=0)).max() < 1e-11 * np.abs(F).sum()
    assert np.abs(np.cross(x, F).sum(axis=0)).max() < 1e-11 * np.abs(F).sum()


@pytest.mark.parametrize("around", [0.0, 0.4, np.pi / 2])
def test_rolling_a_sheet_up_costs_the_energy_of_a_plate(around: float) -> None:
    raw = lattice(41, 41, edge=0.001)
    points = raw.points - raw.points.mean(axis=0)
    axis = np.array([np.cos(around), np.sin(around), 0.0])
    across = np.array([-np.sin(around), np.cos(around), 0.0])
    R, h = 0.05, 5e-4
    angle = points @ across / R
    rolled = np.outer(points @ axis, axis) + np.outer(R * np.sin(angle), across)
    rolled[:, 2] = R * (1.0 - np.cos(angle))
    mesh = sheet_mesh(raw, WITH_TORSION, thickness=h)
    springs = SpringNetwork(mesh, NO_POISSON, np.float64)
    u = np.zeros((mesh.node_capacity, 3))
    u[: len(points)] = rolled - raw.points
    rigidity = NO_POISSON.young_modulus * h**3 / 12.0
    area = triangle_areas(raw.points, raw.triangles).sum()
    plate = 0.5 * rigidity / R**2 * area
    # Edges of the border have no spring: a share of about 2 / 41 of the area is not bent.
    assert torsion_energy(springs, u) == pytest.approx(plate, rel=0.05)


def test_a_strip_with_guided_ends_bends_like_a_plate() -> None:
    raw = strip(25, 9, edge=0.001)
    x, width = raw.points[:, 0], np.ptp(raw.points[:, 1])
    mesh = sheet_mesh(raw, WITH_TORSION, thickness=5e-4)
    springs, state = SpringNetwork(mesh, NO_POISSON, np.float64), State(mesh, np.float64)
    model = registry.build("quasi_static", mesh, NO_POISSON, springs=springs)
    n, rows, h = mesh.node_rows, rows_of(mesh), 1e-6
    K = np.zeros((n, n))
    for node in range(n):
        for side in (h, -h):
            state.displacement[:] = 0.0
            state.displacement[node, 2] = side
            K[:, node] -= model.forces(state, rows)[:, 2] / (2 * side)
    # Two columns of nodes at either end stay level.
    clamped, tip = x < 1.1e-3, x > 23.9e-3
    free = ~(clamped | tip)
    w = np.where(tip, 1.0, 0.0)
    w[free] = np.linalg.solve(K[np.ix_(free, free)], -K[np.ix_(free, tip)].sum(axis=1))
    length = x[tip].mean() - x[clamped].max()
    beam = NO_POISSON.young_modulus * (5e-4) ** 3 * width / length**3
    # Equilateral triangles bend as a plate whose Poisson's ratio is -1/3: a narrow strip has
    # 1 - 1/9 of its rigidity.
    assert float((K[tip] @ w).sum()) == pytest.approx(8.0 / 9.0 * beam, rel=0.07)


@pytest.mark.parametrize("category", ["surface", "connecting", "bending", "angular", "torsion"])
def test_every_category_has_a_stiffness_of_its_own(category: str) -> None:
    plain = sheet_mesh(shell(subdivisions=1), EVERYTHING, "connected_surfaces")
    values = dict.fromkeys(("surface", "connecting", "bending", "angular", "torsion"), 1.0)
    stiff = SheetStiffness(**{**values, category: 3.0})
    other = sheet_mesh(shell(subdivisions=1), stiff, "connected_surfaces")
    one, three = (SpringNetwork(mesh, Material(), np.float64) for mesh in (plain, other))
    assert one.torsion is not None
    assert three.torsion is not None
    ratio = three.springs.stiffness[: three.rows] / one.springs.stiffness[: one.rows]
    codes = {"surface": SURFACE, "connecting": CONNECTING, "bending": BENDING, "angular": ANGULAR}
    mine = one.categories == codes.get(category, -1)
    np.testing.assert_allclose(ratio, np.where(mine, 3.0, 1.0))
    assert mine.any() or category == "torsion"
    turning = three.torsion.stiffness / one.torsion.stiffness
    np.testing.assert_allclose(turning, 3.0 if category == "torsion" else 1.0)


def test_a_sheet_weighs_what_its_tissue_weighs() -> None:
    wall = connected()
    network = SpringNetwork(wall, Material())
    volume = 4.0 / 3.0 * np.pi * (0.02**3 - 0.016**3)
    assert network.masses.sum() == pytest.approx(1060.0 * volume, rel=0.06)
    skin = sheet_mesh(ball(), thickness=1e-3)
    area = triangle_areas(skin.rest, ball().triangles).sum()
    assert SpringNetwork(skin, Material()).masses.sum() == pytest.approx(1060.0 * area * 1e-3)


def test_connecting_springs_keep_the_thickness_of_the_wall() -> None:
    def thickness_after(connecting: float) -> float:
        mesh = connected(SheetStiffness(connecting=connecting), fixed=True)
        model, state = build("quasi_static", mesh, levels=10000)
        points = mesh.rest[: mesh.node_rows]
        outer = np.flatnonzero((np.linalg.norm(points, axis=1) > 0.018) & (points[:, 2] > 0.016))
        held = hold(model, state, outer, mesh)
        state.displacement[held] = [0.0, 0.0, 0.003]
        steps(model, state, 2000)
        inner = np.flatnonzero((np.linalg.norm(points, axis=1) < 0.018) & (points[:, 2] > 0.013))
        moved = points + state.displacement[: mesh.node_rows]
        return float(moved[outer, 2].mean() - moved[inner, 2].mean())

    rest = thickness_after(1e6)
    assert abs(thickness_after(1.0) - rest) < 0.5e-3
    assert thickness_after(1e-6) > rest + 2e-3


@pytest.mark.parametrize("kind", ["surface", "connected_surfaces"])
@pytest.mark.parametrize("name", ON_SHEETS)
def test_pulled_and_let_go_of_a_sheet_returns(name: str, kind: str) -> None:
    raw = shell() if kind == "connected_surfaces" else ball()
    # Relaxation does not know torsion springs.
    stiffness = EVERYTHING if name == "relaxation" else WITH_TORSION
    assert left_after_a_pull(name, raw, stiffness, kind) < (5e-4 if name == "relaxation" else 1e-4)


def test_without_curvature_springs_relaxation_leaves_a_ball_dented() -> None:
    dent = left_after_a_pull("relaxation", ball(), SheetStiffness(), "surface")
    assert dent > 5e-3
    for kept in (SheetStiffness(angular=1.0), SheetStiffness(bending=1.0)):
        assert left_after_a_pull("relaxation", ball(), kept, "surface") < 0.02 * dent


@pytest.mark.parametrize("thickness", [5e-4, 0.02, 0.05])
def test_a_sheet_thicker_than_its_edges_are_long_returns_as_well(thickness: float) -> None:
    fine = ball(subdivisions=3)
    assert left_after_a_pull("quasi_static", fine, WITH_TORSION, "surface", thickness) < 2e-4


def left_after_a_pull(
    name: str, raw: RawMesh, stiffness: SheetStiffness, kind: str, thickness: float = 0.0
) -> float:
    """Largest displacement [m] long after the top was pulled by 6 mm and let go of."""
    mesh = sheet_mesh(raw, stiffness, kind, thickness, fixed=raw.points[:, 2] < -0.012)
    model, state = build(name, mesh)
    held = hold(model, state, np.flatnonzero(raw.points[:, 2] > 0.0185), mesh)
    count = 5 if model.time_step is None else round(1.0 / 60.0 / model.time_step)
    for frame in range(1, 31):
        state.displacement[held] = [0.0, 0.0, 2e-4 * frame]
        steps(model, state, count)
    assert np.abs(state.displacement).max() < 0.0065
    assert np.abs(state.displacement).mean() > 1e-6
    release(model, state, mesh)
    steps(model, state, 3000)
    return float(np.abs(state.displacement).max())


def test_models_take_over_from_each_other_on_a_sheet() -> None:
    mesh = connected(WITH_TORSION, fixed=True)
    first, state = build("lr", mesh)
    held = hold(first, state, np.flatnonzero(mesh.rest[: mesh.node_rows, 2] > 0.0185), mesh)
    springs: SpringNetwork = first.springs  # type: ignore[attr-defined]
    for name in ON_SHEETS:
        state.displacement[held] += [0.0, 0.0, 2e-4]
        model = registry.build(name, mesh, Material(), springs=springs)
        assert model.springs is springs  # type: ignore[attr-defined]
        state.previous[:] = state.displacement
        model.prescribed_changed(state, held)
        steps(model, state, 100)
        assert np.isfinite(state.displacement).all()
        assert np.abs(state.displacement).max() < 0.004


@pytest.mark.parametrize("name", ["finite_element", "vertex_block_descent", "voxel_chain_mail"])
def test_models_of_tetrahedra_are_refused_with_what_is_allowed(name: str) -> None:
    message = (
        f"model {name} needs tetrahedra, and ball is made of surfaces; allowed: chain_mail, lr"
    )
    with pytest.raises(ValueError, match=message):
        registry.build(name, sheet_mesh(ball()), Material())
    with pytest.raises(ValueError, match="volume_stiffness = 10 Pa is for tetrahedra"):
        registry.build("spring_mass", sheet_mesh(ball()), Material(), {"volume_stiffness": 10.0})


def test_a_thin_wall_of_connected_surfaces_comes_to_rest_after_a_release() -> None:
    raw = shell(0.0195, 0.02, subdivisions=3)
    fixed = raw.points[:, 2] < -0.012
    mesh = sheet_mesh(raw, SheetStiffness(), "connected_surfaces", fixed=fixed)
    model, state = build("quasi_static", mesh)
    held = hold(model, state, np.flatnonzero(raw.points[:, 2] > 0.0185), mesh)
    for frame in range(1, 31):
        state.displacement[held] = [0.0, 0.0, 2e-4 * frame]
        steps(model, state, 5)
    release(model, state, mesh)
    steps(model, state, 1500)
    assert model.idle
    assert np.abs(state.displacement).max() < 2e-5
