"""Momentum and Chebyshev's method around sweeps: same equilibria, sooner, and never diverging."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from support.elastic_scenes import (
    MATERIAL,
    NO_ROWS,
    apply,
    block_mesh,
    build,
    hold,
    release,
    split_edit,
    steps,
    top_ball,
)
from tissue_sim.elastic import registry
from tissue_sim.elastic.acceleration import Chebyshev
from tissue_sim.elastic.model import Model, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.quasi_static import QuasiStatic
from tissue_sim.elastic.vertex_block_descent import VertexBlockDescent
from tissue_sim.geometry.mesh import Mesh

PULL = np.array([0.002, 0.0, 0.006])
PLAIN = {"momentum": 0.0, "rest_tolerance": 1e-12, "levels": WHOLE_ORGAN}
ACCELERATED = [{"momentum": 0.9}, {"chebyshev": 0.95}]
SWEPT = ["quasi_static", "vertex_block_descent"]


def pulled(
    name: str,
    mesh: Mesh,
    parameters: dict[str, float] | None = None,
    pull: NDArray[np.float64] = PULL,
) -> tuple[Model, State, NDArray[np.int32]]:
    model = registry.build(name, mesh, MATERIAL, {**PLAIN, **(parameters or {})})
    state = State(mesh)
    model.prescribed_changed(state, NO_ROWS)
    held = hold(model, state, top_ball(mesh, 0.018), mesh)
    state.displacement[held] = pull
    return model, state, held


@pytest.mark.parametrize("name", SWEPT)
@pytest.mark.parametrize("parameters", ACCELERATED)
def test_accelerated_sweeps_end_in_the_same_equilibrium_sooner(
    name: str, parameters: dict[str, float]
) -> None:
    mesh = block_mesh(7)
    model, state, _ = pulled(name, mesh, {"momentum": 0.9})
    steps(model, state, 600)
    error = []
    for values in (None, parameters):
        model, other, held = pulled(name, mesh, values)
        steps(model, other, 40)
        error.append(np.abs(other.displacement - state.displacement).max())
    assert error[1] < 0.6 * error[0]
    steps(model, other, 560)
    assert np.abs(other.displacement - state.displacement).max() < 1e-3 * np.linalg.norm(PULL)
    assert (other.displacement[held] == PULL.astype(np.float32)).all()


def test_chebyshev_s_method_is_the_one_of_the_paper() -> None:
    mesh, radius = block_mesh(5), 0.9
    model, state, _ = pulled("vertex_block_descent", mesh, {"chebyshev": radius}, 0.1 * PULL)
    plain, wanted, held = pulled("vertex_block_descent", mesh, None, 0.1 * PULL)
    older, omega = wanted.displacement.copy(), 1.0
    for sweep in range(8):
        before = wanted.displacement.copy()
        # Told of the holds, the plain model sweeps every node.
        plain.prescribed_changed(wanted, held)
        plain.step(wanted)
        if sweep == 1:
            omega = 2.0 / (2.0 - radius**2)
        elif sweep > 1:
            omega = 4.0 / (4.0 - radius**2 * omega)
        free = ~wanted.prescribed
        wanted.displacement[free] = (older + omega * (wanted.displacement - older))[free]
        older = before
        model.step(state)
        np.testing.assert_allclose(state.displacement, wanted.displacement, atol=2e-9)


@pytest.mark.parametrize("name", SWEPT)
@pytest.mark.parametrize("parameters", [{"chebyshev": 0.999, "step": 1.3}, {"momentum": 0.98}])
def test_a_bad_estimate_and_a_fast_hold_do_not_make_sweeps_diverge(
    name: str, parameters: dict[str, float]
) -> None:
    mesh = block_mesh(6)
    model, state, held = pulled(name, mesh, parameters, 0.0 * PULL)
    # A metre a second through the organ and back, four sweeps a frame, and still at last.
    way = np.concatenate([np.linspace(0, 1, 8), np.linspace(1, -1, 16), np.linspace(-1, 0.2, 8)])
    farthest = 0.0
    for share in (*way, *([0.2] * 40)):
        state.displacement[held] = [0.0, 0.0, 0.08 * share]
        steps(model, state, 4)
        farthest = max(farthest, float(np.linalg.norm(state.displacement, axis=1).max()))
    assert farthest < 1.5 * 0.08
    model.prescribed_changed(state, held)
    steps(model, state, 600)
    settled = state.displacement.copy()
    steps(model, state, 10)
    assert np.abs(state.displacement - settled).max() < 1e-5 * 0.08


def test_an_estimate_that_diverges_is_lowered_until_holds_change() -> None:
    mesh = block_mesh(6)
    model, state, held = pulled("vertex_block_descent", mesh, {"chebyshev": 0.999, "step": 1.3})
    assert isinstance(model, VertexBlockDescent)
    method = model.active.chebyshev
    assert isinstance(method, Chebyshev)
    steps(model, state, 150)
    assert method.radius < 0.99
    model.prescribed_changed(state, held)
    assert method.radius == 0.999


@pytest.mark.parametrize("parameters", ACCELERATED)
@pytest.mark.parametrize("change", ["hold", "cut"])
def test_moves_are_forgotten_when_holds_or_the_mesh_change(
    parameters: dict[str, float], change: str
) -> None:
    shapes = []
    for values in (parameters, {"momentum": 0.0, "chebyshev": 0.0}):
        mesh = block_mesh(7)
        model, state, held = pulled("quasi_static", mesh, parameters)
        steps(model, state, 20)
        if not any(values.values()):
            # From the same shape, a model that has never moved.
            model = registry.build("quasi_static", mesh, MATERIAL, {**PLAIN, **parameters})
            model.prescribed_changed(state, held)
        if change == "cut":
            apply(mesh, model, state, split_edit(mesh, 0.03, above=0.035))
        else:
            model.prescribed_changed(state, held)
        model.step(state)
        shapes.append(state.displacement.copy())
    np.testing.assert_array_equal(shapes[0], shapes[1])


@pytest.mark.parametrize("parameters", ACCELERATED)
def test_accelerated_tissue_returns_after_a_release(parameters: dict[str, float]) -> None:
    mesh = block_mesh(6)
    model, state, _ = pulled("quasi_static", mesh, {**parameters, "rest_tolerance": 1e-8})
    steps(model, state, 60)
    release(model, state, mesh)
    steps(model, state, 400)
    assert np.abs(state.displacement).max() < 1e-3 * np.linalg.norm(PULL)


@pytest.mark.parametrize("parameters", ACCELERATED)
def test_time_steps_of_vertex_block_descent_take_either(parameters: dict[str, float]) -> None:
    mesh = block_mesh(5)
    shapes = []
    for values in ({"iterations": 200.0}, {"iterations": 30.0, **parameters}):
        model, state, _ = pulled("vertex_block_descent", mesh, {"dynamic": 1.0, **values})
        steps(model, state, 5)
        shapes.append(state.displacement.copy())
    assert np.abs(shapes[0] - shapes[1]).max() < 2e-3 * np.linalg.norm(PULL)


@pytest.mark.parametrize("parameters", ACCELERATED)
def test_sweeps_that_end_early_cannot_be_accelerated(parameters: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"threshold = 1e-06 m .* allowed with .*: 0"):
        registry.build("quasi_static", block_mesh(3), MATERIAL, {"threshold": 1e-6, **parameters})


def test_without_acceleration_nothing_is_kept() -> None:
    model, _ = build("quasi_static", block_mesh(3), momentum=0.0)
    assert isinstance(model, QuasiStatic)
    assert model.active._acceleration is None
