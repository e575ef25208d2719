"""Patches in every model: free, carried, sewn on, and of a material of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import skfem
from numpy.typing import NDArray
from skfem.helpers import ddot, sym_grad, trace

from support.cut_sheets import assert_as_built_afresh
from support.elastic_scenes import (
    MATERIAL,
    NO_ROWS,
    VARIANTS,
    apply,
    ball,
    build,
    hold,
    release,
    settle,
    steps,
)
from support.patches import SOFT, patch_edit
from support.sewn_blocks import sew_edit, tighten_edit
from support.sheets import WITH_TORSION, connected, sheet_mesh, strip
from tissue_sim.elastic import registry
from tissue_sim.elastic.material_field import MaterialField, lame_constants
from tissue_sim.elastic.model import Material, Model, RegionMaterial, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.geometry.sutures import tensions

ABOVE = (0.0, 0.0, 0.009)
"""Where free patches lie: 3 mm above the block [m]."""

BEYOND_LINEAR = {"finite_element", "chain_mail", "voxel_chain_mail"}
"""Variants that turn turned tissue back, or swell it, as is documented."""

IN_BALANCE = (
    "quasi_static", "spring_mass", "vertex_block_descent", "dynamic vertex_block_descent",
    "finite_element", "corotated",
)  # fmt: skip

SHEET_MODELS = ("quasi_static", "lr", "spring_mass", "relaxation", "chain_mail")


def organ() -> Mesh:
    """A block of 12 x 9 x 6 mm that is fixed at its bottom, nodes 3 mm apart."""
    raw = block(5, 4, 3, 0.012, 0.009, 0.006)
    return Mesh(raw, raw.points[:, 2] < 1e-9)


def built(variant: str, mesh: Mesh, **values: float) -> tuple[Model, State]:
    name, parameters = VARIANTS[variant]
    model, state = registry.build(name, mesh, MATERIAL, {**parameters, **values}), State(mesh)
    model.prescribed_changed(state, NO_ROWS)
    return model, state


def patched(variant: str) -> tuple[Mesh, Model, State, NDArray[np.int32]]:
    """The organ with a free patch above it, a model that followed, and the patch's nodes."""
    mesh = organ()
    count = mesh.node_rows
    model, state = built(variant, mesh)
    apply(mesh, model, state, patch_edit(mesh, ABOVE))
    return mesh, model, state, np.arange(count, mesh.node_rows, dtype=np.int32)


def turned(points: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Points turned about an axis along y through their middle, and lifted by 2 mm."""
    c, s = np.cos(angle), np.sin(angle)
    middle = points.mean(axis=0)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return np.asarray((points - middle) @ turn.T + middle + np.array([0.0, 0.0, 0.002]))


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_free_patch_stays_while_the_organ_is_pulled(variant: str) -> None:
    mesh, model, state, patch = patched(variant)
    held = hold(model, state, ball(mesh, np.array([0.006, 0.0045, 0.006]), 0.002), mesh)
    for _ in range(20):
        state.displacement[held] += np.array([0.0, 0.0, 5e-5], dtype=np.float32)
        steps(model, state, 5)
    release(model, state, mesh)
    steps(model, state, 100)
    assert not state.displacement[patch].any()
    assert np.isfinite(state.displacement).all()


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_patch_stays_where_it_was_carried(variant: str) -> None:
    mesh, model, state, patch = patched(variant)
    hold(model, state, patch, mesh)
    start, angle = mesh.rest[patch], 0.0 if variant in BEYOND_LINEAR else 0.6
    for k in range(1, 11):
        at = turned(start, angle * k / 10) - start
        state.displacement[patch] = state.previous[patch] = at
        steps(model, state, 5)
    release(model, state, mesh)
    before = state.displacement[patch].copy()
    steps(model, state, 200)
    np.testing.assert_allclose(state.displacement[patch], before, atol=2e-6)
    assert not state.displacement[: patch[0]].any()


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_free_patch_that_was_bent_comes_to_rest_and_does_not_drift(variant: str) -> None:
    mesh, model, state, patch = patched(variant)
    edge = patch[mesh.rest[patch, 0] < 1e-9]
    held = hold(model, state, edge, mesh)
    for _ in range(10):
        state.displacement[held] += np.array([0.0, 0.0, 1e-4], dtype=np.float32)
        steps(model, state, 10)
    release(model, state, mesh)
    settle(model, state)
    assert np.abs(state.displacement[patch]).max() < 0.003
    before = state.displacement[patch].mean(axis=0, dtype=np.float64)
    steps(model, state, 200)
    after = state.displacement[patch].mean(axis=0, dtype=np.float64)
    np.testing.assert_allclose(after, before, atol=2e-6)
    if variant in ("finite_element", "corotated"):
        assert model.idle


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_patch_let_go_while_the_organ_is_held_stays_when_that_is_pulled_on(variant: str) -> None:
    mesh, model, state, patch = patched(variant)
    organ = ball(mesh, np.array([0.006, 0.0045, 0.006]), 0.002)
    held = hold(model, state, [*organ, *patch], mesh)
    for _ in range(10):
        state.displacement[held] += np.array([0.0, 0.0, 1e-4], dtype=np.float32)
        state.previous[patch] = state.displacement[patch]
        steps(model, state, 5)
    hold(model, state, organ, mesh)
    before = state.displacement[patch].copy()
    for _ in range(10):
        state.displacement[organ] += np.array([0.0, 0.0, 1e-4], dtype=np.float32)
        steps(model, state, 5)
    # Voxels that carry little of held nodes lag behind, and then pull the others back a little.
    allowed = 1e-5 if variant == "voxel_chain_mail" else 2e-6
    np.testing.assert_allclose(state.displacement[patch], before, atol=allowed)


def sewn(variant: str) -> tuple[Mesh, Model, State, NDArray[np.int32]]:
    """A patch sewn to the block's top along its two short edges, and the middle of it."""
    mesh = organ()
    model, state = built(variant, mesh)
    apply(mesh, model, state, patch_edit(mesh, (0.0, 0.0, 0.0065)))
    rest = mesh.rest[: mesh.node_rows]

    def edges(z: float) -> NDArray[np.int64]:
        x = rest[:, 0]
        rows = np.flatnonzero(np.isclose(rest[:, 2], z) & ((x < 1e-9) | (x > 0.012 - 1e-9)))
        return rows[np.lexsort((rest[rows, 1], rest[rows, 0]))]

    apply(mesh, model, state, sew_edit(mesh, edges(0.0065), edges(0.006)))
    middle = np.isclose(rest[:, 0], 0.006) & (rest[:, 2] > 0.0061)
    return mesh, model, state, np.flatnonzero(middle).astype(np.int32)


def pulled(
    variant: str,
) -> tuple[Mesh, Model, State, NDArray[np.int32], NDArray[np.float64]]:
    """A sewn patch whose middle is pulled by a millimetre, at rest: the held rows, the threads."""
    mesh, model, state, middle = sewn(variant)
    held = hold(model, state, middle, mesh)
    for _ in range(10):
        state.displacement[held] += np.array([0.0, 0.0, 1e-4], dtype=np.float32)
        steps(model, state, 10)
    settle(model, state)
    at = mesh.rest[: mesh.node_rows] + state.displacement[: mesh.node_rows]
    a, b = mesh.sutures.nodes.T
    return mesh, model, state, held, at[b] - at[a]


@pytest.mark.parametrize("variant", IN_BALANCE)
def test_forces_of_a_patch_that_is_sewn_on_and_pulled_are_in_balance(variant: str) -> None:
    mesh, model, state, held, threads = pulled(variant)
    along = threads / np.linalg.norm(threads, axis=1)[:, None]
    pull = (tensions(mesh.sutures, mesh.rest, state.displacement)[:, None] * along).sum(axis=0)
    fixed = np.flatnonzero(mesh.fixed[: mesh.node_rows]).astype(np.int32)
    tool, base = (model.forces(state, rows).sum(axis=0) for rows in (held, fixed))
    assert tool[2] < -0.02
    np.testing.assert_allclose(tool, pull, atol=5e-3 * np.abs(tool).max())
    np.testing.assert_allclose(base, -pull, atol=5e-3 * np.abs(tool).max())


@pytest.mark.parametrize("variant", ["relaxation", "chain_mail", "voxel_chain_mail", "lr"])
def test_a_patch_that_is_sewn_on_takes_its_stitches_along(variant: str) -> None:
    _mesh, _model, state, _held, threads = pulled(variant)
    assert np.linalg.norm(threads, axis=1).max() < 5e-5
    assert np.isfinite(state.displacement).all()


@pytest.mark.parametrize("variant", IN_BALANCE)
def test_a_patch_on_slack_threads_stays_when_it_is_let_go_and_is_pulled_by_taut_ones(
    variant: str,
) -> None:
    mesh, model, state, patch = patched(variant)
    rest = mesh.rest[: mesh.node_rows]
    rows = [np.flatnonzero(np.isclose(rest[:, 2], z)) for z in (0.009, 0.006)]
    low, top = (row[np.lexsort((rest[row, 1], rest[row, 0]))] for row in rows)
    apply(mesh, model, state, sew_edit(mesh, low, top, 0.005))
    held = hold(model, state, patch[np.isclose(rest[patch, 0], 0.0)], mesh)
    for _ in range(10):
        state.displacement[held] += np.array([0.0, 0.0, 5e-5], dtype=np.float32)
        steps(model, state, 20)
    before = state.displacement[patch].mean(axis=0, dtype=np.float64)
    release(model, state, mesh)
    settle(model, state)
    after = state.displacement[patch].mean(axis=0, dtype=np.float64)
    np.testing.assert_allclose(after, before, atol=2e-4)
    assert model.residual(state) < 1e-3
    assert not state.displacement[top].any()
    apply(mesh, model, state, tighten_edit(mesh, 0.001))
    settle(model, state, 80)
    at = mesh.rest[: mesh.node_rows] + state.displacement[: mesh.node_rows]
    a, b = mesh.sutures.nodes.T
    assert np.linalg.norm(at[b] - at[a], axis=1).max() < 0.00105


@pytest.mark.parametrize("variant", IN_BALANCE)
def test_a_model_that_followed_has_the_forces_of_one_built_afresh(variant: str) -> None:
    mesh, model, state, patch = patched(variant)
    fresh, _ = built(variant, mesh)
    shape = np.random.default_rng(4).normal(0.0, 2e-4, (mesh.node_rows, 3))
    state.displacement[: mesh.node_rows] = shape
    for each in (model, fresh):
        each.prescribed_changed(state, NO_ROWS)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    force = fresh.forces(state, rows)
    np.testing.assert_allclose(model.forces(state, rows), force, atol=1e-5 * np.abs(force).max())
    assert np.abs(force[patch]).max() > 0.0


@pytest.mark.parametrize("variant", IN_BALANCE)
def test_an_organ_held_with_its_patch_moves_as_in_a_model_built_afresh(variant: str) -> None:
    values = {"time_step": 1e-4, "mass_scaling": 1.0} if variant == "spring_mass" else {}
    mesh = organ()
    model, state = built(variant, mesh, **values)
    apply(mesh, model, state, patch_edit(mesh, ABOVE))
    fresh, other = built(variant, mesh, **values)
    x = mesh.rest[: mesh.node_rows, 0]
    above = mesh.rest[: mesh.node_rows, 2] > 0.0089
    ends = np.flatnonzero(above & ((x < 1e-9) | (x > 0.012 - 1e-9)))
    for each, shape in ((model, state), (fresh, other)):
        held = hold(each, shape, ends, mesh)
        right = held[mesh.rest[held, 0] > 0.006]
        shape.displacement[right] += np.array([3e-4, 0.0, 0.0], dtype=np.float32)
        settle(each, shape, 20)
    np.testing.assert_allclose(state.displacement, other.displacement, atol=3e-6)


@pytest.mark.parametrize("variant", IN_BALANCE)
def test_an_undone_patch_leaves_forces_as_they_were_bit_for_bit(variant: str) -> None:
    mesh, history = organ(), EditHistory()
    model, state = built(variant, mesh)
    rows = np.arange(mesh.node_rows, dtype=np.int32)
    shape = np.random.default_rng(5).normal(0.0, 2e-4, (len(rows), 3)).astype(np.float32)

    def forces(rows: NDArray[np.int32]) -> NDArray[np.float64]:
        state.displacement[: len(shape)] = shape
        model.prescribed_changed(state, NO_ROWS)
        return model.forces(state, rows)

    def follow(number: int) -> None:
        plan = (patch_edit(mesh, ABOVE), None, None)[number]
        made = plan or (history.undo(mesh) if number == 1 else history.redo(mesh))
        change = mesh.apply(made)
        history.record(change)
        state.follow(mesh, change)
        model.topology_changed(change, state)

    before = forces(rows)
    follow(0)
    everything = np.arange(mesh.node_rows, dtype=np.int32)
    bent = np.random.default_rng(6).normal(0.0, 2e-4, (len(everything) - len(rows), 3))
    state.displacement[len(rows) : mesh.node_rows] = bent
    with_patch = forces(everything)
    np.testing.assert_array_equal(with_patch[: len(rows)], before)
    follow(1)
    np.testing.assert_array_equal(forces(rows), before)
    follow(2)
    assert not state.displacement[len(rows) : mesh.node_rows].any()
    state.displacement[len(rows) : mesh.node_rows] = bent
    np.testing.assert_array_equal(forces(everything), with_patch)


def stretched(young_modulus: float) -> tuple[NDArray[np.float64], float, float]:
    """Shape and pull [N] of a patch whose ends are held 0.3 mm further apart; scikit-fem's pull."""
    mesh = organ()
    first = mesh.node_rows
    model, state = build("finite_element", mesh, tolerance=1e-8)
    apply(
        mesh, model, state,
        patch_edit(mesh, ABOVE, patch=replace(SOFT, young_modulus=young_modulus)),
    )  # fmt: skip
    patch = np.arange(first, mesh.node_rows)
    x = mesh.rest[patch, 0]
    held = hold(model, state, patch[(x < 1e-9) | (x > 0.012 - 1e-9)], mesh)
    right = held[mesh.rest[held, 0] > 0.006]
    state.displacement[right, 0] = 3e-4
    settle(model, state)
    pull = float(model.forces(state, right)[:, 0].sum())
    return state.displacement[patch].copy(), pull, by_scikit_fem(mesh, first, young_modulus)


def by_scikit_fem(mesh: Mesh, first: int, young_modulus: float) -> float:
    """Force [N] along x that the elements of nodes from `first` on pull their right end with."""
    tets = mesh.tets[: mesh.element_rows]
    tets = tets[tets[:, 0] >= first] - first
    points = mesh.rest[first : mesh.node_rows]
    shape = skfem.MeshTet(points.T.copy(), tets.T.astype(np.int64).copy())
    basis = skfem.Basis(shape, skfem.ElementVector(skfem.ElementTetP1()))
    lam, mu = lame_constants(replace(MATERIAL, young_modulus=young_modulus))

    @skfem.BilinearForm
    def form(u, v, _):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
        e, d = sym_grad(u), sym_grad(v)
        return lam * trace(e) * trace(d) + 2.0 * mu * ddot(e, d)

    K = form.assemble(basis)
    x = points[:, 0]
    u = np.zeros(3 * len(points))
    right = 3 * np.flatnonzero(x > 0.012 - 1e-9)
    u[right] = 3e-4
    given = np.flatnonzero((x < 1e-9) | (x > 0.012 - 1e-9))
    fixed = (3 * given[:, None] + np.arange(3)).ravel()
    u = skfem.solve(*skfem.condense(K, x=u, D=fixed))
    return float(-(K @ u)[right].sum())


def test_a_patch_twice_as_stiff_pulls_twice_as_hard_and_as_scikit_fem_says() -> None:
    soft, pull, expected = stretched(1e5)
    stiff, twice, double = stretched(2e5)
    assert pull == pytest.approx(expected, rel=2e-4)
    assert twice == pytest.approx(double, rel=2e-4)
    assert twice == pytest.approx(2.0 * pull, rel=2e-4)
    np.testing.assert_allclose(soft, stiff, atol=1e-7)


@pytest.mark.parametrize("variant", IN_BALANCE)
def test_the_material_of_a_patch_counts_in_every_model_with_forces(variant: str) -> None:
    pulls = []
    for factor in (1.0, 2.0):
        mesh = organ()
        model, state = built(variant, mesh)
        first = mesh.node_rows
        stiff = replace(SOFT, young_modulus=factor * SOFT.young_modulus)
        apply(mesh, model, state, patch_edit(mesh, ABOVE, patch=stiff))
        patch = np.arange(first, mesh.node_rows, dtype=np.int32)
        model.prescribed_changed(state, NO_ROWS)
        state.displacement[patch] = 0.02 * (mesh.rest[patch] - mesh.rest[patch].mean(axis=0))
        model.prescribed_changed(state, NO_ROWS)
        pulls.append(model.forces(state, patch))
    assert np.abs(pulls[0]).max() > 0.0
    np.testing.assert_allclose(2.0 * pulls[0], pulls[1], atol=1e-5 * np.abs(pulls[1]).max())


def test_the_material_of_regions_stays_with_patches_added_and_taken_back() -> None:
    mesh, history = organ(), EditHistory()
    mesh.regions[:20] = 3
    mesh.region_names[3] = "septum"
    septum = RegionMaterial("septum", 1e5, 0.3, 1200.0)
    field = MaterialField(mesh, Material(regions=(septum,)))
    rows = np.arange(mesh.element_rows, dtype=np.int32)

    def follow(made: str) -> None:
        edit = patch_edit(mesh, ABOVE) if made == "patch" else getattr(history, made)(mesh)
        change = mesh.apply(edit)
        history.record(change)
        field.follow(change)

    for made, patches in (("patch", 1), ("patch", 2), ("undo", 1), ("undo", 0), ("redo", 1)):
        follow(made)
        fresh = MaterialField(mesh, Material(regions=(septum,)))
        living = np.flatnonzero(mesh.element_alive[: mesh.element_rows]).astype(np.int32)
        np.testing.assert_array_equal(field.stiffness_of(living), fresh.stiffness_of(living))
        np.testing.assert_array_equal(field.density_of(living), fresh.density_of(living))
        assert (field.stiffness_of(rows[:20]) == 2.0).all()
        assert (field.stiffness_of(living) == 4.0).sum() == 72 * patches
        assert not field.one_modulus
        assert not field.one_ratio


def sheets(kind: str) -> tuple[Mesh, bool]:
    """A sheet with torsion springs, and whether a patch on it has one sheet only."""
    if kind == "connected surfaces":
        return connected(WITH_TORSION, fixed=True), False
    raw = strip(6, 5)
    return sheet_mesh(raw, WITH_TORSION, thickness=0.001, fixed=raw.points[:, 1] < 1e-9), True


@pytest.mark.parametrize("kind", ["connected surfaces", "single surface"])
def test_springs_and_torsion_of_a_patch_of_sheets_are_as_built_afresh(kind: str) -> None:
    mesh, single = sheets(kind)
    network = SpringNetwork(mesh, MATERIAL, np.float64)
    assert network.torsion is not None
    network.follow(mesh.apply(patch_edit(mesh, (0.0, 0.0, 0.03), single=single)))
    assert_as_built_afresh(network)
    stiff = network.torsion.stiffness[(network.torsion.nodes >= network.mesh.node_rows - 20).any(1)]
    rigidity = SOFT.young_modulus / (12.0 * (1.0 - MATERIAL.poisson_ratio**2))
    assert stiff.max() > rigidity * (SOFT.thickness / 2.0) ** 3


@pytest.mark.parametrize("name", SHEET_MODELS)
@pytest.mark.parametrize("kind", ["connected surfaces", "single surface"])
def test_a_free_patch_of_sheets_stays_where_it_was_carried(kind: str, name: str) -> None:
    mesh, single = sheets(kind)
    first = mesh.node_rows
    model, state = build(name, mesh)
    apply(mesh, model, state, patch_edit(mesh, (0.0, 0.0, 0.03), single=single))
    patch = np.arange(first, mesh.node_rows, dtype=np.int32)
    steps(model, state, 20)
    assert not state.displacement.any()
    hold(model, state, patch, mesh)
    state.displacement[patch] = state.previous[patch] = [0.002, 0.0, 0.003]
    steps(model, state, 20)
    release(model, state, mesh)
    before = state.displacement[patch].copy()
    # Longer than sheets are left to their springs before they are led home.
    steps(model, state, 400)
    np.testing.assert_allclose(state.displacement[patch], before, atol=1e-6)


def test_a_mesh_with_a_patch_refuses_what_precomputes() -> None:
    mesh = organ()
    mesh.apply(patch_edit(mesh, ABOVE))
    for parameters in ({"direct": 1.0}, {"interest_radius": 0.01, "interest_x": 0.006}):
        with pytest.raises(ValueError, match="fixed"):
            registry.build("finite_element", mesh, MATERIAL, parameters)
