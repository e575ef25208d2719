"""A patch sewn in by one request closes a hole, in the models that operations are done with."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cut_service.rim import plan_rim
from cut_service.suturing import Sewing
from support.elastic_scenes import MATERIAL, NO_ROWS, VARIANTS, apply
from support.holed_wall import TOP, add_patch, edge, holed_wall
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import State
from tissue_sim.geometry.holes import name_hole

STEPS = 300


@pytest.mark.parametrize("variant", ["lr", "finite_element", "vertex_block_descent"])
def test_threads_draw_the_rim_onto_the_edge_all_around(variant: str) -> None:
    mesh = holed_wall(fixed=True)
    hole = name_hole(mesh, mesh.rest[: mesh.node_rows], "window", edge(TOP))
    add_patch(mesh, size=0.012, above=0.001)
    (patch,) = mesh.patches
    name, parameters = VARIANTS[variant]
    model = registry.build(name, mesh, MATERIAL, dict(parameters))
    state = State(mesh)
    model.prescribed_changed(state, NO_ROWS)

    def places() -> NDArray[np.float64]:
        return np.asarray(mesh.rest[: mesh.node_rows] + state.displacement[: mesh.node_rows])

    before = hole.closure(mesh, places())
    assert before.edge_gap == pytest.approx(0.001, rel=1e-3)
    loop = hole.loop(mesh, places())
    wanted = Sewing(loop, spacing=0.0025, length=0.0)
    apply(mesh, model, state, plan_rim(mesh, places(), patch, wanted))
    for _ in range(STEPS):
        model.step(state)
        if model.idle:
            break
    ends = places()[mesh.sutures.nodes]
    left = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert left.max() < 0.0003
    after = hole.closure(mesh, places())
    assert after.covered == pytest.approx(1.0, abs=1e-3)
    assert after.gap < 0.0005
    # Between stitches the patch, which is wider than the hole, stands up a little.
    assert after.edge_gap < 0.0009
