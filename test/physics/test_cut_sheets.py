"""Cut surfaces in the models: they go on, the cut opens when pulled, and closes when let go."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from cut_service.planner import plan
from support.cut_sheets import assert_valid, square
from support.elastic_scenes import apply, build, hold, release, steps
from support.sheets import WITH_TORSION, ball, connected, sheet_mesh
from tissue_sim.geometry.mesh import Mesh

ON_SHEETS = ("quasi_static", "lr", "relaxation", "spring_mass", "chain_mail")
PULL = 0.003
STEPS = {"spring_mass": 600}


def organ(kind: str) -> Mesh:
    if kind == "connected_surfaces":
        return connected(fixed=True)
    raw = ball()
    return sheet_mesh(raw, WITH_TORSION, fixed=raw.points[:, 2] < -0.012)


class Opening(NamedTuple):
    """By how much more the pulled lip has moved than the other, how far that one has, and what is
    left of the largest displacement after letting go [m]."""

    gap: float
    dragged: float
    left: float


def opened_by_a_pull(name: str, kind: str, cut: bool) -> Opening:
    mesh = organ(kind)
    model, state = build(name, mesh)
    points = mesh.rest[: mesh.node_rows]
    lip = (points[:, 2] > 0.013) & (np.abs(points[:, 1]) < 0.006)
    one = np.flatnonzero(lip & (points[:, 0] > 0.003) & (points[:, 0] < 0.008))
    other = np.flatnonzero(lip & (points[:, 0] < -0.003) & (points[:, 0] > -0.008))
    held = hold(model, state, one, mesh)
    state.displacement[held] = [0.2 * PULL, 0.0, 0.0]
    steps(model, state, 20)
    if cut:
        ahead = points + state.displacement[: mesh.node_rows]
        sweep = square(np.array([0.0013, 0.0, 0.018]), 0.013 * np.eye(3)[1], 0.008 * np.eye(3)[2])
        apply(mesh, model, state, plan(mesh, ahead, sweep).edit)
        assert_valid(mesh)
    for share in np.linspace(0.2, 1.0, 9):
        state.displacement[held] = [share * PULL, 0.0, 0.0]
        steps(model, state, STEPS.get(name, 200) // 10)
    steps(model, state, STEPS.get(name, 400))
    assert np.isfinite(state.displacement[: mesh.node_rows]).all()
    far = np.linalg.norm(state.displacement[: mesh.node_rows], axis=1).max()
    assert far < 3.0 * PULL
    gap = float(state.displacement[one, 0].mean() - state.displacement[other, 0].mean())
    dragged = float(state.displacement[other, 0].mean())
    release(model, state, mesh)
    steps(model, state, 3 * STEPS.get(name, 400))
    left = float(np.linalg.norm(state.displacement[: mesh.node_rows], axis=1).max())
    return Opening(gap, dragged, left)


@pytest.mark.parametrize("kind", ["surface", "connected_surfaces"])
@pytest.mark.parametrize("name", ON_SHEETS)
def test_a_cut_sheet_opens_when_pulled_and_closes_when_let_go(name: str, kind: str) -> None:
    whole, parted = (opened_by_a_pull(name, kind, cut) for cut in (False, True))
    assert parted.gap > whole.gap + 0.15 * PULL
    assert parted.dragged < 0.7 * whole.dragged
    # Relaxation knows lengths alone, and leaves a surface dented whether it was cut or not.
    assert parted.left < (1.5e-3 + whole.left if name == "relaxation" else 1e-6)
