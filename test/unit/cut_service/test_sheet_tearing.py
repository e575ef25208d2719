"""Tears of surfaces and connected surfaces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cut_service.errors import CutError
from cut_service.sheet_tearing import SheetTearSettings, plan_sheet_tear
from cut_service.tearing import Tear, TearError
from cut_service.work import Settings
from support.cut_scenes import new, rest
from support.cut_sheets import assert_as_built_afresh, assert_valid
from support.sheets import connected, lattice, sheet_mesh
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh

ORGANS: dict[str, Callable[[], Mesh]] = {
    "surface": lambda: sheet_mesh(lattice(9, 9)),
    "connected": connected,
}


def tear(
    mesh: Mesh, stretch: list[float], elongation: float, held: list[int] | None = None
) -> Tear:
    places = mesh.rest[: mesh.node_rows] * stretch
    nodes = np.array(held or [], dtype=np.uint32)
    return plan_sheet_tear(mesh, places, SheetTearSettings(elongation), Settings(), nodes)


@pytest.mark.parametrize("name", list(ORGANS))
def test_stretched_surfaces_tear_and_undo_is_exact(name: str) -> None:
    mesh, history = ORGANS[name](), EditHistory()
    network = SpringNetwork(mesh, Material())
    nodes, elements = mesh.node_rows, mesh.element_rows
    before = mesh.tets[:elements].copy()
    for _ in range(6):
        found = tear(mesh, [1.5, 1.0, 1.0], 0.3)
        assert found.largest == pytest.approx(0.5, abs=0.05)
        assert found.over > 0
        if found.edit is None:
            break
        assert found.edit.kind == "tear"
        assert found.faces > 0
        assert not len(found.edit.moved_nodes)
        change = mesh.apply(found.edit)
        history.record(change)
        network.follow(change)
        assert_valid(mesh)
        assert_as_built_afresh(network)
    assert history.done
    while history.done:
        change = mesh.apply(history.undo(mesh))
        history.record(change)
        network.follow(change)
    assert not mesh.node_alive[nodes : mesh.node_rows].any()
    np.testing.assert_array_equal(mesh.tets[:elements], before)
    assert_as_built_afresh(network)


def test_the_edges_that_part_run_across_the_pull() -> None:
    mesh = ORGANS["surface"]()
    found = tear(mesh, [1.5, 1.0, 1.0], 0.3)
    assert found.edit is not None
    # As a chain: however it zigzags, it runs a long way along y and returns to where it began in x.
    ends = found.corners[:, :2].reshape(-1, 3)
    assert np.ptp(ends[:, 1]) > 2.0 * np.ptp(ends[:, 0])


def test_surfaces_bear_what_they_may_and_do_not_tear_where_they_are_held() -> None:
    mesh = ORGANS["surface"]()
    assert tear(mesh, [1.5, 1.0, 1.0], 0.6).edit is None
    assert tear(mesh, [1.5, 1.0, 1.0], 0.0).edit is None
    found = tear(mesh, [1.5, 1.0, 1.0], 0.3, held=list(range(mesh.node_rows)))
    assert found.edit is None
    assert "fixed or held" in found.why


@pytest.mark.parametrize("elongation", [-0.1, np.nan, np.inf, 1e6])
def test_elongations_that_make_no_sense_are_refused(elongation: float) -> None:
    with pytest.raises(TearError, match=r"elongation = .* is not allowed; allowed: 0 to 1000"):
        SheetTearSettings(elongation)


def test_tetrahedra_are_refused() -> None:
    mesh = new("block")
    with pytest.raises(CutError, match="not made of triangles"):
        plan_sheet_tear(mesh, rest(mesh), SheetTearSettings(0.1), Settings())
