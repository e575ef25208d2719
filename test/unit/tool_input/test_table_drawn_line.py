"""A line drawn on tissue: closed forms of the surface it cuts along, and the cut itself."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cut_service.planner import plan
from cut_service.sweep import Sweep
from support.valid_mesh import check_valid
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block, sphere_shell
from tissue_sim.geometry.surface import surface_triangles
from tool_input.table.drawn_line import DrawnLine, Ruled, smoothed
from tool_input.table.sight import Sight

SIDE, THICK = 0.06, 0.012
SPACING = 0.002


def sight_of(mesh: Mesh, thin: bool = False) -> Sight:
    rest = mesh.rest[: mesh.node_rows].copy()
    return Sight(rest.astype(np.float32), rest, surface_triangles(mesh), thin)


def wall_mesh() -> Mesh:
    """A wall across z, from 0 to `THICK`."""
    return Mesh(block(13, 13, 4, SIDE, SIDE, THICK))


def towards(eye: NDArray[np.float64], point: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray((point - eye) / np.linalg.norm(point - eye))


def drawn(eye: object, points: object) -> DrawnLine:
    """A line over points of the tissue, as seen from an eye that looks at the first."""
    seen, places = np.asarray(eye, dtype=np.float64), np.asarray(points, dtype=np.float64)
    line = DrawnLine(seen, towards(seen, places[0]), places[0], SPACING)
    for place in places[1:]:
        line.draw(place)
    return line


def lengths(sheet: Ruled) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(sheet.far - sheet.near, axis=1))


@pytest.mark.parametrize("eye", [(0.03, 0.03, 0.3), (0.2, 0.03, 0.15), (-0.05, 0.1, 0.15)])
def test_through_a_plane_wall_it_is_as_long_as_the_view_is_oblique(eye: tuple[float, ...]) -> None:
    """Thickness over the cosine of each ray, and the margin on both sides."""
    sight = sight_of(wall_mesh())
    points = [[0.02, 0.02, THICK], [0.03, 0.04, THICK], [0.04, 0.03, THICK]]
    sheet = drawn(eye, points).sheet(sight)
    rays = sheet.far - sheet.near
    cosine = -rays[:, 2] / lengths(sheet)
    np.testing.assert_allclose(sheet.near[:, 2], THICK + SPACING * cosine, atol=1e-7)
    np.testing.assert_allclose(sheet.far[:, 2], -SPACING * cosine, atol=1e-7)
    off = np.cross(sheet.near - np.array(eye), rays) / lengths(sheet)[:, None]
    assert np.abs(off).max() < 1e-8, "rulings are lines of sight"


def test_through_a_shell_it_is_a_chord_of_both_spheres() -> None:
    mesh = Mesh(sphere_shell(subdivisions=4, layers=2))
    sight = sight_of(mesh)
    centre = mesh.rest[: mesh.node_rows].mean(axis=0)
    radii = np.linalg.norm(mesh.rest[: mesh.node_rows] - centre, axis=1)
    outer, inner = radii.max(), radii.min()
    eye = centre + np.array([0.0, 0.0, 6.0 * outer])
    across = np.linspace(-0.5, 0.5, 9)[:, None] * np.array([outer, 0.2 * outer, 0.0])
    points = (
        centre
        + across
        + np.array([0.0, 0.0, 1.0]) * np.sqrt(outer**2 - (across**2).sum(axis=1, keepdims=True))
    )
    sheet = drawn(eye, points).sheet(sight)
    rays = (sheet.far - sheet.near) / lengths(sheet)[:, None]
    ahead = rays @ (centre - eye)
    past = np.sqrt(np.sum((centre - eye) ** 2) - ahead**2)
    near, far = ahead - np.sqrt(outer**2 - past**2), ahead - np.sqrt(inner**2 - past**2)
    off = 0.02 * (outer - inner)  # of the triangles from the spheres
    found = np.linalg.norm(sheet.near - eye, axis=1) + SPACING
    np.testing.assert_allclose(found, near, atol=off)
    found = np.linalg.norm(sheet.far - eye, axis=1) - SPACING
    np.testing.assert_allclose(found, far, atol=off)


def test_a_chosen_depth_is_counted_from_where_the_ray_comes_in() -> None:
    sight = sight_of(wall_mesh())
    line = drawn((0.03, 0.03, 1e3), [[0.02, 0.03, THICK], [0.04, 0.03, THICK]])
    sheet = line.sheet(sight, 0.005)
    np.testing.assert_allclose(sheet.far[:, 2], THICK - 0.005, atol=1e-6)
    np.testing.assert_allclose(sheet.near[:, 2], THICK + SPACING, atol=1e-6)


def test_it_stops_half_way_to_what_lies_behind() -> None:
    """Two walls a millimetre more than the spacing apart: the second is not touched."""
    wall = wall_mesh()
    rest = wall.rest[: wall.node_rows]
    triangles = surface_triangles(wall)
    gap = 1.5 * SPACING
    both = np.concatenate([rest, rest - np.array([0.0, 0.0, THICK + gap])])
    sight = Sight(both, both, np.concatenate([triangles, triangles + len(rest)]))
    points = [[0.02, 0.03, THICK], [0.04, 0.03, THICK]]
    sheet = drawn((0.03, 0.03, 1e3), points).sheet(sight)
    np.testing.assert_allclose(sheet.far[:, 2], -gap / 2, atol=1e-6)
    touching = np.concatenate([rest, rest - np.array([0.0, 0.0, THICK + 0.1 * SPACING])])
    sight = Sight(touching, touching, sight.triangles)
    sheet = drawn((0.03, 0.03, 1e3), points).sheet(sight)
    np.testing.assert_allclose(sheet.far[:, 2], -THICK - 1.1 * SPACING, atol=1e-6)


def test_tissue_without_thickness_is_cut_where_it_is_met_first() -> None:
    mesh = wall_mesh()
    line = drawn((0.03, 0.03, 1e3), [[0.02, 0.03, 0], [0.04, 0.03, 0]])
    sheet = line.sheet(sight_of(mesh, thin=True))
    np.testing.assert_allclose(sheet.near[:, 2], THICK + SPACING, atol=1e-6)
    np.testing.assert_allclose(sheet.far[:, 2], THICK - SPACING, atol=1e-6)


@pytest.mark.parametrize("eye", [(0.03, 0.03, 0.3), (0.3, 0.02, 0.12), (-0.1, 0.05, 0.1)])
def test_a_line_across_a_wall_in_an_oblique_view_parts_it(eye: tuple[float, ...]) -> None:
    """Drawn crooked, from just inside one side to just inside the other."""
    mesh = wall_mesh()
    before = check_valid(mesh)
    sight = sight_of(mesh)
    points = [[0.031, 0.002, THICK], [0.026, 0.02, THICK], [0.034, 0.04, THICK]]
    line = drawn(eye, [*points, [0.03, 0.0585, THICK]])
    sheet = line.sheet(sight, ended=True)
    sweep = Sweep.from_arrays(sheet.vertices, sheet.triangles)
    mesh.apply(plan(mesh, mesh.rest[: mesh.node_rows], sweep).edit)
    after = check_valid(mesh)
    assert (before.components, after.components) == (1, 2)


def test_a_line_all_around_cuts_a_piece_out() -> None:
    """It ends five millimetres before where it began."""
    mesh = wall_mesh()
    sight = sight_of(mesh)
    angle = np.linspace(0.0, 2.0 * np.pi - 0.3, 60)
    around = [[0.03 + 0.016 * np.cos(a), 0.03 + 0.016 * np.sin(a), THICK] for a in angle]
    sheet = drawn((0.05, 0.02, 0.3), around).sheet(sight, ended=True)
    np.testing.assert_array_equal(sheet.near[0], sheet.near[-1])
    sweep = Sweep.from_arrays(sheet.vertices, sheet.triangles)
    mesh.apply(plan(mesh, mesh.rest[: mesh.node_rows], sweep).edit)
    assert check_valid(mesh).components == 2


def test_a_line_that_ends_in_the_middle_is_not_made_longer() -> None:
    sight = sight_of(wall_mesh())
    line = drawn((0.03, 0.03, 0.3), [[0.02, 0.03, THICK], [0.04, 0.03, THICK]])
    before = line.sheet(sight)
    np.testing.assert_array_equal(line.sheet(sight, ended=True).vertices, before.vertices)


def test_a_tremor_is_evened_out_and_a_straight_line_stays() -> None:
    at = np.linspace(0.0, 1.0, 41)
    straight = np.stack([at, 2.0 * at, -at], axis=1)
    np.testing.assert_allclose(smoothed(straight, 8), straight, atol=1e-12)
    trembling = straight + 0.01 * (-1.0) ** np.arange(41)[:, None]
    rest = smoothed(trembling, 4)
    assert np.abs(rest - straight)[4:-4].max() < 1e-15, "what changes at every step is gone"
    np.testing.assert_array_equal(rest[[0, -1]], trembling[[0, -1]])


def test_evening_out_leaves_of_a_wave_what_its_passes_leave() -> None:
    """One pass leaves (1 + cos(2 pi / n)) / 2 of a wave n steps long."""
    n, passes = 12, 4
    wave = np.sin(2.0 * np.pi * np.arange(121) / n)
    share = (0.5 * (1.0 + np.cos(2.0 * np.pi / n))) ** passes
    left = smoothed(wave[:, None], passes)[10:-10, 0]
    np.testing.assert_allclose(left, share * wave[10:-10], atol=1e-12)


def test_straightened_it_is_straight_wherever_it_went() -> None:
    sight = sight_of(wall_mesh())
    eye = np.array([0.03, 0.03, 0.3])
    line = drawn(eye, [[0.02, 0.03, THICK], [0.03, 0.05, THICK]])
    line.straighten(np.array([0.04, 0.03, THICK]))
    np.testing.assert_allclose(line.sheet(sight).vertices[:, 1], 0.03, atol=1e-9)


def test_what_cannot_be_cut_is_said() -> None:
    sight = sight_of(wall_mesh())
    at, eye = np.array([0.02, 0.03, THICK]), np.array([0.02, 0.03, 0.3])
    down = np.array([0.0, 0.0, -1.0])
    with pytest.raises(ValueError, match="drag further"):
        DrawnLine(eye, down, at, SPACING).sheet(sight)
    beside = DrawnLine(eye, down, at + np.array([0.5, 0.5, 0.0]), SPACING)
    beside.draw(at + np.array([0.5, 0.6, 0.0]))
    with pytest.raises(ValueError, match="meets no tissue"):
        beside.sheet(sight)
    with pytest.raises(ValueError, match="behind the eye"):
        DrawnLine(eye, down, at, SPACING).draw(np.array([0.0, 0.0, 1.0]))


def test_a_long_line_has_no_more_rulings_than_a_cut_takes() -> None:
    sight = sight_of(wall_mesh())
    zigzag = [[0.01 + 0.04 * (k % 2), 0.01 + 0.002 * k, THICK] for k in range(20)]
    sheet = drawn((0.03, 0.03, 0.3), zigzag).sheet(sight)
    assert len(sheet.near) == 100
    assert Sweep.from_arrays(sheet.vertices, sheet.triangles).triangles.shape == (198, 3)


def test_a_hit_knows_where_the_tissue_is_at_rest() -> None:
    """Sheared tissue: the point hit, carried back, and the normal of the sheared face."""
    sight = sight_of(wall_mesh())
    shear = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.2, 0.0, 1.0]])
    moved = Sight(sight.rest @ shear.T, sight.rest, sight.triangles)
    rest = np.array([0.021, 0.032, THICK])
    eye = shear @ rest + np.array([0.02, 0.03, 0.2])
    hit = moved.hit(eye, towards(eye, shear @ rest))
    assert hit is not None
    np.testing.assert_allclose(hit.rest, rest, atol=1e-9)
    np.testing.assert_allclose(hit.point, shear @ rest, atol=1e-9)
    normal = np.linalg.inv(shear).T @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(hit.normal, normal / np.linalg.norm(normal), atol=1e-9)
    assert moved.hit(eye, np.array([0.0, 0.0, 1.0])) is None
