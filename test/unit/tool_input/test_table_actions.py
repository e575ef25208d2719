"""What people do at the operating table beside grabbing: the modes' drags become requests."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from tissue_interfaces.msg import RiskRegion, RiskRegions, Tool
from tissue_interfaces.srv import Suture

from cut_service.planner import plan
from cut_service.suturing import Sewing, plan_sewing
from cut_service.sweep import Sweep
from support.fake_gui import FakeGui, FakeScene
from support.fake_node import FakeNode
from support.valid_mesh import check_valid
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.interaction.tools import ToolSpec, blade
from tool_input.table.blade_mode import BladeMode, on_tissue, standing, steered
from tool_input.table.cut_mode import CutMode
from tool_input.table.desk import Desk
from tool_input.table.modes import END, MOVE, START, Drag
from tool_input.table.page_scene import PageScene, Placement
from tool_input.table.patch_mode import PatchMode
from tool_input.table.patch_outline import outline
from tool_input.table.person import Person
from tool_input.table.risk_mode import RiskMode
from tool_input.table.sew_mode import SewMode, alongside, spread
from tool_input.table.sight import Sight

SIDE, THICK = 0.06, 0.012
EYE = np.array([0.03, 0.03, 0.3])
UP = np.array([0.0, 0.0, 1.0])

pytestmark = pytest.mark.usefixtures("anywhere")


class Table:
    """One person at a wall of tissue across z, from 0 to `THICK`, and what they are told."""

    def __init__(self, tissue: bool = True) -> None:
        self.node, self.told = FakeNode(), list[str]()
        self.desk = Desk(self.node, "organ")
        self.mesh = Mesh(block(13, 13, 4, SIDE, SIDE, THICK))
        report = SimpleNamespace(faces_split=12, components=1)
        self.node.answers["tissue/cut"] = SimpleNamespace(success=True, message="", report=report)
        self.person = Person("anna-1", self.desk, self.told.append)
        self.gui, self.drawn = FakeGui(), FakeScene()
        points = self.mesh.rest[: self.mesh.node_rows]
        self.scene = PageScene(self.drawn, Placement.around(points))
        if tissue:
            self.desk.replica.take_keyframe(b"e" * 16, self.mesh)
            self.shape(points)

    def shape(self, points: NDArray[np.float64]) -> None:
        """Let the tissue have another shape."""
        frame = self.desk.replica.newest_frame + 1
        self.desk.replica.take_state(b"e" * 16, self.mesh.version, frame, points.astype(np.float32))

    def mode(self, kind: Any) -> Any:
        """A mode that the person has chosen."""
        mode = kind(self.person, self.scene)
        mode.settings(self.gui)
        return mode

    def drag(self, mode: Any, *points: ArrayLike, end: bool = True) -> None:
        """Drag over points of the view through the first that faces the eye."""
        places = [np.asarray(point, dtype=np.float64) for point in points]
        phases = [START, *[MOVE] * (len(places) - 1)]
        for phase, place in zip(phases, places, strict=True):
            self.person.attempt(mode.drag, self.event(phase, places[0], place))
        if end:
            self.person.attempt(mode.drag, self.event(END, places[0], places[-1]))

    def event(self, phase: str, start: NDArray[np.float64], point: NDArray[np.float64]) -> Drag:
        frame = self.desk.frame()
        ray = (point - EYE) / np.linalg.norm(point - EYE)
        hit = None if frame is None else Sight.of(frame).hit(EYE, ray)
        return Drag(phase, start, point, EYE, -UP, None if hit is None else hit.point, UP)

    def uses(self) -> list[tuple[bool, Any]]:
        """The levels of the blade's use, each with the blade's pose when it was published."""
        told, pose = [], None
        for topic, message in self.node.published:
            if topic == "tools/anna_1_blade/servo_cp":
                pose = message.pose
            elif topic == "tools/anna_1_blade/use":
                told.append((message.data, pose))
        return told

    def asked(self, service: str) -> list[Any]:
        return self.node.asked_for(f"tissue/{service}")


@pytest.fixture
def table() -> Table:
    return Table()


def at(x: float, y: float, z: float = THICK) -> NDArray[np.float64]:
    return np.array([x, y, z])


# Cutting along a drawn line


def test_a_line_from_edge_to_edge_parts_the_wall(table: Table) -> None:
    mode = table.mode(CutMode)
    table.drag(mode, at(0.03, 0.001), at(0.027, 0.03), at(0.032, 0.059), end=False)
    assert table.drawn.shown == {"/cut_line/sheet", "/cut_line/line"}
    assert table.asked("cut") == []
    table.person.attempt(mode.drag, table.event(END, at(0.03, 0.001), at(0.032, 0.059)))
    assert table.drawn.shown == set()
    (request,) = table.asked("cut")
    assert (request.sweep.header.frame_id, request.method) == ("organ", "split")
    assert request.request_id.startswith("anna-1-")
    sweep = Sweep.from_arrays(request.sweep.vertices, request.sweep.triangles)
    table.mesh.apply(plan(table.mesh, table.mesh.rest[: table.mesh.node_rows], sweep).edit)
    assert check_valid(table.mesh).components == 2


def test_a_line_that_is_left_cuts_nothing(table: Table) -> None:
    """Another mode is chosen, or the connection is lost, while it is drawn."""
    mode = table.mode(CutMode)
    table.drag(mode, at(0.02, 0.03), at(0.04, 0.03), end=False)
    mode.leave()
    assert table.drawn.shown == set()
    table.person.attempt(mode.drag, table.event(END, at(0.02, 0.03), at(0.04, 0.03)))
    assert table.asked("cut") == []


def test_a_line_can_wait_for_its_depth(table: Table) -> None:
    mode = table.mode(CutMode)
    table.gui["Cut when drawn"].set(False)
    table.drag(mode, at(0.02, 0.03), at(0.04, 0.03))
    assert table.asked("cut") == []
    assert "/cut_line/sheet" in table.drawn.shown
    table.gui["Reach"].set("to a depth")
    table.gui["Depth [mm]"].set(5.0)
    table.gui["Line drawn"].set("Cut")
    (request,) = table.asked("cut")
    far = np.array(request.sweep.vertices).reshape(2, -1, 3)[1]
    np.testing.assert_allclose(far[:, 2], THICK - 0.005, atol=1e-4)
    assert table.drawn.shown == set()


def test_a_straight_line_goes_from_the_first_point_to_the_last(table: Table) -> None:
    mode = table.mode(CutMode)
    table.gui["Line"].set("straight")
    table.drag(mode, at(0.02, 0.03), at(0.03, 0.05), at(0.04, 0.03))
    vertices = np.array(table.asked("cut")[0].sweep.vertices).reshape(-1, 3)
    np.testing.assert_allclose(vertices[:, 1], 0.03, atol=1e-9)


def test_what_cannot_be_cut_is_told(table: Table) -> None:
    table.drag(table.mode(CutMode), at(0.02, 0.03), at(0.0201, 0.03))
    assert table.told == ["a cut needs a line drawn across the tissue; drag further"]
    table.gui["Cut when drawn"].set(False)
    table.gui["Line drawn"].set("Cut")
    assert "there is no line" in table.told[-1]
    nobody = Table(tissue=False)
    nobody.drag(nobody.mode(CutMode), at(0.02, 0.03), at(0.04, 0.03))
    assert nobody.told == ["there is no tissue yet; wait for the simulation"]


# The blade


def corners_of(table: Table, pose: Any) -> NDArray[np.float64]:
    tool = table.asked("set_tool")[-1].tool
    spec = ToolSpec(tool.id, tool.kind, tool.shape, tuple(tool.size)).checked()
    p, q = pose.position, pose.orientation
    return blade(spec, np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]))[0]


@pytest.mark.parametrize("shape", ["triangle", "rectangle"])
def test_a_blade_goes_the_way_it_is_dragged_as_deep_as_is_set(table: Table, shape: str) -> None:
    mode = table.mode(BladeMode)
    table.gui["Shape"].set(shape)
    table.gui["Depth [mm]"].set(7.0)
    way = np.array([0.6, 0.8, 0.0])
    table.drag(mode, *(at(0.02, 0.02) + 0.002 * k * way for k in range(12)))
    tool = table.asked("set_tool")[-1].tool
    assert (tool.kind, tool.cutting) == (Tool.CUT, Tool.PROGRESSIVE)
    corners = corners_of(table, table.node.published_on("tools/anna_1_blade/servo_cp")[-1].pose)
    assert corners[:, 2].min() == pytest.approx(THICK - 0.007, abs=1e-6)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    assert abs(normal @ way) / np.linalg.norm(normal) < 1e-6, "it lies in its plane"
    assert [use for use, _ in table.uses()] == [False, True, False]


def test_a_blade_is_pressed_where_the_drag_began_once_its_way_is_known(table: Table) -> None:
    mode = table.mode(BladeMode)
    table.gui["Depth [mm]"].set(7.0)
    start = at(0.02, 0.02)
    table.drag(mode, start, start + np.array([1e-4, 0, 0]), end=False)
    assert True not in [use for use, _ in table.uses()]
    table.drag(mode, start, start + np.array([0, 0.01, 0]), end=False)
    corners = corners_of(table, dict(table.uses())[True])
    np.testing.assert_allclose(corners[0], [0.02, 0.02, THICK - 0.007], atol=1e-6)
    assert np.ptp(corners[:, 0]) < 1e-6, "it is turned the way it goes"


def test_a_blade_can_cut_once_where_it_is_released(table: Table) -> None:
    mode = table.mode(BladeMode)
    table.gui["Cuts"].set("where released")
    assert table.asked("set_tool")[-1].tool.cutting == Tool.AT_USE
    table.drag(mode, at(0.02, 0.02), at(0.03, 0.02), at(0.04, 0.02))
    assert [use for use, _ in table.uses()] == [False, True, False]
    assert dict(table.uses())[True].position.x == pytest.approx(0.04, abs=1e-6)


def test_keys_turn_the_blade_and_go_with_it(table: Table) -> None:
    mode = table.mode(BladeMode)
    table.gui["/turn the blade by +15 degrees"].click()
    assert table.gui["Turn [deg]"].value == 15.0
    mode.leave()
    with pytest.raises(StopIteration):
        table.gui["/turn the blade by +15 degrees"]
    assert [request.tool for request in table.asked("remove_tool")] == ["anna_1_blade"]


def test_standing_blades_hold_the_way_in_their_plane() -> None:
    random = np.random.default_rng(2)
    for up, along in random.normal(size=(20, 2, 3)):
        z = up / np.linalg.norm(up)
        axes = _axes(standing(z, along, 0.0))
        np.testing.assert_allclose(axes[:, 2], z, atol=1e-12)
        assert abs(axes[:, 1] @ along) < 1e-12
        quarter = _axes(standing(z, along, np.pi / 2))
        np.testing.assert_allclose(quarter[:, 0], axes[:, 1], atol=1e-12)
    np.testing.assert_allclose(_axes(standing(z, z, 0.0))[:, 2], z, atol=1e-12)


def _axes(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(Rotation.from_quat(quaternion).as_matrix())


def test_a_blade_steers_within_its_width_and_never_turns_round() -> None:
    along = steered(None, np.array([0.0, 0.002, 0.0]), 0.005)
    np.testing.assert_allclose(along, [0, 1, 0])
    turned = steered(along, np.array([0.005, 0.0, 0.0]), 0.005)
    np.testing.assert_allclose(turned, [np.sqrt(0.5), np.sqrt(0.5), 0])
    np.testing.assert_allclose(steered(along, np.array([0.0, -0.005, 0.0]), 0.005), along)


def test_a_blade_does_not_fall_into_the_wound() -> None:
    """Where the pointer meets tissue far behind, it goes on as deep as it was."""
    last, point = at(0.03, 0.03), at(0.031, 0.03)
    ray = (point - EYE) / np.linalg.norm(point - EYE)
    beneath = EYE + ray * 0.4
    moved = Drag(MOVE, last, point, EYE, -UP, beneath, UP)
    np.testing.assert_allclose(on_tissue(last, moved), point, atol=1e-12)
    near = EYE + ray * (np.linalg.norm(point - EYE) + 0.001)
    np.testing.assert_allclose(on_tissue(last, Drag(MOVE, last, point, EYE, -UP, near, UP)), near)


# Sewing


def test_a_drag_across_a_wound_sews_one_stitch(table: Table) -> None:
    table.node.answers["tissue/suture"] = SimpleNamespace(
        success=True, message="", made=[1], forces=[0.25]
    )
    mode = table.mode(SewMode)
    table.drag(mode, at(0.02, 0.03), at(0.026, 0.03))
    (request,) = table.asked("suture")
    assert (request.action, request.author) == (Suture.Request.SEW, "anna-1")
    assert (request.spacing, request.running) == (0.0, False)
    np.testing.assert_allclose(request.positions, [*at(0.02, 0.03), *at(0.026, 0.03)], atol=1e-6)
    assert table.told == ["Sewn: 1 stitch, pulling 0.25 N at most."]
    table.drag(mode, at(0.02, 0.03), at(0.09, 0.03))
    assert "let go over the other side" in table.told[-1]
    assert len(table.asked("suture")) == 1


def test_lines_along_both_lips_are_sewn_to_each_other_however_they_are_drawn(
    table: Table,
) -> None:
    mode = table.mode(SewMode)
    table.node.answers["tissue/suture"] = SimpleNamespace(
        success=True, message="", made=[1, 2], forces=[0.1, 0.2]
    )
    table.gui["Drag"].set("along both lips")
    table.gui["Spacing [mm]"].set(6.0)
    table.drag(mode, at(0.028, 0.01), at(0.028, 0.03), at(0.028, 0.05))
    assert table.asked("suture") == []
    assert "other lip" in table.told[-1]
    table.drag(mode, at(0.038, 0.05), at(0.038, 0.01))
    (request,) = table.asked("suture")
    first, second = np.array(request.positions).reshape(2, -1, 3)
    np.testing.assert_allclose(second - first, [[0.01, 0, 0]] * len(first), atol=1e-6)
    wanted = Sewing(
        np.array(request.positions).reshape(-1, 3), spacing=request.spacing, reach=request.reach
    )
    edit = plan_sewing(table.mesh, table.mesh.rest[: table.mesh.node_rows], wanted)
    assert len(edit.added_sutures) == 1 + round(0.04 / 0.006)


def test_only_stitches_that_are_still_there_are_tightened(table: Table) -> None:
    mode = table.mode(SewMode)
    table.gui["Tighten"].click()
    assert "no stitch of yours" in table.told[-1]
    ends = np.array([at(0.02, 0.03), at(0.03, 0.03)])
    rest = table.mesh.rest[: table.mesh.node_rows]
    table.mesh.apply(plan_sewing(table.mesh, rest, Sewing(ends)))
    table.node.answers["tissue/suture"] = SimpleNamespace(
        success=True, message="", made=[1, 7], forces=[0.1]
    )
    table.drag(mode, at(0.02, 0.03), at(0.026, 0.03))
    table.gui["Length [mm]"].set(1.5)
    table.gui["Tighten"].click()
    request = table.asked("suture")[-1]
    assert (request.action, list(request.sutures)) == (Suture.Request.TIGHTEN, [1])
    assert request.length == pytest.approx(0.0015)


def test_points_of_a_lip_are_evenly_apart() -> None:
    corner = np.array([[0.0, 0, 0], [0.03, 0, 0], [0.03, 0.01, 0]])
    steps = np.diff(spread(corner, 41), axis=0)
    np.testing.assert_allclose(np.abs(steps).sum(axis=1), 0.001, atol=1e-12)
    np.testing.assert_array_equal(alongside(corner, corner[::-1]), corner)
    with pytest.raises(ValueError, match="drag further"):
        spread(np.zeros((3, 3)), 5)


# Patches


def test_an_ellipse_lies_on_the_tissue_between_both_points() -> None:
    first, second = at(0.01, 0.02, 0.0), at(0.03, 0.03, 0.004)
    tissue = 0.5 * (first + second) + [[0, 0, 0.003], [0.5, 0, 0.1]]
    corners = outline("ellipse", first, second, UP, 0.5, tissue, 0.001)
    long = second - first
    half = 0.5 * np.linalg.norm(long)
    centre = corners.mean(axis=0)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    assert np.ptp(corners @ normal) < 1e-12, "it is flat"
    assert normal[2] > 0.0
    assert abs(normal @ long) < 1e-12
    assert (centre - tissue[0]) @ normal == pytest.approx(0.001)
    spokes = corners - centre
    area = 0.5 * np.cross(spokes, np.roll(spokes, -1, axis=0)).sum(axis=0) @ normal
    sides = len(corners)
    assert area == pytest.approx(0.5 * half**2 * 0.5 * sides * np.sin(2 * np.pi / sides))


def test_a_drag_over_a_hole_lays_a_patch_whose_rim_can_be_sewn(table: Table) -> None:
    table.node.answers["tissue/add_patch"] = SimpleNamespace(
        success=True, message="", patch_id=3, patch_name="patch 3", area=1e-4
    )
    mode = table.mode(PatchMode)
    table.gui["Draw"].set("rectangle")
    table.gui["Sew rim"].click()
    assert "there is no patch" in table.told[-1]
    table.drag(mode, at(0.02, 0.03), at(0.03, 0.03), at(0.04, 0.03))
    (request,) = table.asked("add_patch")
    corners = np.array(request.corners).reshape(-1, 3)
    assert np.ptp(corners, axis=0) == pytest.approx([0.02, 0.02, 0.0], abs=1e-6)
    assert corners[:, 2].mean() == pytest.approx(THICK + 0.0005, abs=1e-6)
    assert (request.thickness, request.young_modulus) == (1e-3, 2e5)
    count = len(table.told)
    table.drag(mode, at(0.02, 0.03), at(0.02, 0.03), at(0.02, 0.03))
    assert table.told[count:] == [
        "a patch needs a drag from one side of it to the other; drag further"
    ]


def test_a_line_around_a_hole_names_it(table: Table) -> None:
    table.node.answers["tissue/closure"] = SimpleNamespace(
        success=True, message="", holes=[SimpleNamespace(name="defect", area=1e-4, covered=0.5)]
    )
    mode = table.mode(PatchMode)
    table.gui["Draw"].set("edge of a hole")
    table.gui["Name of the hole"].set("defect")
    angle = np.linspace(0.0, 1.9 * np.pi, 30)
    table.drag(mode, *(at(0.03 + 0.01 * np.cos(a), 0.03 + 0.01 * np.sin(a)) for a in angle))
    (request,) = table.asked("closure")
    assert request.name == "defect"
    loop = np.array(request.positions).reshape(-1, 3)
    np.testing.assert_allclose(np.linalg.norm(loop - at(0.03, 0.03), axis=1), 0.01, atol=2e-4)
    assert table.told == ["defect: 1 cm2, 50% of it closed."]
    assert table.gui["Sew to"].value == "defect"


# Risk regions


def nodes_near(mesh: Mesh, points: ArrayLike, radius: float) -> set[int]:
    away = mesh.rest[: mesh.node_rows, None] - np.asarray(points)
    near = (np.linalg.norm(away, axis=2) <= radius).any(axis=1)
    return set(mesh.node_ids[: mesh.node_rows][near].tolist())


def test_paint_takes_the_nodes_that_are_under_the_brush_at_rest(table: Table) -> None:
    """The tissue is stretched to twice its width; what is painted is found where it was."""
    rest = table.mesh.rest[: table.mesh.node_rows]
    table.shape(rest * [2.0, 1.0, 1.0])
    mode = table.mode(RiskMode)
    table.gui["Region"].set("conduction")
    table.gui["Brush [mm]"].set(6.0)
    table.gui["Stress limit [kPa]"].set(20.0)
    table.drag(mode, at(0.04, 0.03), at(0.06, 0.03))
    (request,) = table.asked("set_risk_region")
    assert (request.region.name, request.region.stress_limit) == ("conduction", 20e3)
    way = [at(x, 0.03) for x in (0.02, 0.0225, 0.025, 0.0275, 0.03)]
    assert set(request.region.nodes) == nodes_near(table.mesh, way, 0.006), "nothing is left out"
    assert table.drawn.shown == set()


@pytest.mark.parametrize("brush", ["paint", "erase"])
def test_a_further_stroke_adds_to_the_region_or_takes_from_it(table: Table, brush: str) -> None:
    before = nodes_near(table.mesh, [at(0.02, 0.03)], 0.006)
    stroke = nodes_near(table.mesh, [at(0.025, 0.03)], 0.006)
    region = RiskRegion(name="risk", nodes=sorted(before))
    table.desk.risk_regions = RiskRegions(regions=[region])
    mode = table.mode(RiskMode)
    table.gui["Brush [mm]"].set(6.0)
    table.gui["Brush"].set(brush)
    table.drag(mode, at(0.025, 0.03))
    (request,) = table.asked("set_risk_region")
    expected = before | stroke if brush == "paint" else before - stroke
    assert set(request.region.nodes) == expected
    assert expected != before


def test_a_region_that_is_erased_whole_is_removed(table: Table) -> None:
    mode = table.mode(RiskMode)
    table.gui["Brush"].set("erase")
    table.drag(mode, at(0.02, 0.03))
    assert [request.remove for request in table.asked("set_risk_region")] == [True]
    table.gui["Brush"].set("paint")
    table.drag(mode, at(0.5, 0.5))
    assert "no tissue was under the brush" in table.told[-1]
