from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cut_service.crack import on_surface
from cut_service.errors import CutCode, CutError
from cut_service.neighbours import links_of
from cut_service.tearing import Tear, TearError, TearSettings, plan_tear
from cut_service.unswept import work_without_sweep
from support.cut_scenes import SIDE, new, raw_organ, rest
from support.valid_mesh import check_valid
from tissue_sim.elastic.material_field import MaterialField
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.stress import element_material
from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.geometry.surface import surface_triangles

SOFT = Material(young_modulus=5e4, poisson_ratio=0.3)
NO_ONE = np.empty(0, dtype=np.uint32)


def tear(
    mesh: Mesh,
    places: NDArray[np.float64],
    threshold: float,
    held: NDArray[np.uint32] = NO_ONE,
    **how: float,
) -> Tear:
    work = work_without_sweep(mesh, places, held)
    made_of = element_material(MaterialField(mesh, SOFT))
    return plan_tear(work, made_of, TearSettings(threshold, **how))  # type: ignore[arg-type]


def pulled(mesh: Mesh, share: float, axis: int = 0) -> NDArray[np.float64]:
    """A uniaxial pull: sideways the tissue gets thinner, so that it has no stress."""
    stretch = np.full(3, 1.0 - SOFT.poisson_ratio * share)
    stretch[axis] = 1.0 + share
    return rest(mesh) * stretch


def test_nodes_on_the_surface_are_found() -> None:
    mesh = new("shaken")
    nodes = np.arange(mesh.node_rows, dtype=np.int32)
    found = np.zeros(len(nodes), dtype=np.bool_)
    on_surface(links_of(mesh), nodes, found)
    np.testing.assert_array_equal(np.flatnonzero(found), np.unique(surface_triangles(mesh)))


@pytest.mark.parametrize("axis", range(3))
def test_the_faces_that_open_are_perpendicular_to_the_pull(axis: int) -> None:
    """A regular block has faces across every axis: those open before any other."""
    mesh = new("block")
    stress = SOFT.young_modulus * 0.1
    found = tear(mesh, pulled(mesh, 0.1, axis), 0.99 * stress, faces_per_edit=4)
    assert found.over == mesh.element_rows
    assert found.largest == pytest.approx(stress)
    assert found.edit is not None
    assert found.edit.kind == "tear"
    normals = np.cross(
        found.corners[:, 1] - found.corners[:, 0], found.corners[:, 2] - found.corners[:, 0]
    )
    along = np.abs(normals[:, axis]) / np.linalg.norm(normals, axis=1)
    np.testing.assert_allclose(along, 1.0, atol=1e-12)
    before = check_valid(mesh)
    mesh.apply(found.edit)
    after = check_valid(mesh)
    assert after.volume == before.volume
    assert after.surface_triangles == before.surface_triangles + 2 * found.faces


def test_nothing_tears_below_the_threshold_or_without_one() -> None:
    mesh = new("block")
    places = pulled(mesh, 0.1)
    below = tear(mesh, places, 1.01 * SOFT.young_modulus * 0.1)
    assert (below.over, below.edit) == (0, None)
    assert tear(mesh, places, 0.0).edit is None
    assert tear(mesh, rest(mesh), 1.0).over == 0


def test_one_edit_opens_no_more_than_it_may_and_distant_cracks_only() -> None:
    mesh = new("shaken")
    places = pulled(mesh, 0.2)
    few = tear(mesh, places, 100.0, faces_per_edit=1)
    assert 0 < few.faces <= 12
    many = tear(mesh, places, 100.0, faces_per_edit=100)
    assert few.faces < many.faces <= 112


def test_fixed_and_held_nodes_do_not_come_apart_and_it_is_said() -> None:
    raw = raw_organ("block")
    everything = np.ones(len(raw.points), dtype=np.bool_)
    fixed = Mesh(raw, everything)
    found = tear(fixed, pulled(fixed, 0.2), 100.0)
    assert found.edit is None
    assert "fixed or held" in found.why
    mesh = new("block")
    assert tear(mesh, pulled(mesh, 0.2), 100.0, held=mesh.node_ids[: mesh.node_rows]).edit is None
    left = np.flatnonzero(rest(mesh)[:, 0] < 0.5 * SIDE).astype(np.uint32)
    for _ in range(20):
        found = tear(mesh, pulled(mesh, 0.2), 100.0, held=left)
        if found.edit is None:
            break
        assert not np.isin(found.edit.copy_parents, left).any()
        mesh.apply(found.edit)
        check_valid(mesh)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(["shaken", "shell", "wall"]))
def test_hundreds_of_random_tears_keep_the_mesh_valid_and_undo_is_exact(
    seed: int, name: str
) -> None:
    mesh, history = new(name), EditHistory()
    random = np.random.default_rng(seed)
    nodes, elements = mesh.node_rows, mesh.element_rows
    first, at_rest = mesh.tets[:elements].copy(), rest(mesh).copy()
    volume = check_valid(mesh).volume
    made = 0
    for _ in range(15):
        gradient = np.eye(3) + random.uniform(-0.3, 0.3, (3, 3))
        size = float(np.ptp(rest(mesh), axis=0).max())
        places = rest(mesh) @ gradient.T + 0.01 * size * random.standard_normal(rest(mesh).shape)
        found = tear(
            mesh, places, random.uniform(100.0, 1e4), faces_per_edit=int(random.integers(1, 60)),
            smallest_piece=int(random.integers(1, 8)), pull_share=random.uniform(0.0, 1.0),
            spacing=random.uniform(0.0, 6.0),
        )  # fmt: skip
        if found.edit is None:
            continue
        history.record(mesh.apply(found.edit))
        made += 1
        if made % 5 == 0 and name == "shaken":
            check_valid(mesh)
    assert check_valid(mesh).volume == pytest.approx(volume, rel=1e-12)
    assert made > 5
    for _ in range(made):
        history.record(mesh.apply(history.undo(mesh, "", "")))
    assert not mesh.node_alive[nodes : mesh.node_rows].any()
    np.testing.assert_array_equal(mesh.tets[:elements], first)
    np.testing.assert_array_equal(mesh.rest[:nodes], at_rest)


def test_pieces_of_a_few_elements_are_not_torn_off() -> None:
    mesh = new("shaken")
    for _ in range(40):
        found = tear(mesh, pulled(mesh, 0.3), 100.0, smallest_piece=5, spacing=0.0)
        if found.edit is None:
            break
        mesh.apply(found.edit)
    rows = mesh.element_rows
    count, label = connected_components(mesh.tets[:rows], mesh.element_alive[:rows], mesh.node_rows)
    sizes = np.bincount(label[mesh.tets[:rows, 0]])
    assert sizes[sizes > 0].min() >= 5
    assert count == (sizes > 0).sum()


@pytest.mark.parametrize(
    ("name", "value"),
    [("threshold", -1.0), ("threshold", np.nan), ("threshold", np.inf), ("faces_per_edit", 0),
     ("pull_share", 2.0), ("pull_share", -0.1), ("spacing", np.nan), ("smallest_piece", 0)],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(name: str, value: float) -> None:
    with pytest.raises(TearError, match=rf"{name} = .* is not allowed; allowed: "):
        replace(TearSettings(), **{name: value})  # type: ignore[arg-type]


def test_shapes_that_do_not_fit_are_refused() -> None:
    mesh = new("block")
    with pytest.raises(CutError, match=r"positions of .* nodes wanted") as wrong:
        work_without_sweep(mesh, rest(mesh)[:-1])
    assert wrong.value.code == CutCode.NO_TISSUE
    broken = rest(mesh).copy()
    broken[3, 1] = np.nan
    with pytest.raises(CutError, match="not finite"):
        work_without_sweep(mesh, broken)


def test_a_block_of_one_element_has_nothing_to_tear() -> None:
    mesh = Mesh(block(2, 2, 2, 0.01, 0.01, 0.01))
    found = tear(mesh, pulled(mesh, 0.5), 100.0, smallest_piece=10)
    assert found.edit is None
    assert found.why
