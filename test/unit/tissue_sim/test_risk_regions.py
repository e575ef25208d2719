"""Risk regions: what they hold, what comes near them, and when warnings begin and end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.cut_scenes import middle, new, rest
from support.split_edit import split_at
from tissue_sim.elastic.model import Material
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.tools import BOX, CAPSULE, GRAB, RECTANGLE, SPHERE, TRIANGLE
from tissue_sim.interaction.tools import CUT as CUTTING
from tissue_sim.readings.reach import ToolReach
from tissue_sim.readings.region_files import read_regions
from tissue_sim.readings.regions import RiskRegion, RiskRegionError, RiskRegions, painted
from tissue_sim.readings.risk import WIDER, RiskWatch
from tissue_sim.readings.risk_warnings import CUT, NEAR, STRESS, TOUCHED, Cause, Finding, Warnings
from tissue_sim.readings.tissue import TissueReadings

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
NOBODY = np.empty(0, dtype=np.uint32)
MARGIN = 0.01


def at(point: list[float], shape: str = SPHERE, size: tuple[float, ...] = (0.002,)) -> ToolReach:
    return ToolReach.of("tool", shape, size, np.array([*point, *UPRIGHT]))


def low_corner(mesh: Mesh, limit: float = 0.0) -> RiskRegion:
    """The nodes near the lowest corner."""
    corner = rest(mesh).min(axis=0)
    nodes = painted(mesh, corner[None], 0.015)
    assert 3 < len(nodes) < 30
    return RiskRegion("corner", nodes, MARGIN, limit)


@pytest.mark.parametrize(
    ("shape", "size", "point", "distance"),
    [
        (SPHERE, (0.5,), [0, 0, 2], 1.5),
        (SPHERE, (0.5,), [0, 0, 0.25], -0.25),
        (CAPSULE, (0.5, 3.0), [0, 2, 3], 1.5),
        (CAPSULE, (0.5, 3.0), [0, 0, -1], 0.5),
        (BOX, (2.0, 4.0, 6.0), [2, 0, 0], 1.0),
        (BOX, (2.0, 4.0, 6.0), [1, 2, 3], 0.0),
        (RECTANGLE, (2.0, 4.0), [4, 4, 0], 5.0),
        (TRIANGLE, (2.0, 4.0), [0, 0, 5], 1.0),
        (TRIANGLE, (2.0, 4.0), [0, 0, -2], 2.0),
    ],
)
def test_how_far_a_point_is_from_a_tool(
    shape: str, size: tuple[float, ...], point: list[float], distance: float
) -> None:
    """The tool stands on its side at (1, 2, 3): its z axis is the organ's x."""
    half = np.sqrt(0.5)
    tool = ToolReach.of("tool", shape, size, np.array([1, 2, 3, 0, half, 0, half]))
    x, y, z = point
    place = np.array([[1.0 + z, 2.0 + y, 3.0 - x]])
    assert tool.distances(place)[0] == pytest.approx(distance, abs=1e-12)


def test_a_brush_takes_what_is_within_its_radius_at_rest() -> None:
    mesh = new("shaken")
    points = np.random.default_rng(0).uniform(rest(mesh).min(), rest(mesh).max(), (5, 3))
    distances = np.linalg.norm(rest(mesh)[:, None] - points, axis=2).min(axis=1)
    np.testing.assert_array_equal(painted(mesh, points, 0.012), np.flatnonzero(distances <= 0.012))
    for radius in (0.0, -1.0, np.nan):
        with pytest.raises(RiskRegionError, match="radius"):
            painted(mesh, points, radius)


def test_copies_join_the_region_of_their_parent() -> None:
    mesh = new("block")
    plane = float(np.unique(np.round(rest(mesh)[:, 0], 9))[3])
    on_plane = np.flatnonzero(np.abs(rest(mesh)[:, 0] - plane) < 1e-9)
    regions = RiskRegions()
    regions.put(mesh, RiskRegion("plane", on_plane[::2].astype(np.uint32), MARGIN))
    regions.put(mesh, RiskRegion("elsewhere", np.array([0], dtype=np.uint32), MARGIN))
    regions.follow(mesh)
    change = mesh.apply(split_at(mesh, plane))
    assert regions.follow(mesh)
    assert not regions.follow(mesh)
    inside = np.isin(change.copy_parents, on_plane[::2])
    assert 0 < inside.sum() < len(inside)
    expected = [*on_plane[::2], *change.copied_nodes[inside]]
    np.testing.assert_array_equal(regions.rows("plane"), np.sort(expected))
    np.testing.assert_array_equal(regions.by_name["elsewhere"].nodes, [0])


def test_regions_are_found_again_in_the_organ_loaded_anew_and_lost_in_another() -> None:
    mesh, again, other = new("block"), new("block"), new("shell")
    regions = RiskRegions()
    region = low_corner(mesh)
    regions.put(mesh, region)
    assert regions.carry(again) == []
    np.testing.assert_array_equal(regions.by_name["corner"].nodes, region.nodes)
    assert regions.carry(other) == ["corner"]
    assert not regions.by_name


@pytest.mark.parametrize(
    ("region", "why"),
    [
        (RiskRegion("", np.array([1]), 0.01), "name"),
        (RiskRegion("a", np.array([1]), -1.0), "margin = -1 .* allowed: 0 to 1 m"),
        (RiskRegion("a", np.array([1]), np.nan), "margin = nan"),
        (RiskRegion("a", np.array([1]), 0.01, -5.0), "stress_limit"),
        (RiskRegion("a", np.array([10**6]), 0.01), "no node 1000000"),
    ],
)
def test_regions_that_are_refused(region: RiskRegion, why: str) -> None:
    regions = RiskRegions()
    with pytest.raises(RiskRegionError, match=why):
        regions.put(new("block"), region)
    assert not regions.by_name


def test_a_warning_begins_and_ends_once_however_a_tool_trembles() -> None:
    """Along the margin it goes to and fro by less than the wider margin; then it leaves."""
    mesh, watched = new("block"), TissueReadings(lasting=0.5)
    region = low_corner(mesh)
    watched.restart(mesh)
    watched.regions.put(mesh, region)
    corner = rest(mesh).min(axis=0)
    trembling = MARGIN * np.array([3.0, 1.3, 0.99, 1.1, 0.98, 1.15, 1.01, 0.95, 1.4, 1.1, 3, 3, 3])
    changes: list[tuple[float, bool]] = []
    is_on = False
    for step, distance in enumerate(trembling):
        tool = at([corner[0] - distance - 0.002, corner[1], corner[2]])
        told = watched.read(mesh, rest(mesh), 0.2 * step, None, [tool], NOBODY, "risk")
        near = [w for w in told.warnings if w.cause == Cause("corner", NEAR, "tool")]
        if near and near[0].begins != is_on:
            is_on = near[0].begins
            changes.append((round(0.2 * step, 9), is_on))
        if near and is_on and distance <= WIDER * MARGIN:
            assert near[0].value == pytest.approx(distance, abs=1e-9)
    # It was last within the wider margin at 1.8 s, and lasts half a second more.
    assert changes == [(0.4, True), (2.4, False)]


def test_what_is_found_and_the_risk_of_each_node() -> None:
    mesh = new("block")
    regions = RiskRegions()
    region = low_corner(mesh, limit=1000.0)
    regions.put(mesh, region)
    watch = RiskWatch(regions)
    watch.restart(mesh)
    corner = rest(mesh).min(axis=0)
    stress = np.zeros(mesh.node_rows)

    found, risk = watch.look(mesh, rest(mesh), [at((corner - 1.0).tolist())], NOBODY, stress)
    assert found == {}
    np.testing.assert_array_equal(np.flatnonzero(~np.isnan(risk)), region.nodes)
    assert np.nanmax(risk) == 0.0

    stress[:] = 5000.0
    stress[region.nodes] = 0.9 * 1000.0
    found, risk = watch.look(mesh, rest(mesh), [], NOBODY, stress)
    assert found == {Cause("corner", STRESS): Finding(900.0, False)}
    assert np.nanmin(risk) == np.nanmax(risk) == pytest.approx(0.9)
    stress[region.nodes[0]] = 1001.0
    found, risk = watch.look(mesh, rest(mesh), [], NOBODY, stress)
    assert found[Cause("corner", STRESS)] == Finding(1001.0, True)
    assert risk[region.nodes[0]] == 1.0

    # Held, and touched by a sphere around the corner's node; the organ moved a metre meanwhile.
    held = np.array([*region.nodes[:2], mesh.node_rows - 1], dtype=np.uint32)
    way = np.array([1.0, 0.0, 0.0])
    tools = [at((corner + way).tolist())]
    moved = rest(mesh) + way
    found, risk = watch.look(mesh, moved, tools, held, None)
    assert found[Cause("corner", TOUCHED)].value == 2
    assert found[Cause("corner", TOUCHED, "tool")].value == 1
    assert found[Cause("corner", NEAR, "tool")].value == 0.0
    distances = np.linalg.norm(moved[region.nodes] - moved[region.nodes].min(axis=0), axis=1)
    expected = np.clip(1.0 - (distances - 0.002) / MARGIN, 0.0, 1.0)
    expected[:2] = 1.0
    np.testing.assert_allclose(risk[region.nodes], expected, atol=1e-12)


def test_what_two_hands_hold_is_told_of_each_wherever_they_go() -> None:
    """The hands take hold of both ends of the block's diagonal, and then cross over."""
    mesh = new("block")
    regions = RiskRegions()
    nodes = mesh.node_ids[: mesh.node_rows]
    regions.put(mesh, RiskRegion("all", nodes, 0.0, 0.0))
    watch = RiskWatch(regions)
    watch.restart(mesh)
    low, high = rest(mesh).min(axis=0), rest(mesh).max(axis=0)

    def hands(left: np.ndarray, right: np.ndarray) -> list[ToolReach]:
        """And a blade that is nearer than the left one, but holds nothing."""
        tools = (
            ("left", GRAB, left - 0.005),
            ("right", GRAB, right + 0.005),
            ("blade", CUTTING, left - 0.003),
        )
        return [
            ToolReach.of(name, SPHERE, (0.001,), np.array([*place, *UPRIGHT]), kind)
            for name, kind, place in tools
        ]

    first = nodes[np.linalg.norm(rest(mesh) - low, axis=1) < 0.02]
    second = nodes[np.linalg.norm(rest(mesh) - high, axis=1) < 0.02]
    found, _ = watch.look(mesh, rest(mesh), hands(low, high), np.union1d(first, second), None)
    assert found == {
        Cause("all", TOUCHED, "left"): Finding(len(first)),
        Cause("all", TOUCHED, "right"): Finding(len(second)),
    }
    away = np.array([1.0, 0.0, 0.0])
    crossed = hands(high + away, low - away)
    found, risk = watch.look(mesh, rest(mesh), crossed, second, None)
    assert found == {Cause("all", TOUCHED, "right"): Finding(len(second))}
    np.testing.assert_array_equal(nodes[risk == 1.0], second)


def test_an_edit_that_changes_its_elements_is_told_once() -> None:
    mesh = new("block")
    plane = float(np.unique(np.round(rest(mesh)[:, 0], 9))[3])
    regions = RiskRegions()
    regions.put(mesh, low_corner(mesh))
    through = painted(mesh, middle(mesh)[None], 0.02)
    regions.put(mesh, RiskRegion("middle", through, MARGIN))
    watch = RiskWatch(regions)
    watch.restart(mesh)
    mesh.apply(split_at(mesh, plane))
    regions.follow(mesh)
    found, _ = watch.look(mesh, rest(mesh), [], NOBODY, None)
    assert set(found) == {Cause("middle", CUT)}
    assert watch.look(mesh, rest(mesh), [], NOBODY, None)[0] == {}


def test_warnings_of_several_causes_are_independent() -> None:
    warnings = Warnings(lasting=1.0)
    near, stress = Cause("a", NEAR, "t"), Cause("a", STRESS)
    assert warnings.take({near: Finding(0.01, beyond=False)}, 0.0) == []
    assert [w.cause for w in warnings.take({near: Finding(0.01)}, 0.1)] == [near]
    both = warnings.take({stress: Finding(5.0), near: Finding(0.02, beyond=False)}, 0.2)
    assert [w.cause for w in both] == [near, stress]
    told = warnings.take({stress: Finding(6.0)}, 1.3)
    assert [(w.cause, w.value, w.begins) for w in told] == [(near, 0.02, False), (stress, 6, True)]
    assert [w.cause for w in warnings.take({}, 1.4)] == [stress]


FILE = """
risk_regions:
  - {name: by id, nodes: [1, 5, 7]}
  - {name: painted, points: [[0, 0, 0]], radius: 0.015, margin: 0.002, stress_limit: 300}
  - {name: all of it, region: "0"}
"""


def test_regions_from_files(tmp_path: Path) -> None:
    mesh = new("block")
    path = tmp_path / "risk.yaml"
    path.write_text(FILE)
    by_id, brushed, everything = read_regions(path, mesh, 0.01, 50.0)
    assert (by_id.name, by_id.nodes.tolist(), by_id.margin) == ("by id", [1, 5, 7], 0.01)
    assert (brushed.margin, brushed.stress_limit, by_id.stress_limit) == (0.002, 300.0, 50.0)
    np.testing.assert_array_equal(brushed.nodes, painted(mesh, np.zeros((1, 3)), 0.015))
    assert len(everything.nodes) == mesh.node_rows
    np.savez(tmp_path / "risk.npz", vessel=np.array([3, 4]))
    (vessel,) = read_regions(tmp_path / "risk.npz", mesh, 0.01, 0.0)
    assert (vessel.name, vessel.nodes.tolist()) == ("vessel", [3, 4])


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("risk_regions: 3", "no list"),
        ("[1, 2]", "no list"),
        ("other: []", "no risk regions"),
        ("{", "no risk regions"),
        ("risk_regions: [{name: a}]", "region 1: needs one of nodes"),
        ("risk_regions: [{name: a, nodes: [1], points: [], radius: 1}]", "needs one of nodes"),
        ("risk_regions: [{name: a, nodes: [1.5]}]", "list of ids"),
        ("risk_regions: [{name: a, nodes: [1], colour: red}]", "unknown colour; allowed: margin"),
        ("risk_regions: [{name: a, region: aorta}]", "no region 'aorta'"),
        ("risk_regions: [{name: a, points: [[9, 9, 9]], radius: 0.01}]", "no node in it"),
        ("risk_regions: [{name: a, nodes: [1], margin: wide}]", "region 1"),
    ],
)
def test_files_that_are_refused(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "risk.yaml"
    path.write_text(text)
    with pytest.raises(RiskRegionError, match=why):
        read_regions(path, new("block"), 0.01, 0.0)


def test_files_that_are_not_there(tmp_path: Path) -> None:
    for name in ("risk.yaml", "risk.npz"):
        with pytest.raises(RiskRegionError, match="cannot be read"):
            read_regions(tmp_path / name, new("block"), 0.01, 0.0)
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(RiskRegionError, match="no risk regions"):
        read_regions(tmp_path / "text.npz", new("block"), 0.01, 0.0)


def test_stress_beyond_the_limit_of_tissue_that_is_read() -> None:
    mesh, watched = new("block"), TissueReadings(lasting=0.1)
    watched.restart(mesh)
    watched.regions.put(mesh, low_corner(mesh, limit=4000.0))
    material = Material(young_modulus=5e4, poisson_ratio=0.0)
    told = watched.read(mesh, rest(mesh) * [1.1, 1, 1], 0.0, material, [], NOBODY, "none")
    (warning,) = told.warnings
    assert (warning.cause, warning.begins) == (Cause("corner", STRESS), True)
    assert warning.value == pytest.approx(5000.0)
    assert {reading.name for reading in told.readings} == {
        "displacement", "von_mises_stress", "largest_principal_stress", "strain",
    }  # fmt: skip
