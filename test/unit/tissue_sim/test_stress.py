from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from support.cut_scenes import new, raw_organ, rest
from tissue_sim.elastic.material_field import MaterialField, lame_constants
from tissue_sim.elastic.model import Material, RegionMaterial
from tissue_sim.elastic.stress import ElementMaterial, element_material, pulled_hard, stresses_of
from tissue_sim.geometry.mesh import Mesh

TISSUE = Material(young_modulus=5e4, poisson_ratio=0.45)
LAMBDA, MU = lame_constants(TISSUE)


def tets_of(mesh: Mesh) -> NDArray[np.int32]:
    return mesh.tets[: mesh.element_rows]


def over(
    mesh: Mesh, places: NDArray[np.float64], limit: float, material: ElementMaterial | None = None
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    made_of = material or element_material(MaterialField(mesh, TISSUE))
    alive = mesh.element_alive[: mesh.element_rows]
    return pulled_hard(rest(mesh), places, tets_of(mesh), alive, made_of, limit)[:2]


@pytest.mark.parametrize("seed", range(5))
def test_an_organ_that_is_moved_and_turned_has_no_stress(seed: int) -> None:
    mesh = new("shaken")
    turn = Rotation.random(random_state=seed)
    turned = np.add(turn.apply(rest(mesh)), [0.3, -0.2, 0.5])
    rows, stress = over(mesh, turned, 1e-12)
    assert stress.max(initial=0.0) < 1e-6
    lame = np.tile([LAMBDA, MU], (mesh.element_rows, 1))
    state = stresses_of(rest(mesh), turned, tets_of(mesh), lame)
    assert np.abs(state.tensors).max() < 1e-6
    assert len(rows) < mesh.element_rows


@pytest.mark.parametrize("seed", range(5))
def test_a_stretch_has_the_stress_of_the_closed_form_however_the_organ_is_turned(seed: int) -> None:
    """sigma_1 = 2 mu (s_1 - 1) + lambda (s_1 + s_2 + s_3 - 3) along the turned axis of s_1."""
    mesh = new("shaken")
    random = np.random.default_rng(seed)
    stretch = np.sort(random.uniform(0.6, 1.8, 3))[::-1]
    axes = Rotation.random(random_state=seed).as_matrix()
    turn = Rotation.random(random_state=seed + 100).as_matrix()
    gradient = turn @ axes @ np.diag(stretch) @ axes.T
    places = rest(mesh) @ gradient.T
    expected = 2 * MU * (stretch - 1) + LAMBDA * (stretch.sum() - 3)
    lame = np.tile([LAMBDA, MU], (mesh.element_rows, 1))
    state = stresses_of(rest(mesh), places, tets_of(mesh), lame)
    np.testing.assert_allclose(state.largest, expected[0], rtol=1e-9)
    np.testing.assert_allclose(
        np.abs(state.direction @ (turn @ axes[:, 0])), 1.0, atol=1e-9
    )  # fmt: skip
    tensor = turn @ axes @ np.diag(expected) @ axes.T @ turn.T
    np.testing.assert_allclose(state.tensors, np.broadcast_to(tensor, state.tensors.shape),
                               atol=1e-7 * abs(expected).max())  # fmt: skip
    if expected[0] > 0:
        rows, stress = over(mesh, places, 0.999 * expected[0])
        assert len(rows) == mesh.element_rows
        np.testing.assert_allclose(stress, expected[0], rtol=1e-9)
        assert not len(over(mesh, places, 1.001 * expected[0])[0])


def test_a_small_strain_has_the_stress_of_linear_elasticity() -> None:
    """Against scikit-fem: strain and stress of a displacement of any kind, to first order."""
    skfem = pytest.importorskip("skfem")
    from skfem.helpers import sym_grad
    from skfem.models.elasticity import linear_stress

    mesh = new("shaken")
    random = np.random.default_rng(2)
    shift = 1e-9 * random.standard_normal(rest(mesh).shape)
    tets = tets_of(mesh)
    basis = skfem.Basis(
        skfem.MeshTet(rest(mesh).T.copy(), tets.T.astype(np.int64)),
        skfem.ElementVector(skfem.ElementTetP1()), intorder=0,
    )  # fmt: skip
    strain = sym_grad(basis.interpolate(shift.ravel()))
    expected = np.array(linear_stress(LAMBDA, MU)(strain))[:, :, :, 0].transpose(2, 0, 1)
    lame = np.tile([LAMBDA, MU], (len(tets), 1))
    found = stresses_of(rest(mesh), rest(mesh) + shift, tets, lame).tensors
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(8))
def test_the_quick_look_misses_no_element_turned_inside_out_ones_included(seed: int) -> None:
    mesh = new("shaken")
    random = np.random.default_rng(seed)
    size = 10.0 ** random.uniform(-4, -2)
    places = rest(mesh) + size * random.standard_normal(rest(mesh).shape)
    lame = np.tile([LAMBDA, MU], (mesh.element_rows, 1))
    largest = stresses_of(rest(mesh), places, tets_of(mesh), lame).largest
    for limit in np.quantile(largest[largest > 0], [0.0, 0.3, 0.7, 0.99]):
        rows, stress = over(mesh, places, float(limit) * (1 + 1e-6))
        np.testing.assert_array_equal(rows, np.flatnonzero(largest > limit * (1 + 1e-6)))
        np.testing.assert_allclose(stress, largest[rows], rtol=1e-6)


def test_regions_are_as_stiff_as_their_own_material_says() -> None:
    raw = raw_organ("shaken")
    labels = (raw.points[raw.tetrahedra].mean(axis=1)[:, 0] > 0.03).astype(np.int32)
    mesh = Mesh(replace(raw, regions=labels, region_names={0: "soft", 1: "hard"}))
    hard = RegionMaterial("hard", 10 * TISSUE.young_modulus, TISSUE.poisson_ratio, 1000.0)
    material = element_material(MaterialField(mesh, replace(TISSUE, regions=(hard,))))
    rows, stress = over(mesh, rest(mesh) * [1.1, 1.0, 1.0], 1e-3, material)
    assert len(rows) == mesh.element_rows
    np.testing.assert_allclose(stress / stress.min(), np.where(labels == 1, 10.0, 1.0), rtol=1e-9)
