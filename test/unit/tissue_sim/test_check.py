"""What `check.mend` mends, and what it refuses and how it says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tissue_sim.geometry.check import inspect, mend
from tissue_sim.geometry.errors import MeshError
from tissue_sim.geometry.faces import face_nodes, pair_faces
from tissue_sim.geometry.formats import load
from tissue_sim.geometry.quality import radius_ratios, signed_volumes
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block
from tissue_sim.geometry.winding import surface_tree, winding_numbers

BLOCK = block(4, 4, 4, 0.03, 0.03, 0.03)
CORNER = RawMesh(np.vstack([np.zeros(3), 0.02 * np.eye(3)]), np.array([[0, 1, 2, 3]]))
VOLUME = 0.03**3


def with_more(
    raw: RawMesh, points: list[list[float]] | np.ndarray, tets: list[list[int]]
) -> RawMesh:
    return replace(
        raw,
        points=np.vstack([raw.points, np.reshape(points, (-1, 3))]),
        tetrahedra=np.vstack([raw.tetrahedra, np.reshape(tets, (-1, 4)).astype(np.int64)]),
        regions=np.empty(0, dtype=np.int32),
    )


def test_a_clean_mesh_is_left_as_it_is() -> None:
    raw, report = mend(BLOCK)
    assert np.array_equal(raw.tetrahedra, BLOCK.tetrahedra)
    assert np.array_equal(raw.points, BLOCK.points)
    assert not report.mended
    assert not report.warnings
    assert report.volume == pytest.approx(VOLUME)
    assert report.part_sizes == (64,)
    assert inspect(BLOCK) == report


def test_a_regular_tetrahedron_has_quality_one_and_a_flat_one_none() -> None:
    regular = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    tets = np.array([[0, 1, 2, 3]])
    assert radius_ratios(regular, tets)[0] == pytest.approx(1.0)
    corner = radius_ratios(CORNER.points, CORNER.tetrahedra)[0]
    # r = a / (3 + sqrt 3), R = a sqrt 3 / 2
    assert corner == pytest.approx(6 / ((3 + 3**0.5) * 3**0.5))
    regular[:, 2] = 0
    assert radius_ratios(regular, tets)[0] == 0


def test_elements_numbered_the_other_way_round_are_turned() -> None:
    mirrored = replace(BLOCK, tetrahedra=BLOCK.tetrahedra[:, [0, 1, 3, 2]])
    raw, report = mend(mirrored)
    assert report.volume == pytest.approx(VOLUME)
    assert report.mended == ("all elements were numbered the other way round and were turned",)

    tetrahedra = BLOCK.tetrahedra.copy()
    tetrahedra[7] = tetrahedra[7, [1, 0, 2, 3]]
    ids = 100 + np.arange(len(tetrahedra))
    raw, report = mend(replace(BLOCK, tetrahedra=tetrahedra, element_file_ids=ids))
    assert (signed_volumes(raw.points, raw.tetrahedra) > 0).all()
    assert "1 elements" in report.mended[0]
    assert "element 107" in report.mended[0]


def test_an_inverted_element_is_refused_by_its_file_id() -> None:
    points = BLOCK.points.copy()
    inner = int(np.argmin(np.linalg.norm(points - 0.01, axis=1)))
    points[inner] += 0.015
    ids = 1 + np.arange(len(BLOCK.tetrahedra))
    bad = replace(BLOCK, points=points, element_file_ids=ids, source="organ.vtu")
    with pytest.raises(MeshError, match=r"organ.vtu: element \d+ and its neighbour.*inverted"):
        mend(bad)
    assert "inverted" in inspect(bad).refused


def test_nodes_at_the_same_place_are_joined() -> None:
    apart = BLOCK.points[BLOCK.tetrahedra].reshape(-1, 3)
    apart = apart + 1e-9 * np.random.default_rng(1).random(apart.shape)
    soup = RawMesh(apart, np.arange(len(apart)).reshape(-1, 4))
    raw, report = mend(soup)
    assert len(raw.points) == 64
    assert report.part_sizes == (64,)
    assert f"{len(apart) - 64} nodes that lay on another one" in report.mended[0]
    # The file ids still say where each node came from.
    np.testing.assert_allclose(raw.points, apart[raw.node_file_ids])


def test_unused_nodes_are_dropped_and_node_sets_follow() -> None:
    raw = replace(
        BLOCK,
        points=np.vstack([[[9.0, 9, 9]], BLOCK.points]),
        tetrahedra=BLOCK.tetrahedra + 1,
        node_sets={"fixed": np.array([0, 1, 64])},
    )
    mended, report = mend(raw)
    assert len(mended.points) == 64
    assert mended.node_sets["fixed"].tolist() == [0, 63]
    assert mended.node_file_ids.tolist() == list(range(1, 65))
    assert "1 nodes that no element uses" in report.mended[0]


def test_repeated_and_collapsed_elements_are_dropped() -> None:
    first = BLOCK.tetrahedra[0].tolist()
    extra = [[first[2], first[0], first[1], first[3]], [first[0], first[0], first[1], first[2]]]
    raw, report = mend(with_more(BLOCK, [], extra))
    assert len(raw.tetrahedra) == len(BLOCK.tetrahedra)
    assert report.volume == pytest.approx(VOLUME)
    assert "a node twice were dropped: element 163" in report.mended[0]
    assert "same nodes as another one were dropped: element 162" in report.mended[1]


def test_flat_elements_go_at_the_surface_and_are_refused_inside() -> None:
    top = np.flatnonzero(BLOCK.points[:, 2] == 0.03)[:1]
    a, b, c = BLOCK.tetrahedra[(np.isin(BLOCK.tetrahedra, top)).any(axis=1)][0, :3]
    flat = BLOCK.points[[a, b, c]].mean(axis=0)
    raw, report = mend(with_more(BLOCK, flat, [[a, b, c, 64]]))
    assert len(raw.tetrahedra) == len(BLOCK.tetrahedra)
    assert "without volume" in report.mended[0]

    large = block(6, 6, 6, 0.03, 0.03, 0.03)
    at_surface = pair_faces(large.tetrahedra).border // 4
    element = np.setdiff1d(np.arange(len(large.tetrahedra)), at_surface)[0]
    node, *others = large.tetrahedra[element].tolist()
    squashed = large.points.copy()
    squashed[node] = squashed[others].mean(axis=0)
    with pytest.raises(MeshError, match=rf"element {element}\b.* inside the mesh: no volume"):
        mend(replace(large, points=squashed))


def test_a_face_of_three_elements_is_refused() -> None:
    inner = pair_faces(BLOCK.tetrahedra).first[:1]
    a, b, c = face_nodes(BLOCK.tetrahedra, inner)[0].tolist()
    extra = BLOCK.points[[a, b, c]].mean(axis=0) + np.array([0.001, 0.002, 0.05])
    bad = with_more(BLOCK, extra, [[a, b, c, 64]])
    with pytest.raises(MeshError, match=r"more than two elements share the face.*162"):
        mend(bad)


def test_small_islands_are_dropped_and_large_ones_reported() -> None:
    many = block(8, 8, 8)
    island = CORNER.points + 0.2
    count = len(many.points)
    raw, report = mend(with_more(many, island, [[count, count + 1, count + 2, count + 3]]))
    assert len(raw.points) == count
    assert "1 small islands with 4 nodes and 1 elements" in report.mended[0]

    twin = with_more(BLOCK, BLOCK.points + 0.2, (BLOCK.tetrahedra + 64).tolist())
    _, report = mend(twin)
    assert report.part_sizes == (64, 64)
    assert "2 separate parts" in report.warnings[0]


@pytest.mark.parametrize("shared", [1, 2])
def test_parts_that_touch_in_a_node_or_an_edge_are_taken_apart_there(shared: int) -> None:
    """Cut-regularity: all elements at a node are joined through faces."""
    # The block's main diagonal is an edge of its corner cells, so its mirror image shares it.
    corner = BLOCK.points[0]
    mirrored = 2 * corner - BLOCK.points
    if shared == 2:
        mirrored[:, 2] = BLOCK.points[:, 2]
    tets = BLOCK.tetrahedra + 64
    touching = with_more(BLOCK, mirrored, tets.tolist())
    raw, report = mend(touching)
    on_axis = 1 if shared == 1 else 4
    assert any(
        f"{on_axis} nodes where tissue met in a point or an edge" in t for t in report.mended
    )
    assert report.part_sizes == (64, 64)
    assert report.volume == pytest.approx(2 * VOLUME)
    _, again = mend(raw)
    # Joining and splitting again comes to the same.
    assert again.part_sizes == (64, 64)


@pytest.mark.parametrize(
    ("factor", "hint"), [(1e3, "did you mean --units mm"), (1e-3, "did you mean --units m?")]
)
def test_absurd_sizes_make_one_ask_for_the_units(factor: float, hint: str) -> None:
    _, report = mend(replace(BLOCK, points=factor * BLOCK.points))
    assert hint in report.warnings[0]
    assert any(hint in line for line in report.lines())


def test_nothing_left_and_not_finite_are_refused() -> None:
    with pytest.raises(MeshError, match="nothing is left"):
        mend(replace(CORNER, tetrahedra=np.array([[0, 0, 1, 2]])))
    with pytest.raises(MeshError, match="node 1 is at"):
        mend(replace(CORNER, points=CORNER.points * [[1], [np.nan], [1], [1]]))
    with pytest.raises(MeshError, match="names node rows"):
        mend(replace(CORNER, tetrahedra=np.array([[0, 1, 2, 4]])))


def test_real_meshes_pass_with_what_is_known_about_them(shared_meshes: Path) -> None:
    path = shared_meshes / "toronto_chd" / "derived_2018002_tof_ftetwild_33k.vtu"
    raw, report = mend(load(path, "mm"))
    assert report.part_sizes == (len(raw.points),)
    assert any("small islands" in text for text in report.mended)
    assert (signed_volumes(raw.points, raw.tetrahedra) > 0).all()
    assert report.quality_min == pytest.approx(0.11, abs=0.005)

    _, report = mend(load(shared_meshes / "generated_heart" / "heart_35k.vtu", "mm"))
    assert (report.node_count, report.element_count) == (37042, 164853)
    assert report.volume == pytest.approx(27.09e-6, rel=1e-3)


def test_the_solids_boundary_winds_once_around_its_inside() -> None:
    from tissue_sim.geometry.surface import boundary_triangles

    tets = BLOCK.tetrahedra.astype(np.int32)
    triangles, _ = boundary_triangles(tets, np.ones(len(tets), dtype=np.bool_), 64)
    tree = surface_tree(BLOCK.points, triangles.astype(np.int64))
    places = np.array([[0.015, 0.014, 0.013], [0.0299, 0.02, 0.01], [0.031, 0.01, 0.01]])
    np.testing.assert_allclose(winding_numbers(tree, places), [1, 1, 0], atol=0.05)
