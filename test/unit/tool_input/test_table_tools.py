"""Grabbing and probing at the operating table: drags, keeping, handles, shapes and sizes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from tissue_interfaces.msg import Tool

from support.fake_gui import FakeGui, FakeScene
from support.fake_node import FakeNode
from tissue_sim.interaction.tools import ToolSpec
from tool_input.table.desk import Desk
from tool_input.table.grab_mode import GrabMode
from tool_input.table.modes import END, MOVE, START, Drag
from tool_input.table.page_scene import PageScene, Placement
from tool_input.table.person import Person
from tool_input.table.probe_mode import ProbeMode
from tool_input.table.tool_mode import turned_to

ORGAN = 0.1
"""Largest extent of the organ [m]."""

HERE = np.array([0.01, 0.02, 0.03])
SLANTED = np.array([0.6, 0.0, 0.8])
"""An outward normal."""

DOWN = np.array([0.0, 0.0, -1.0])

pytestmark = pytest.mark.usefixtures("anywhere")


def beside(x: float, y: float, z: float) -> NDArray[np.float64]:
    """A point [m] as seen from `HERE`."""
    return HERE + np.array([x, y, z])


class Hand:
    """A person's hand in one mode, and what became of what it did."""

    def __init__(self, kind: Any) -> None:
        self.node, self.gui, self.drawn = FakeNode(), FakeGui(), FakeScene()
        self.told: list[str] = []
        self.person = Person("anna-1", Desk(self.node, "organ"), self.told.append)
        corners = np.array([[0.0, 0, 0], [ORGAN, ORGAN / 2, ORGAN / 2]])
        self.scene = PageScene(self.drawn, Placement.around(corners))
        self.mode = kind(self.person, self.scene)
        self.mode.settings(self.gui)

    def drag(self, *points: ArrayLike, end: bool = True) -> None:
        """Drag from `HERE` over some points [m]."""
        self._does(START, HERE)
        for point in points:
            self._does(MOVE, np.asarray(point))
        if end:
            self._does(END, np.asarray(points[-1] if points else HERE))

    def _does(self, phase: str, point: NDArray[np.float64]) -> None:
        eye = HERE - 0.3 * DOWN
        self.mode.drag(Drag(phase, HERE, point, eye, DOWN, None, SLANTED))

    def uses(self, tool: str) -> list[bool]:
        return [message.data for message in self.node.published_on(f"tools/{tool}/use")]

    def pressed(self, tool: str) -> bool:
        return bool(self.uses(tool)) and self.uses(tool)[-1]

    def pose(self, tool: str) -> tuple[NDArray[np.float64], Rotation]:
        """Where a tool was wanted last: tip [m], shape (3,), and orientation."""
        pose = self.node.published_on(f"tools/{tool}/servo_cp")[-1].pose
        p, q = pose.position, pose.orientation
        return np.array([p.x, p.y, p.z]), Rotation.from_quat([q.x, q.y, q.z, q.w])

    def asked(self) -> Tool:
        """The tool as `tissue/set_tool` was asked for it last."""
        return self.node.asked_for("tissue/set_tool")[-1].tool

    def removed(self) -> list[str]:
        return [request.tool for request in self.node.asked_for("tissue/remove_tool")]


def test_a_drag_holds_where_it_begins_carries_and_lets_go() -> None:
    hand = Hand(GrabMode)
    hand.drag(end=False)
    np.testing.assert_allclose(hand.pose("anna_1_grab")[0], HERE)
    assert hand.pressed("anna_1_grab")
    hand.drag(beside(0.02, 0, 0), beside(0.02, 0.01, 0.005))
    np.testing.assert_allclose(hand.pose("anna_1_grab")[0], beside(0.02, 0.01, 0.005))
    assert not hand.pressed("anna_1_grab")
    assert hand.uses("anna_1_grab") == [False, True, False, True, False]


def test_shapes_and_sizes_are_those_that_the_simulation_takes() -> None:
    hand = Hand(GrabMode)
    assert (hand.asked().shape, list(hand.asked().size)) == (Tool.SPHERE, [pytest.approx(0.004)])
    hand.gui["Radius [mm]"].set(7.5)
    assert list(hand.asked().size) == [pytest.approx(0.0075)]
    for name, shape, count in (("line", Tool.CAPSULE, 2), ("box", Tool.BOX, 3)):
        hand.gui["Shape"].set(name)
        tool = hand.asked()
        assert (tool.shape, len(tool.size)) == (shape, count)
        ToolSpec(tool.id, tool.kind, tool.shape, tuple(tool.size))
    assert hand.gui["Edges [mm]"].visible
    assert not hand.gui["Radius [mm]"].visible


@pytest.mark.parametrize("organ", [1e-4, 0.012, 0.1, 1.7, 400.0])
def test_organs_of_any_size_have_tools_that_suit_them(organ: float) -> None:
    gui, node = FakeGui(), FakeNode()
    person = Person("anna-1", Desk(node, "organ"), list[str]().append)
    placement = Placement.around(np.array([[0.0, 0, 0], [organ, organ / 2, organ / 2]]))
    GrabMode(person, PageScene(FakeScene(), placement)).settings(gui)
    (radius,) = node.asked_for("tissue/set_tool")[-1].tool.size
    assert 0.02 * organ < radius < 0.06 * organ


def test_a_line_lies_on_the_tissue_with_its_middle_where_the_drag_begins() -> None:
    hand = Hand(GrabMode)
    hand.gui["Shape"].set("line")
    hand.drag(end=False)
    tip, turn = hand.pose("anna_1_grab")
    axis = turn.as_matrix()[:, 2]
    assert abs(axis @ SLANTED) < 1e-9
    assert abs(axis @ DOWN) < 1e-9
    np.testing.assert_allclose(tip + 0.5 * hand.asked().size[1] * axis, HERE, atol=1e-12)


def test_a_probe_pushes_in_along_the_view_and_points_at_the_eye() -> None:
    hand = Hand(ProbeMode)
    hand.gui["Push [mm]"].set(1.5)
    hand.drag(end=False)
    tip, turn = hand.pose("anna_1_probe")
    radius = hand.asked().size[0]
    deepest = tip + radius * DOWN
    np.testing.assert_allclose(deepest, HERE + 0.0015 * DOWN, atol=1e-12)
    np.testing.assert_allclose(turn.as_matrix()[:, 2], -DOWN, atol=1e-12)


def test_what_is_kept_stays_held_while_the_next_drag_takes_another_tool() -> None:
    hand = Hand(GrabMode)
    hand.gui["Keep"].set(True)
    hand.drag(beside(0.02, 0, 0))
    assert hand.pressed("anna_1_grab")
    assert hand.asked().id == "anna_1_grab_2"  # It is heard by the time of the next drag.
    hand.drag(beside(0, 0.02, 0))
    assert hand.pressed("anna_1_grab")
    assert hand.pressed("anna_1_grab_2")
    np.testing.assert_allclose(hand.pose("anna_1_grab")[0], beside(0.02, 0, 0))
    hand.mode.leave()
    assert hand.pressed("anna_1_grab")
    assert hand.removed() == ["anna_1_grab_3"]  # It held nothing.
    hand.mode.settings(hand.gui)
    hand.gui["Let go of all"].click()
    assert not hand.pressed("anna_1_grab")
    assert set(hand.removed()) >= {"anna_1_grab", "anna_1_grab_2"}


def test_another_mode_lets_go_of_what_is_dragged() -> None:
    hand = Hand(GrabMode)
    hand.drag(beside(0.02, 0, 0), end=False)
    hand.mode.leave()
    assert not hand.pressed("anna_1_grab")
    assert hand.removed() == ["anna_1_grab"]


def test_the_box_says_whether_the_tool_is_pressed_and_presses_it() -> None:
    hand = Hand(GrabMode)
    box = hand.gui["Pressed"]
    hand.drag(beside(0.02, 0, 0), end=False)
    assert box.value
    box.set(False)
    assert not hand.pressed("anna_1_grab")
    box.set(True)
    assert hand.pressed("anna_1_grab")
    np.testing.assert_allclose(hand.pose("anna_1_grab")[0], beside(0.02, 0, 0))


def test_handles_move_and_turn_the_tool_and_follow_it() -> None:
    hand = Hand(GrabMode)
    hand.gui["Handles"].set(True)
    (name,) = hand.drawn.shown
    handles: Any = hand.drawn.nodes[name]
    np.testing.assert_allclose(hand.pose("anna_1_grab")[0], hand.scene.placement.centre)
    wanted, turn = beside(0, 0, 0.01), Rotation.from_euler("xyz", [0.3, -0.2, 0.9])
    x, y, z, w = turn.as_quat()
    handles.position = tuple(hand.scene.to_page(wanted))
    handles.wxyz = (w, x, y, z)
    callback = handles._callbacks[0]
    for phase in ("start", "update", "end"):
        with pytest.raises(StopIteration):
            callback(SimpleNamespace(phase=phase, target=handles)).send(None)
    tip, turned = hand.pose("anna_1_grab")
    np.testing.assert_allclose(tip, wanted, atol=1e-8)
    assert (turned.inv() * turn).magnitude() < 1e-9
    # A drag keeps how the tool was turned by hand, and takes the handles along.
    hand.drag(beside(0.01, 0, 0))
    assert (hand.pose("anna_1_grab")[1].inv() * turn).magnitude() < 1e-9
    np.testing.assert_allclose(hand.scene.to_organ(handles.position), beside(0.01, 0, 0), atol=1e-7)
    hand.gui["Handles"].set(False)
    assert hand.drawn.shown == set()


def test_the_shortest_turn_takes_z_where_it_is_wanted() -> None:
    axes = [*Rotation.random(20, random_state=1).as_matrix()[:, :, 2], [0, 0, 1], [0, 0, -1]]
    for axis in np.array(axes, dtype=np.float64):
        turn = Rotation.from_quat(turned_to(axis))
        np.testing.assert_allclose(turn.apply([0, 0, 1]), axis, atol=1e-9)
        assert turn.magnitude() == pytest.approx(np.arccos(np.clip(axis[2], -1, 1)), abs=1e-7)
