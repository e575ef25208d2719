"""Stress, strain and displacement at the nodes, and what they have been."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from support.cut_scenes import new, rest
from support.sheets import ball, connected, sheet_mesh
from support.split_edit import split_at
from tissue_sim.elastic.material_field import lame_constants
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.stress import material_without_fibres
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.readings import fields
from tissue_sim.readings.history import Histories

TISSUE = Material(young_modulus=5e4, poisson_ratio=0.3)
LAMBDA, MU = lame_constants(TISSUE)


def told(mesh: Mesh, places: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    return fields.stresses(mesh, places, material_without_fibres(mesh, TISSUE))


def expect(
    values: dict[str, NDArray[np.float64]], mises: float, largest: float, smallest: float
) -> None:
    """Every node has the same, since the strain is the same everywhere.

    Where two stretches are equal, roots of the characteristic polynomial lose half the digits.
    """
    for name, value in (
        (fields.VON_MISES, mises), (fields.LARGEST_STRESS, largest),
        (fields.SMALLEST_STRESS, smallest),
    ):  # fmt: skip
        np.testing.assert_allclose(values[name], value, rtol=1e-9, atol=1e-3)


@pytest.mark.parametrize("share", [0.2, -0.2])
def test_a_uniaxial_pull_has_the_stress_of_hookes_law(share: float) -> None:
    mesh = new("shaken")
    sideways = 1.0 - TISSUE.poisson_ratio * share
    values = told(mesh, rest(mesh) * [1.0 + share, sideways, sideways])
    stress = TISSUE.young_modulus * share
    expect(values, abs(stress), max(stress, 0.0), min(stress, 0.0))
    np.testing.assert_allclose(values[fields.LARGEST_STRAIN], max(share, sideways - 1), rtol=1e-7)


def test_a_pure_shear_has_root_three_times_its_shear_stress() -> None:
    """Stretches 1 + g and 1 - g across each other: shear stress 2 mu g between them."""
    mesh, g = new("shaken"), 0.1
    turn = Rotation.from_euler("z", 45, degrees=True).as_matrix()
    values = told(mesh, rest(mesh) @ (turn @ np.diag([1 + g, 1 - g, 1]) @ turn.T).T)
    expect(values, np.sqrt(3.0) * 2 * MU * g, 2 * MU * g, -2 * MU * g)


@pytest.mark.parametrize("size", [0.8, 1.3])
def test_tissue_that_grows_or_shrinks_has_pressure_only(size: float) -> None:
    mesh = new("shaken")
    pressure = (3 * LAMBDA + 2 * MU) * (size - 1.0)
    expect(told(mesh, size * rest(mesh)), 0.0, pressure, pressure)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_moving_and_turning_tissue_tells_nothing_new(seed: int) -> None:
    random = np.random.default_rng(seed)
    mesh = new("shaken")
    shaken = rest(mesh) + 1e-3 * random.normal(size=rest(mesh).shape)
    turn = Rotation.random(random_state=seed)
    for places in (rest(mesh), shaken):
        moved = turn.apply(places) + random.uniform(-1.0, 1.0, 3)
        before, after = told(mesh, places), told(mesh, moved)
        for name, values in before.items():
            np.testing.assert_allclose(after[name], values, rtol=1e-6, atol=2e-3)
        springs = fields.spring_strain(mesh, places)
        np.testing.assert_allclose(fields.spring_strain(mesh, moved), springs, atol=1e-9)
    still = fields.displacement(mesh, rest(mesh))
    np.testing.assert_array_equal(still, 0.0)


def test_a_node_has_the_mean_of_its_elements_by_volume() -> None:
    """Against a plain loop over the elements, with strains that differ from one to the next."""
    mesh = new("shaken")
    places = rest(mesh) + 1e-3 * np.random.default_rng(3).normal(size=rest(mesh).shape)
    sums, weights = np.zeros(mesh.node_rows), np.zeros(mesh.node_rows)
    for nodes in mesh.tets[: mesh.element_rows]:
        before = (mesh.rest[nodes[1:]] - mesh.rest[nodes[0]]).T
        gradient = (places[nodes[1:]] - places[nodes[0]]).T @ np.linalg.inv(before)
        stretch = np.linalg.svd(gradient, compute_uv=False)
        stress = 2 * MU * (stretch - 1) + LAMBDA * (stretch.sum() - 3)
        mises = np.sqrt(0.5 * ((stress - np.roll(stress, 1)) ** 2).sum())
        sums[nodes] += np.linalg.det(before) * mises
        weights[nodes] += np.linalg.det(before)
    np.testing.assert_allclose(told(mesh, places)[fields.VON_MISES], sums / weights, rtol=1e-6)


def test_nodes_of_no_element_have_no_stress_and_unknown_material_has_strain() -> None:
    mesh = new("block")
    mesh.element_alive[mesh.incident.of_all(np.array([0], dtype=np.int32))] = False
    values = fields.stresses(mesh, rest(mesh), None)
    assert set(values) == {fields.LARGEST_STRAIN}
    strain = values[fields.LARGEST_STRAIN]
    assert np.isnan(strain[0])
    assert np.isfinite(strain[1:]).sum() > 100


@pytest.mark.parametrize(
    "made",
    [lambda: new("shaken"), lambda: sheet_mesh(ball()), connected],
    ids=["solid", "sheet", "wall"],
)
def test_springs_tell_how_much_tissue_grows(made: Callable[[], Mesh]) -> None:
    mesh = made()
    for size in (0.7, 1.0, 1.4):
        strain = fields.spring_strain(mesh, size * mesh.rest[: mesh.node_rows])
        told_at = np.isfinite(strain)
        assert told_at.mean() > 0.9
        np.testing.assert_allclose(strain[told_at], abs(size - 1.0), atol=1e-12)


def test_a_cut_between_two_frames_leaves_the_constant_stress_as_it_is() -> None:
    mesh = new("block")
    mesh.apply(split_at(mesh, float(np.unique(np.round(rest(mesh)[:, 0], 9))[3])))
    values = told(mesh, rest(mesh) * 1.1)
    pressure = (3 * LAMBDA + 2 * MU) * 0.1
    expect(values, 0.0, pressure, pressure)


def test_a_history_by_hand() -> None:
    histories = Histories()
    peaks = [(0.0, [1.0, 0.0, np.nan]), (0.5, [2.0, 4.0, np.nan]), (1.0, [0.0, 0.0, 1.0])]
    readings = [histories.take("stress", np.array(values), at) for at, values in peaks]
    first, second, third = (reading for reading in readings if reading is not None)
    assert (first.peak, first.peak_row, first.mean, first.integrated) == (1.0, 0, 0.5, 0.0)
    assert (second.peak, second.peak_row, second.mean) == (4.0, 1, 3.0)
    assert second.integrated == pytest.approx(0.5 * 2.5)
    assert (third.peak, third.peak_row, third.highest, third.highest_at) == (1.0, 2, 4.0, 0.5)
    assert third.integrated == pytest.approx(0.5 * 2.5 + 0.5 * 2.5)
    # The same frame again adds nothing.
    again = histories.take("stress", np.array([1.0]), 1.0)
    assert again is not None
    assert again.integrated == third.integrated
    assert histories.take("stress", np.array([np.nan]), 2.0) is None
    histories.clear()
    anew = histories.take("stress", np.array([3.0]), 2.0)
    assert anew is not None
    assert (anew.highest, anew.highest_at, anew.integrated) == (3.0, 2.0, 0.0)
