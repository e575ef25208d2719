"""Every elastic model goes on after a cut that divides elements or removes some."""

from __future__ import annotations

import numpy as np
import pytest

from cut_service.planner import plan
from support.cut_scenes import square
from support.elastic_scenes import VARIANTS, apply, block_mesh, build, hold, steps
from support.valid_mesh import check_valid
from tissue_sim.elastic import registry

ALL = registry.names()


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("method", ["subdivide", "remove"])
def test_rest_stays_rest_through_a_cut(name: str, method: str) -> None:
    mesh = block_mesh(5)
    model, state = build(name, mesh)
    sweep = square(np.array([0.034, 0.031, 0.06]), np.array([1.0, 0.1, 0.1]), 0.035)
    apply(mesh, model, state, plan(mesh, state.positions(mesh), sweep, method).edit)
    check_valid(mesh)
    steps(model, state, 20)
    # New nodes lie on their edges to within rounding.
    assert np.abs(state.displacement).max() < 1e-7


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_stretched_block_steps_on_and_opens(variant: str) -> None:
    name, parameters = VARIANTS[variant]
    mesh = block_mesh(5)
    model, state = build(name, mesh, None, None, **parameters)
    x, z = mesh.rest[: mesh.node_rows, 0], mesh.rest[: mesh.node_rows, 2]
    left, right = np.flatnonzero((z > 0.059) & (x < 0.01)), np.flatnonzero((z > 0.059) & (x > 0.05))
    hold(model, state, [*left, *right], mesh)
    per_frame = 4 if model.time_step is None else round(1 / 60 / model.time_step)
    for frame in range(1, 16):
        state.displacement[left] = [-0.0003 * frame, 0, 0]
        state.displacement[right] = [0.0003 * frame, 0, 0]
        steps(model, state, per_frame)
    sweep = square(np.array([0.034, 0.031, 0.06]), np.array([1.0, 0.1, 0.1]), 0.035)
    edit = plan(mesh, state.positions(mesh), sweep, "subdivide").edit
    first = mesh.node_rows
    apply(mesh, model, state, edit)
    check_valid(mesh)
    lips = np.arange(first, mesh.node_rows)
    together = {tuple(place) for place in mesh.rest[lips]}
    assert len(together) < len(lips)  # some are copies of the same place
    steps(model, state, 30 * per_frame)
    assert np.isfinite(state.displacement).all()
    assert np.abs(state.displacement).max() < 0.02
    opening = [
        np.ptp(state.displacement[lips[(mesh.rest[lips] == place).all(axis=1)]], axis=0).max()
        for place in together
    ]
    assert max(opening) > 0.001
