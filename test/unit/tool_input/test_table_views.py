"""What is drawn of the organ in a window: ranges, bars, tools, and the meshes of every view."""

from __future__ import annotations

from itertools import combinations
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from support.split_block import split_plan
from tissue_sim.geometry.holes import HoleLostError
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.scene_geometry import load
from tissue_sim.geometry.shapes import block
from tissue_sim.geometry.sheet import CONNECTING
from tissue_sim.geometry.sheet_geometry import SheetSettings
from tissue_sim.geometry.sutures import Sutures
from tissue_sim.readings.fields import UNITS
from tool_input.table.color_bar import ShownUnit, color_bar, legend
from tool_input.table.mesh_pool import STILL
from tool_input.table.organ_view import RECOLOR_PERIOD, OrganView
from tool_input.table.page_scene import PageScene, Placement
from tool_input.table.range_controls import RangeControls
from tool_input.table.scalar_scale import (
    BANDS,
    DIFFERENCE,
    LEAST_TOPS,
    SHRINK_AFTER,
    AutoScale,
    Scale,
    band_colors,
)
from tool_input.table.scalar_source import quantity_values
from tool_input.table.seam_lines import SeamLines
from tool_input.table.spring_lines import MOST_LINES, SpringGroup, spring_groups
from tool_input.table.tissue_frame import NodeValues, Surface, TissueFrame, ToolShown
from tool_input.table.tool_meshes import tool_mesh
from tool_input.table.tools_view import ToolLook, ToolsView
from tool_input.table.views import HEARD, VIEWS
from viz_bridge.difference_colors import map_colors


class Clock:
    """A clock that stands still until it is told."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


class FakeScene:
    """What viser's scene keeps of what is drawn: the nodes there are, by name."""

    def __init__(self) -> None:
        self.nodes: dict[str, Any] = {}

    def _add(self, name: str, **properties: Any) -> Any:
        def remove() -> None:
            for known in [n for n in self.nodes if n == name or n.startswith(name + "/")]:
                del self.nodes[known]

        self.nodes[name] = SimpleNamespace(**properties, remove=remove)
        return self.nodes[name]

    def add_mesh_simple(self, name: str, vertices: Any, faces: Any, **more: Any) -> Any:
        return self._add(name, vertices=vertices, faces=faces, **more)

    def add_line_segments(self, name: str, points: Any, **more: Any) -> Any:
        return self._add(name, points=points, **more)

    def add_frame(self, name: str, **more: Any) -> Any:
        return self._add(name, **more)

    def add_label(self, name: str, text: str, **more: Any) -> Any:
        return self._add(name, text=text, **more)

    def __getattr__(self, _: str) -> Any:
        return lambda *args, **more: None

    def meshes(self, folder: str) -> list[Any]:
        return [
            node
            for name, node in self.nodes.items()
            if name.startswith(folder) and len(np.unique(node.vertices, axis=0)) > 1
        ]


def block_mesh() -> Mesh:
    return Mesh(block(5, 4, 3, 0.04, 0.03, 0.02))


def frame_of(mesh: Mesh, surface: Surface, stretch: float = 1.0, **more: Any) -> TissueFrame:
    positions = (stretch * mesh.rest[: mesh.node_rows]).astype(np.float32)
    return TissueFrame(b"epoch", 1, mesh, positions, surface, more.pop("tools", {}), **more)


def view_of(mesh: Mesh, clock: Clock | None = None) -> tuple[FakeScene, OrganView, list[Any]]:
    made: list[Any] = []
    scene = FakeScene()
    page = PageScene(scene, Placement.around(mesh.rest[: mesh.node_rows]))
    return scene, OrganView(page, made.append, clock or Clock()), made


# Ranges


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.0, 0.0037, (0.0, 0.005)),
        (0.0, 1.0, (0.0, 1.0)),
        (-320.0, 0.0, (-500.0, 0.0)),
        (-3.0, 80.0, (0.0, 100.0)),
        (-30.0, 80.0, (-100.0, 100.0)),
    ],
)
def test_ranges_have_round_ends_and_zero_at_one_of_them_or_in_the_middle(
    low: float, high: float, expected: tuple[float, float]
) -> None:
    values = np.repeat([low, high, np.nan], 50)
    scale = Scale.around(values)
    assert (scale.low, scale.high) == pytest.approx(expected)
    assert len(scale.levels) == BANDS - 1


def test_one_node_at_a_hold_does_not_set_the_range() -> None:
    values = np.append(np.full(999, 0.9), 1e6)
    assert Scale.around(values).high == 1.0


def test_tissue_at_rest_does_not_show_its_last_bits() -> None:
    scale = Scale.around(np.array([0.0, 0.09]), LEAST_TOPS["Pa"])
    assert scale.high == 100.0
    bar = color_bar("von_mises_stress", "Pa", scale, band_colors(DIFFERENCE), 0.0873)
    assert "largest now 0.0001 kPa" in bar


@pytest.mark.parametrize("ends", [(1.0, 1.0), (2.0, 1.0), (0.0, np.inf), (np.nan, 1.0)])
def test_a_range_without_extent_is_refused(ends: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="the lower first"):
        Scale(*ends)


def test_a_range_grows_at_once_and_shrinks_after_a_while() -> None:
    clock = Clock()
    auto = AutoScale(clock=clock)
    small, large = np.array([0.0, 0.9]), np.array([0.0, 7.0])
    assert auto.follow(small).high == 1.0
    assert auto.follow(large).high == 10.0
    for _ in range(5):  # A pull to and fro does not make the colours flicker.
        clock.now += 0.8 * SHRINK_AFTER
        assert auto.follow(small).high == 10.0
        assert auto.follow(large).high == 10.0
    clock.now += 1.01 * SHRINK_AFTER
    assert auto.follow(small).high == 1.0


def test_the_difference_has_the_colours_of_the_projects_pictures() -> None:
    ours = [tuple(color) for color in map_colors(count=BANDS).tolist()]
    assert list(band_colors(DIFFERENCE)) == ours
    assert band_colors("strain") != band_colors(DIFFERENCE)


@pytest.mark.parametrize("quantity", ["von_mises_stress", DIFFERENCE])
def test_colours_get_darker_with_the_value_and_stay_apart_from_the_dark_page(quantity: str) -> None:
    luminance = np.array(band_colors(quantity)) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) < 0).all()
    assert luminance[-1] > 20


# The bar


def test_a_bar_has_numbers_that_people_read_and_a_unit() -> None:
    colors = band_colors("von_mises_stress")
    html = color_bar("von_mises_stress", "Pa", Scale(0.0, 50e3), colors, 61234.0)
    bar = ElementTree.fromstring(html)
    texts = [node.text for node in bar.iter("text")]
    assert texts == ["0", "10", "20", "30", "40", "50"]
    assert len(list(bar.iter("rect"))) == BANDS
    assert "von Mises stress [kPa]" in html
    assert "largest now 61.23 kPa" in html


def test_a_quantity_that_is_not_known_has_a_bar_that_says_so() -> None:
    html = color_bar("<risk>", "", Scale(0.0, 1.0), band_colors("risk"), None)
    assert ElementTree.fromstring(html) is not None
    assert "no values yet" in html


@pytest.mark.parametrize("quantity", UNITS)
def test_every_quantity_is_written_in_a_unit_of_its_own_size(quantity: str) -> None:
    unit = ShownUnit.of(quantity, UNITS[quantity])
    assert (
        unit.name
        == {"m": "mm", "Pa": "kPa", "": "%" if "strain" in quantity else ""}[UNITS[quantity]]
    )
    assert float(unit.write(0.5 / unit.factor)) == pytest.approx(0.5)


def test_a_legend_names_each_colour() -> None:
    page = ElementTree.fromstring(legend([("surface: 12", (1, 2, 3)), ("a < b", (4, 5, 6))]))
    assert [row[0].tail for row in page] == ["surface: 12", "a < b"]


# Views


def test_all_that_readings_tell_can_be_seen() -> None:
    assert {view.quantity for view in VIEWS.values()} == {"", DIFFERENCE, *UNITS}
    assert set(UNITS) > HEARD
    assert [view.key for view in VIEWS.values() if view.key] == list("123456")


def test_a_view_that_is_not_there_is_refused() -> None:
    _, view, _ = view_of(block_mesh())
    with pytest.raises(ValueError, match="no view 'xray'; allowed: smooth, flat"):
        view.choose("xray")


def test_every_view_shows_the_whole_surface_on_meshes_that_can_be_dragged() -> None:
    mesh = block_mesh()
    surface = Surface.of(mesh)
    clock = Clock()
    scene, view, made = view_of(mesh, clock)
    for name in VIEWS:
        view.choose(name)
        clock.now += 2 * RECOLOR_PERIOD
        view.show(frame_of(mesh, surface, 1.3))
        shown = scene.meshes("/organ")
        assert all(any(node is one for one in made) for node in shown)
        assert not [node for node in scene.nodes.values() if hasattr(node, "visible")]
        area = 0.0
        for node in shown:
            a, b, c = (node.vertices[node.faces[:, k]].astype(np.float64) for k in range(3))
            area += np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        x, y, z = 2.6 * np.array([1.0, 0.75, 0.5])
        assert area == pytest.approx(2 * (x * y + y * z + z * x), rel=1e-4), name
    assert len(made) == len({id(node) for node in made})


def test_views_differ_in_what_is_drawn() -> None:
    mesh = block_mesh()
    frame = frame_of(mesh, Surface.of(mesh), 1.1)
    drawn = {}
    for name in ("smooth", "flat", "wireframe", "both", "springs", "displacement"):
        scene, view, _ = view_of(mesh)
        view.choose(name)
        view.show(frame)
        one = scene.meshes("/organ")[0]
        drawn[name] = (
            one.flat_shading, one.wireframe, one.opacity is None,
            len(scene.meshes("/edges")), "/springs/inside" in scene.nodes, bool(view.bar),
        )  # fmt: skip
    assert drawn == {
        "smooth": (False, False, True, 0, False, False),
        "flat": (True, False, True, 0, False, False),
        "wireframe": (False, True, True, 0, False, False),
        "both": (True, False, True, 1, False, False),
        "springs": (False, False, False, 0, True, True),
        "displacement": (False, False, True, 0, False, True),
    }


def test_what_a_view_adds_goes_with_it() -> None:
    mesh = block_mesh()
    frame = frame_of(mesh, Surface.of(mesh))
    scene, view, _ = view_of(mesh)
    for name in ("both", "springs", "displacement", "smooth"):
        view.choose(name)
        view.show(frame)
    assert not scene.meshes("/edges")
    assert not [name for name in scene.nodes if name.startswith("/springs")]
    assert view.bar == ""


def test_a_quantity_is_drawn_as_it_is_heard_and_ones_of_another_name_are_not() -> None:
    mesh = block_mesh()
    surface = Surface.of(mesh)
    stress = NodeValues("von_mises_stress", "Pa", np.full(mesh.node_rows, 7.0, np.float32))
    frame = frame_of(mesh, surface, scalar=stress)
    assert (quantity_values("von_mises_stress", frame) == 7.0).all()
    assert np.isnan(quantity_values("strain", frame)).all()
    before = quantity_values("von_mises_stress", frame)
    later = frame_of(mesh, surface)
    assert (quantity_values("von_mises_stress", later, before) == 7.0).all()
    stretched = quantity_values("displacement", frame_of(mesh, surface, 1.5))
    assert stretched == pytest.approx(np.linalg.norm(mesh.rest[: mesh.node_rows], axis=1) / 2)


def test_until_values_of_a_cut_come_copies_have_those_of_their_node() -> None:
    mesh = block_mesh()
    before = np.arange(float(mesh.node_rows))
    mesh.apply(split_plan(mesh))
    values = quantity_values("von_mises_stress", frame_of(mesh, Surface.of(mesh)), before)
    assert mesh.node_rows > len(before)
    assert (values == mesh.node_parents[: mesh.node_rows]).all()


def test_colours_wait_while_the_shape_follows() -> None:
    mesh = block_mesh()
    surface = Surface.of(mesh)
    clock = Clock()
    scene, view, _ = view_of(mesh, clock)
    view.choose("displacement")
    view.show(frame_of(mesh, surface, 1.5))
    bar = view.bar
    faces = [node.faces for node in scene.meshes("/organ")]
    clock.now += 0.5 * RECOLOR_PERIOD
    view.show(frame_of(mesh, surface, 1.2))
    now = scene.meshes("/organ")
    assert view.bar == bar
    assert all(node.faces is one for node, one in zip(now, faces, strict=True))
    assert max(node.vertices.max() for node in now) == pytest.approx(1.2, abs=0.3)
    clock.now += RECOLOR_PERIOD
    view.show(frame_of(mesh, surface, 1.2))
    assert view.bar != bar


# Springs


def test_what_nobody_would_see_move_is_shown_again_only_once_it_has_crept_far_enough() -> None:
    mesh = block_mesh()
    scene, view, _ = view_of(mesh)
    surface = Surface.of(mesh)
    view.show(frame_of(mesh, surface))
    drawn = scene.meshes("/organ")[0]
    first = drawn.vertices
    rest = mesh.rest[: mesh.node_rows]
    farthest = float(np.abs(rest).max()) * Placement.around(rest).scale
    view.show(frame_of(mesh, surface, 1.0 + 0.6 * STILL / farthest))
    assert drawn.vertices is first
    view.show(frame_of(mesh, surface, 1.0 + 1.2 * STILL / farthest))
    assert np.abs(drawn.vertices - first).max() == pytest.approx(1.2 * STILL, rel=0.1)


def test_springs_of_tetrahedra_are_their_edges_on_the_surface_and_inside() -> None:
    mesh = block_mesh()
    groups = {group.name: group for group in spring_groups(Surface.of(mesh), mesh)}
    tetrahedra = mesh.tets[: mesh.element_rows]
    edges = {frozenset(pair) for four in tetrahedra for pair in combinations(four.tolist(), 2)}
    found = [frozenset(ends) for group in groups.values() for ends in group.ends.tolist()]
    assert set(found) == edges
    assert len(found) == len(edges)
    # A closed surface without handles has three edges fewer than six for every two nodes.
    assert groups["surface"].count == 3 * len(Surface.of(mesh).nodes) - 6


def test_springs_of_connected_surfaces_have_their_categories() -> None:
    settings = SheetSettings("connected_surfaces", thickness=0.0)
    mesh = load("sphere_shell", parameters={"subdivisions": 2}, sheet=settings).mesh
    groups = {group.name: group for group in spring_groups(Surface.of(mesh), mesh)}
    assert mesh.sheet is not None
    assert groups["connecting"].count == mesh.sheet.count(CONNECTING)
    assert set(groups) == {"surface", "connecting"}


def test_of_very_many_springs_an_even_choice_is_drawn() -> None:
    ends = np.arange(6 * MOST_LINES).reshape(-1, 2)
    group = SpringGroup.of("inside", ends)
    assert group.count == 3 * MOST_LINES
    assert len(group.ends) == MOST_LINES


# Tools


@pytest.mark.parametrize(
    ("shape", "size", "volume"),
    [
        ("sphere", (0.01,), 4 / 3 * np.pi * 1e-6),
        ("capsule", (0.01, 0.03), 4 / 3 * np.pi * 1e-6 + np.pi * 3e-6),
        ("box", (0.01, 0.02, 0.03), 6e-6),
    ],
)
def test_the_mesh_of_a_tool_encloses_its_volume(
    shape: str, size: tuple[float, ...], volume: float
) -> None:
    vertices, triangles = tool_mesh(shape, size)
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    enclosed = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert enclosed == pytest.approx(volume, rel=0.05)


@pytest.mark.parametrize(("shape", "area"), [("rectangle", 2e-4), ("triangle", 1e-4)])
def test_the_mesh_of_a_blade_has_its_area(shape: str, area: float) -> None:
    vertices, triangles = tool_mesh(shape, (0.01, 0.02))
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(area)


def test_a_tool_without_a_known_shape_is_refused() -> None:
    with pytest.raises(ValueError, match="no tool shape 'spoon'; allowed: sphere, box"):
        tool_mesh("spoon", (0.01,))


def tool(owner: str, state: str = "active", pressed: bool = False) -> ToolShown:
    pose = np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    return ToolShown("t", "grab", "sphere", (0.005,), owner, state, pressed, pose)


def test_own_tools_are_brighter_pressed_ones_most_and_frozen_ones_are_told() -> None:
    mine, others = (ToolLook.of(tool(owner), "anna-1", 1.0) for owner in ("anna-1", "ben-1"))
    assert others.opacity < mine.opacity
    assert ToolLook.of(tool("anna-1", pressed=True), "anna-1", 1.0).opacity > mine.opacity
    frozen = ToolLook.of(tool("anna-1", "frozen"), "anna-1", 1.0)
    assert frozen.color != mine.color
    assert frozen.label == "t (frozen)"


def test_tools_come_move_change_and_go() -> None:
    mesh = block_mesh()
    surface = Surface.of(mesh)
    scene = FakeScene()
    page = PageScene(scene, Placement(np.zeros(3), 100.0))
    view = ToolsView(page, "anna-1")
    view.show(frame_of(mesh, surface, tools={"t": tool("anna-1", "free")}))
    assert not scene.nodes
    view.show(frame_of(mesh, surface, tools={"t": tool("anna-1")}))
    assert scene.nodes["/tools/t"].position == pytest.approx((1.0, 0.0, 0.0))
    assert np.abs(scene.nodes["/tools/t/shape"].vertices).max() == pytest.approx(0.5, rel=1e-6)
    view.show(frame_of(mesh, surface, tools={"t": tool("anna-1", "frozen")}))
    assert scene.nodes["/tools/t/label"].text == "t (frozen)"
    view.show(frame_of(mesh, surface))
    assert not scene.nodes


# Sutures and holes


class LostHole:
    """A hole whose tissue is no more."""

    def loop(self, mesh: Mesh, positions: Any) -> Any:
        raise HoleLostError("gone")


class SquareHole(LostHole):
    """A hole with four corners."""

    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])

    def loop(self, mesh: Mesh, positions: Any) -> Any:
        return self.corners


def test_threads_and_edges_of_holes_come_follow_the_tissue_and_go() -> None:
    mesh = block_mesh()
    surface = Surface.of(mesh)
    scene = FakeScene()
    lines = SeamLines(PageScene(scene, Placement(np.zeros(3), 1.0)))  # Lifts by 4 mm of 2 m.
    lines.show(frame_of(mesh, surface, holes=(LostHole(),)))
    assert not scene.nodes
    mesh.sutures = Sutures(
        np.array([1], np.uint32), np.array([[0, 7]], np.int32), np.ones(1), np.ones(1),
        np.array([1], np.uint32),
    )  # fmt: skip
    for stretch in (1.0, 1.4):
        lines.show(frame_of(mesh, surface, stretch, holes=(LostHole(), SquareHole())))
        at = stretch * mesh.rest[[[0, 7]]]
        assert scene.nodes["/sutures"].points == pytest.approx(at, abs=0.0041)
    around = scene.nodes["/holes"].points
    assert np.linalg.norm(around[:, 1] - around[:, 0], axis=1) == pytest.approx(np.ones(4))
    assert around[:, 1] == pytest.approx(np.roll(around[:, 0], -1, axis=0))
    mesh.sutures = Sutures()
    lines.show(frame_of(mesh, surface))
    assert not scene.nodes


# The range that is kept


class FakeGui:
    """Controls without a browser: what they hold, and what is called when a person changes it."""

    def __init__(self) -> None:
        self.controls: dict[str, Any] = {}

    def _add(self, label: str, value: Any = None, **more: Any) -> Any:
        control = SimpleNamespace(value=more.pop("initial_value", value), **more, act=None)
        control.on_update = lambda act: setattr(control, "act", act)
        self.controls[label] = control
        return control

    add_checkbox = add_number = _add

    def change(self, label: str, value: Any) -> None:
        self.controls[label].value = value
        self.controls[label].act()


def test_a_range_is_kept_in_the_unit_it_is_written_in_until_another_quantity_is_chosen() -> None:
    mesh = block_mesh()
    surface = Surface.of(mesh)
    _, view, _ = view_of(mesh)
    gui = FakeGui()
    person = SimpleNamespace(in_turn=lambda act: act)
    controls = RangeControls(person, gui, view)  # type: ignore[arg-type]
    view.choose("displacement")
    view.show(frame_of(mesh, surface, 1.5))
    controls.show()
    assert gui.controls["Fixed range"].visible
    gui.change("Fixed range", True)
    controls.show()
    assert view.fixed_scale == view.scale
    assert view.scale is not None
    assert gui.controls["To"].value == pytest.approx(1e3 * view.scale.high)
    gui.change("To", 7.5)
    assert view.fixed_scale == Scale(0.0, 0.0075)
    view.show(frame_of(mesh, surface, 3.0))
    assert ">7.5<" in view.bar
    with pytest.raises(ValueError, match="the lower first"):
        gui.change("From", 8.0)
    view.choose("strain")
    controls.show()
    assert view.fixed_scale is None
    assert not gui.controls["Fixed range"].value
    assert not gui.controls["To"].visible
