"""Bands of a surface: they cover it once, hold the values they should, and follow the tissue."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from support.split_block import split_plan
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block, sphere_shell
from tool_input.table.contour_bands import SurfaceEdges, contour_bands, surface_edges
from tool_input.table.surface_parts import SurfacePart, tissue_parts
from tool_input.table.tissue_frame import Surface
from viz_bridge.organ_surface import INSIDE, OUTSIDE

COLORS = [(10, 0, 0), (20, 0, 0), (30, 0, 0), (40, 0, 0)]
LEVELS = [-0.5, 0.0, 0.5]
UNKNOWN = (1, 2, 3)


def shell() -> tuple[Mesh, SurfaceEdges]:
    """A closed surface that bends everywhere."""
    mesh = Mesh(sphere_shell())
    return mesh, surface_edges(Surface.of(mesh))


def normals(points: NDArray[np.floating], triangles: NDArray[np.integer]) -> NDArray[np.float64]:
    """Twice the area of each triangle along its normal."""
    a, b, c = (points[triangles[:, corner]].astype(np.float64) for corner in range(3))
    return np.cross(b - a, c - a)


def area(part: SurfacePart, positions: NDArray[np.floating]) -> float:
    """Of all triangles of a part."""
    vectors = normals(part.vertices(positions), part.triangles)
    return float(np.linalg.norm(vectors, axis=1).sum() / 2)


def test_bands_cover_a_surface_once_and_hold_their_values() -> None:
    mesh, surface = shell()
    rest = mesh.rest[: mesh.node_rows]
    rng = np.random.default_rng(3)
    values = rng.normal(size=mesh.node_rows)
    # Values on a level, and on several levels of one triangle.
    values[rng.choice(mesh.node_rows, 60, replace=False)] = rng.choice(LEVELS, 60)
    parts = contour_bands(surface, values[surface.nodes], LEVELS, COLORS, UNKNOWN)
    assert [part.color for part in parts] == [*COLORS, UNKNOWN]
    assert len(parts[-1].triangles) == 0
    whole = normals(rest, surface.nodes[surface.triangles])
    # Vectors too: a triangle turned over, or cut at a wrong place, would not add up.
    pieces = [normals(part.vertices(rest), part.triangles) for part in parts]
    assert np.allclose(sum(piece.sum(axis=0) for piece in pieces), whole.sum(axis=0), atol=1e-12)
    covered = sum(np.linalg.norm(piece, axis=1).sum() for piece in pieces)
    assert covered == pytest.approx(np.linalg.norm(whole, axis=1).sum(), rel=1e-6)
    ends = [-np.inf, *LEVELS, np.inf]
    for part, low, high in zip(parts[:-1], ends[:-1], ends[1:], strict=True):
        at = values[part.first] + part.weights * (values[part.second] - values[part.first])
        assert at.min() >= low - 1e-6
        assert at.max() <= high + 1e-6
        assert np.array_equal(np.unique(part.triangles), np.arange(len(part.first)))


def test_a_linear_quantity_makes_straight_bands() -> None:
    mesh = Mesh(block(7, 5, 3, 0.06, 0.04, 0.02))
    surface = surface_edges(Surface.of(mesh))
    rest = mesh.rest[: mesh.node_rows]
    x = rest[:, 0] - rest[:, 0].min()
    levels = [0.013, 0.027]
    parts = contour_bands(surface, x[surface.nodes], levels, COLORS[:3], UNKNOWN)
    around = 2 * (0.04 + 0.02)
    ends = 0.04 * 0.02
    expected = [0.013 * around + ends, 0.014 * around, 0.033 * around + ends]
    assert [area(part, rest) for part in parts[:-1]] == pytest.approx(expected, rel=1e-5)


def test_bands_move_with_the_tissue() -> None:
    mesh, surface = shell()
    rest = mesh.rest[: mesh.node_rows]
    parts = contour_bands(surface, rest[surface.nodes, 0] / 0.01, LEVELS, COLORS, UNKNOWN)
    turn = np.array([[0.0, -2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    for part in parts[:-1]:
        assert np.allclose(part.vertices(rest @ turn), part.vertices(rest) @ turn, atol=1e-6)


def test_triangles_with_an_unknown_corner_are_a_part_of_their_own() -> None:
    _, surface = shell()
    values = np.linspace(-1.0, 1.0, len(surface.nodes))
    values[17] = np.nan
    parts = contour_bands(surface, values, LEVELS, COLORS, UNKNOWN)
    assert len(parts[-1].triangles) == (surface.triangles == 17).any(axis=1).sum()
    nothing = contour_bands(surface, np.full(len(values), np.nan), LEVELS, COLORS, UNKNOWN)
    assert [len(part.triangles) for part in nothing] == [0, 0, 0, 0, len(surface.triangles)]


@pytest.mark.parametrize("levels", [[0.0], [0.0, 0.0, 1.0], [1.0, 0.5, 0.0]])
def test_levels_that_do_not_ascend_are_refused(levels: list[float]) -> None:
    _, surface = shell()
    with pytest.raises(ValueError, match="4 colours need 3 ascending levels"):
        contour_bands(surface, np.zeros(len(surface.nodes)), levels, COLORS, UNKNOWN)


def test_tissue_is_shown_whole_and_once_for_all_windows() -> None:
    mesh, edges = shell()
    surface = Surface.of(mesh)
    parts = tissue_parts(surface, mesh)
    assert sum(len(part.triangles) for part in parts) == len(edges.triangles)
    assert tissue_parts(surface, mesh) is parts


def test_what_a_cut_has_opened_has_a_colour_of_its_own() -> None:
    mesh = Mesh(block(5, 5, 3, 0.04, 0.04, 0.02))
    before = {part.color: area(part, mesh.rest) for part in tissue_parts(Surface.of(mesh), mesh)}
    mesh.apply(split_plan(mesh))
    after = {part.color: area(part, mesh.rest) for part in tissue_parts(Surface.of(mesh), mesh)}
    assert list(before) == [tuple(OUTSIDE.astype(int))]
    assert after == pytest.approx({**before, tuple(INSIDE.astype(int)): 2 * 0.02 * 0.02}, rel=1e-5)
